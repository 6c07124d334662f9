"""What a cue is: signals of a contact, and which properties of the contact are unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..receptors import ReceptorNoise
from ..whisker import Whisker

Array = NDArray[np.float64]


@runtime_checkable
class Cue(Protocol):
    """One of the paper's methods (§2a–h): from a contact to the signals that tell of it.

    A contact is an array whose last axis holds the cue's unknowns: radial distance (m), then, if
    it is one, the deflection angle (rad), then whatever else is not known (a stiffness, a side, a
    bearing), each with a proper prior. The mechanics of a rung is named by `model`, ``None`` for
    the cheapest that the scene needs. A cue that works only up to some deflection has a further
    method, ``largest_angle(whisker, radial_distance)``, rad; one whose mechanics do not depend on
    its last unknown has the method ``given`` of the function of that name.
    """

    #: Names of the signals, in the order of the last axis of `signals`.
    signal_names: tuple[str, ...]
    #: Names of the unknowns, ``"radial_distance"`` first.
    unknowns: tuple[str, ...]

    def signals(
        self, whisker: Whisker, contact: Array, *, model: str | None = None
    ) -> tuple[Array, NDArray[np.int8]]:
        """Signals (..., S) of a contact (..., U), NaN where it is not held, and its `Outcome`."""

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Derivatives of the signals with respect to the unknowns, (..., S, U)."""

    def farthest(self, whisker: Whisker) -> float:
        """Largest radial distance at which the cue works on this whisker, m."""

    def priors(self, whisker: Whisker) -> Mapping[str, Any]:
        """Frozen SciPy distributions of all unknowns but radial distance and deflection angle."""

    def default_noise(self) -> ReceptorNoise:
        """Noise of the signals where the user names none."""


def straight(whisker: Any) -> None:
    """Refuse whiskers that no cue feels through: curved ones, and profiles.

    Raises
    ------
    ValueError

    Examples
    --------
    >>> straight(Whisker(50e-3, 100e-6, 5e-6))
    """
    if not isinstance(whisker, Whisker):
        raise ValueError(
            f"A cue needs a Whisker, so far a straight one, got a {type(whisker).__name__}; "
            "write Whisker(50e-3, 100e-6, 5e-6), say."
        )
    if np.any(whisker.curvature):
        raise ValueError(
            f"Cues are for straight whiskers so far, got curvature "
            f"{float(np.max(np.abs(whisker.curvature))):g} 1/m; write curvature=0."
        )


def given(
    cue: Cue, whisker: Whisker, contact: Array, *, model: str | None = None
) -> Callable[[Array], tuple[Array, NDArray[np.int8]]]:
    """Signals and outcome as a function of the last unknown (...), the others (..., U − 1) given.

    Examples
    --------
    >>> from weberwhisk.cues import Compliance, UnknownStiffness
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> felt = given(UnknownStiffness(Compliance()), w, np.array([[20e-3]]))
    >>> (felt(np.array([2.0]))[0] / felt(np.array([1.0]))[0]).tolist()
    [[2.0]]
    """
    if hasattr(cue, "given"):
        prepared: Callable[[Array], tuple[Array, NDArray[np.int8]]]
        prepared = cue.given(whisker, contact, model=model)
        return prepared

    def signals(last: Array) -> tuple[Array, NDArray[np.int8]]:
        return cue.signals(
            whisker, np.concatenate([contact, last[..., None]], axis=-1), model=model
        )

    return signals
