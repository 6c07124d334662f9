"""Scenes of one broadcast shape: flat and in natural units for the models that integrate, and back.

Natural units are the whisker's length L, its base stiffness EI₀, and EI₀/L² for forces.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import finite
from ..whisker import Whisker
from .chebyshev import Array
from .contact import NUMBERS, Bending, Model, Outcome
from .shape import Profile
from .trajectory import Rows, rows_of

#: Rows solved at a time; passes are cut further, to fit the cache.
ROWS = 32768
Solved = tuple[Array, NDArray[np.int8], Array]


def friction(friction_angle: ArrayLike) -> Array:
    """Friction angles as an array; a right angle or more is misuse."""
    tilt = finite("friction_angle", friction_angle, "give radians, 0 for no friction")
    if np.any(np.abs(tilt) >= np.pi / 2):
        raise ValueError(
            "friction_angle must be between −π/2 and π/2, got "
            f"{np.ravel(tilt)[np.argmax(np.abs(tilt))]:g}; give radians, such as np.arctan(0.48)."
        )
    return tilt


@dataclass(frozen=True, eq=False)
class Scenes:
    """Whiskers and scenes of one broadcast shape, flat and in natural units."""

    whisker: Whisker
    shape: tuple[int, ...]
    length: Array
    force: Array
    rows: Rows
    given: list[Array]

    @classmethod
    def of(cls, whisker: Whisker | Profile, **arguments: ArrayLike) -> Scenes:
        """Scenes with the arguments named ``length`` and ``force`` brought to natural units."""
        profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
        base = profile.whisker
        whiskers = profile.arc[0], profile.radius[0], base.stiffness, *vars(profile.law).values()
        try:
            shape = np.broadcast_shapes(*(np.shape(a) for a in (*whiskers, *arguments.values())))
        except ValueError:
            shapes = ", ".join(f"{k} {np.shape(v)}" for k, v in arguments.items())
            raise ValueError(
                f"The scenes must broadcast with each other and the whisker, got {shapes} and a "
                f"whisker of {np.shape(profile.radius[0])}; give arrays of one shape."
            ) from None

        def flat(value: ArrayLike) -> Array:
            return np.broadcast_to(np.asarray(value, dtype=float), shape).reshape(-1)

        length, force = flat(base.length), flat(base.force_scale)
        unit: dict[str, Any] = {"length": length, "force": force}
        given = [flat(value) / unit.get(name, 1.0) for name, value in arguments.items()]
        return cls(base, shape, length, force, rows_of(profile, shape), given)

    def pieces(self) -> Iterator[tuple[slice, Rows, list[Array]]]:
        """Pieces of `ROWS` scenes: where they are, their whiskers and their arguments."""
        for start in range(0, self.length.size, ROWS):
            part = slice(start, start + ROWS)
            yield part, self.rows.take(part), [a[part] for a in self.given]

    def outcome(self, flat: NDArray[np.int8]) -> Any:
        """Outcomes in the scenes' shape."""
        return flat.reshape(self.shape) if self.shape else Outcome(int(flat[0]))

    def jacobian(self, slopes: Array) -> Array:
        """Slopes (3, 2, n) of moment and two forces to (r, θ_d), (..., 3, 2) and in SI units."""
        one = np.ones_like(self.length)
        to_signal = self.force * np.stack([self.length, one, one])
        to_contact = np.stack([self.length, one])
        slopes = slopes * to_signal[:, None] / to_contact
        return np.moveaxis(slopes, -1, 0).reshape(*self.shape, 3, 2)

    def bending(self, numbers: Array, outcome: NDArray[np.int8], error: Array) -> Bending:
        """Results in the scenes' shape and in SI units."""
        length, force, shape = self.length, self.force, self.shape
        scale = {
            "moment": force * length,
            "axial_force": force,
            "transverse_force": force,
            "radial_distance": length,
            "arc_length": length,
            "force": force,
        }
        return Bending(
            **{
                name: (row * scale.get(name, 1.0)).reshape(shape)[()]
                for name, row in zip(NUMBERS, numbers, strict=True)
            },
            outcome=self.outcome(outcome),
            model=np.full(shape, Model.PROFILE, dtype=np.int8) if shape else Model.PROFILE,
            error=error.reshape(shape)[()],
            whisker=self.whisker,
        )


def by_rows(
    solve: Callable[..., Solved], whisker: Whisker | Profile, **arguments: ArrayLike
) -> Bending:
    """Solve scenes in pieces, and restore units and shape."""
    scenes = Scenes.of(whisker, **arguments)
    n = scenes.length.size
    numbers, outcome, error = np.empty((8, n)), np.empty(n, dtype=np.int8), np.empty(n)
    for part, rows, given in scenes.pieces():
        numbers[:, part], outcome[part], error[part] = solve(rows, *given)
    return scenes.bending(numbers, outcome, error)
