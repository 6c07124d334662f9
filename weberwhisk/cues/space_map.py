"""The map of moment and forces in all directions (§2g): distance, deflection angle and azimuth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
import scipy

from .._util.checks import number, one_or_more, refuse_hinge
from .._util.values import Array
from ..mechanics.contact import Outcome
from ..mechanics.curved_surface import SIX
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import Whisker
from .force_map import SIGNALS, ForceMap
from .protocol import Cue, Encoded

__all__ = ["IN_SPACE", "SpaceMap"]

DIRECTIONS = ("moment_direction", "force_direction")
#: What `SpaceMap` may sense: sizes, components and angles.
IN_SPACE = tuple(dict.fromkeys((*SIGNALS, *SIX, *DIRECTIONS, "torsion_angle")))


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SpaceMap(Cue):
    """Distance, deflection angle and azimuth from moment and forces in all directions.

    The paper's map in three dimensions, Scholz & Rahn's with a second plane. A straight whisker
    bends in the plane of its contact, along which friction acts too (`Friction`) and a hinge at
    its base gives, one that gives as much in all directions. So the sizes of moment and forces are
    those of `ForceMap`, and the azimuth ω of the contact about the base tangent (from y towards z)
    is the direction of both: F = (−Fx, Fy cos ω, Fy sin ω), moment (0, −M sin ω, M cos ω).

    A curved whisker bends out of the plane of its curvature and twists, so that all signals inform
    of all three unknowns (`mechanics.rod`, with friction along the whisker). Its deflection is
    counted from where it first touches at that distance, and ω is the direction of the push there:
    at 0 to the side that it curves to, as `ForceMap` has it, at π against its curvature.

    Parameters
    ----------
    signal_names : sequence of str, optional
        Which are sensed, of ``"moment"`` and ``"transverse_force"``, the sizes of what is across
        the base tangent, and their directions ``"moment_direction"`` and ``"force_direction"``,
        rad; ``"axial_force"``, ``"force_y"``, ``"force_z"``, ``"torsion"``, ``"moment_y"`` and
        ``"moment_z"``, the components of force and moment; and ``"torsion_angle"``, by which the
        moment leans out of the plane across the base tangent, rad. By default the sizes of moment,
        axial and transverse force and the two directions: all that there is of a straight whisker.
        A curved one's torsion is one more.
    roll : float
        Of the plane of curvature about the base tangent, rad: ω, y and z are then counted from a
        side that is turned back by as much. `UnknownRoll` is of one that is not known.

    Raises
    ------
    ValueError
        For a signal that there is not, none or one twice, and a roll that is not finite. Where it
        is used, for a hinge of a curved whisker.

    Notes
    -----
    Directions are read to whole turns, and a posterior goes on beyond an azimuth of π. A prior of
    your own has ends, unless it is uniform over a whole turn.

    A straight whisker's force that points away from the push, as it does beyond a contact angle of
    90°, or sooner with friction, has a negative size, and the direction of the push. A curved
    whisker's turns round out of the plane: its sizes are positive, and its directions may be any.

    Components change sign, and so do the axial forces of a curved whisker that is pushed against
    its curvature and of one that rubs towards its tip, and a transverse force that turns round may
    vanish: their noise has a floor (`inference.default_noise`).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = SpaceMap().signals(w, np.array([30e-3, 0.4, 1.0]))
    >>> flat, _ = ForceMap().signals(w, np.array([30e-3, 0.4]))
    >>> bool((signals[:2] == flat).all()), signals[3:]
    (True, array([1., 1.]))
    """

    takes_curved = True
    unknowns = ("radial_distance", "deflection_angle", "azimuth")
    signal_names: tuple[str, ...] = (*SIGNALS, *DIRECTIONS)
    roll: float = 0.0

    def __init__(
        self, signal_names: Sequence[str] = (*SIGNALS, *DIRECTIONS), *, roll: float = 0.0
    ) -> None:
        names = one_or_more("signals", signal_names, IN_SPACE)
        hint = "give radians, 0 where the whisker curves towards y; UnknownRoll has a prior of it"
        roll = number("roll", roll, hint)
        self._set(signal_names=names, roll=roll)

    @cached_property
    def all_but_one(self) -> ForceMap | None:  # type: ignore[override]
        """On a straight whisker, the cue without the azimuth, which directions alone inform of."""
        sizes = [name for name in self.signal_names if name in SIGNALS]
        apart = sizes and self.signal_names == (*sizes, *DIRECTIONS)
        return ForceMap(sizes) if apart else None

    @property
    def circular(self) -> tuple[bool, ...]:
        """The two directions."""
        return tuple(name in DIRECTIONS for name in self.signal_names)

    def forward(self, whisker: Any, contact: Array) -> ForwardModel:
        """The mechanics of contacts (..., 3): those of a curved whisker, at their azimuths."""
        forward = forward_of(whisker)
        if forward.is_flat:
            return forward
        refuse_hinge(forward.whisker, "SpaceMap of a curved whisker")
        return replace(forward, azimuth=np.asarray(contact, dtype=float)[..., 2] - self.roll)

    def farthest(self, whisker: Whisker) -> float:
        return self.forward(whisker, np.zeros(3)).reach

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        contact = np.asarray(contact, dtype=float)
        azimuth = contact[..., 2]
        place = contact.copy()
        place[..., 2] = 0.0 if _is_flat(forward_of(whisker), model) else azimuth - self.roll
        return self.from_plane(whisker, place, model=model)(azimuth)

    def from_plane(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> Callable[[Array], Encoded]:
        """The signals as a function of the azimuth (...) of contacts (..., 3).

        The third number of those is the azimuth from the plane of curvature, whatever its roll:
        a whisker that is rolled by as much as the azimuth is more has the same, turned by it.
        """
        forward = forward_of(whisker, model)
        self.forward(whisker, np.zeros(3))  # refuses what it does not know
        r, push, turn = np.moveaxis(contact, -1, 0)
        if _is_flat(forward, model):
            sizes, outcome = forward.signals(r, push)
            moment, axial, across = np.moveaxis(sizes, -1, 0)
            zero = np.zeros_like(moment)
            force, bending, twist = (across, zero), (moment, zero), zero
            signed = True
        else:
            six, outcome = replace(forward, azimuth=turn).in_space(r, push)
            axial, y, z, twist, m_y, m_z = np.moveaxis(six, -1, 0)
            # Along the push and across it.
            c, s = np.cos(turn), np.sin(turn)
            force = c * y + s * z, c * z - s * y
            bending = c * m_z - s * m_y, -c * m_y - s * m_z
            signed = False

        def turned(azimuth: Array) -> Encoded:
            out = _named(self.signal_names, axial, force, twist, bending, azimuth, signed)
            # A direction that is no number is none of a contact.
            off = (outcome == Outcome.HELD) & ~np.isfinite(azimuth)
            found = np.where(off, np.int8(Outcome.OUT_OF_REACH), outcome)
            out[found != Outcome.HELD] = np.nan
            return out, found

        return turned

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        contact = np.asarray(contact, dtype=float)
        if self.all_but_one is None or not forward_of(whisker).is_flat:
            return super().jacobian(whisker, contact, model=model)
        out = np.zeros((*contact.shape[:-1], len(self.signal_names), 3))
        out[..., :-2, :2] = self.all_but_one.jacobian(whisker, contact[..., :2], model=model)
        out[..., -2:, 2] = 1.0
        return out

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Flat all around, of the azimuth."""
        return {"azimuth": scipy.stats.uniform(-np.pi, 2 * np.pi)}

    def default_noise(self) -> ReceptorNoise:
        """Weber's law, k = 0.1, for sizes and components; as much across them: 0.1 rad."""
        kinds = [name.endswith(("direction", "angle")) for name in self.signal_names]
        runs = [(angle, len(list(group))) for angle, group in groupby(kinds)]
        noises = [GeneralisedWeber(0, floor=0.1) if angle else Weber(0.1) for angle, _ in runs]
        return Joint(noises, sizes=[n for _, n in runs]) if len(runs) > 1 else noises[0]


def _is_flat(forward: ForwardModel, model: str | None) -> bool:
    """Whether the whisker bends in the plane of its contact, or is taken to."""
    return forward.is_flat or model in ("elastica", "closed_form")


def _named(
    names: Sequence[str],
    axial: Array,
    force: tuple[Array, Array],
    twist: Array,
    bending: tuple[Array, Array],
    azimuth: Array,
    signed: bool,
) -> Array:
    """The signals named (..., S), from forces and moments (along the push, across it).

    A vector that points away from the push has a negative size where sizes are signed, so that the
    directions of a straight whisker are the azimuth itself.
    """
    c, s = np.cos(azimuth), np.sin(azimuth)
    out = []
    for name in names:
        ahead, aside = bending if name.startswith("moment") else force
        if name == "axial_force":
            value = axial
        elif name == "torsion":
            value = twist
        elif name == "torsion_angle":
            value = np.arctan2(twist, np.hypot(*bending))
        elif name.endswith("_direction"):
            value = azimuth if signed else azimuth + _angle(ahead, aside)
        elif name in ("force_y", "moment_z"):
            value = c * ahead - s * aside
        elif name in ("force_z", "moment_y"):
            value = (s * ahead + c * aside) * (-1.0 if name == "moment_y" else 1.0)
        else:
            value = ahead if signed else np.hypot(ahead, aside)
        out.append(np.broadcast_to(value, np.broadcast_shapes(azimuth.shape, ahead.shape)))
    return np.stack(out, axis=-1)


def _angle(ahead: Array, aside: Array) -> Array:
    """Angles (...) from the push, from −π/2 to 3π/2, so that none near 0 or π jumps by a turn."""
    turned: Array = np.arctan2(-ahead, aside)  # from −π at −π/2
    return np.asarray(turned + np.pi / 2)
