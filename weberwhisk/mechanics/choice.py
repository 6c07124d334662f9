"""The cheapest model whose bias in the inferred radial distance is a small part of its JND.

An observer who takes a model for the truth reads each signal s wrong by δ. Under Weber noise of sd
k·s the least-squares estimate of the unknowns moves by (JᵀWJ)⁻¹JᵀWδ with W = 1/(ks)², and the JND
of r (one observation's sd) is the root of the first diagonal element of (JᵀWJ)⁻¹. In relative
signals, with g_r and g_θ the columns of ∂ln s/∂(r, θ_d) and q the unit vector along g_r (less its
part along g_θ where the deflection angle is unknown too), their ratio is

    bias/JND = |q · δ/s| / k:

the relative error along the one direction of signals that tells of r. One signal: |δ/s|/k.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import finite, positive
from ..whisker import Whisker
from .chebyshev import Array
from .contact import SIGNAL_UNIT, Choice, Model
from .estimates import Estimates, estimate
from .natural_units import Scenes, friction
from .scene import Scene
from .shape import Profile

#: A model is taken where its estimated bias is below the tolerance by this factor.
MARGIN = 1.1
#: Rows of the base signals that a cue can feel; a rate at a given speed is as good.
_ROWS = {"moment": 0, "moment_rate": 0, "axial_force": 1, "transverse_force": 2}
_UNKNOWNS = (("radial_distance",), ("radial_distance", "deflection_angle"))


def choose_model(
    whisker: Whisker | Profile,
    radial_distance: ArrayLike,
    deflection_angle: ArrayLike,
    friction_angle: ArrayLike = 0.0,
    *,
    roll: ArrayLike = 0.0,
    cue: Any = None,
    weber_fraction: ArrayLike | None = 0.1,
    tolerance: ArrayLike = 0.1,
) -> Choice:
    """The cheapest model of the ladder that each scene needs, and why.

    Parameters
    ----------
    whisker : Whisker or Profile
    radial_distance, deflection_angle, friction_angle, roll : float or array
        The scenes, as for `press`.
    cue : object with `signal_names` and `unknowns`, optional
        Which signals tell of the distance, such as ``cues.ForceMap()``; by default the moment at a
        known deflection angle, as in ``cues.Compliance()``.
    weber_fraction : float or array, or None
        k of each signal's noise. None judges the signals themselves, whatever is made of them.
    tolerance : float or array
        Largest bias of the inferred radial distance, as a fraction of its JND; without a Weber
        fraction the largest relative error of the moment and the two forces.

    Returns
    -------
    Choice
        With arrays of the broadcast shape.

    Raises
    ------
    ValueError
        As for `press`, for a Weber fraction or a tolerance that is not positive, and for a cue of
        signals that are not among moment, axial and transverse force.

    Notes
    -----
    To first order in the error. Errors are estimated by the first Newton step of the next model up
    (`estimates`), which costs a few µs a scene, some 50 in space: choose once, and use the choice
    for the thousands of contacts of a posterior (``press(..., model=choice)``).

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, curvature=0.5)
    >>> choice = choose_model(w, 25e-3, np.radians([1.0, 20.0]), weber_fraction=0.1)
    >>> choice.model
    array([0, 1], dtype=int8)
    >>> print(choice.why[1])
    the straight elastica is off by 0.039 JND; the closed form is off by 1 JND, 0.1 allowed
    """
    names, unknowns = _spec(cue)
    scenes = Scenes.of(
        whisker,
        length=positive("radial_distance", radial_distance, "give metres, such as 35e-3"),
        angle=finite("deflection_angle", deflection_angle, "give radians, such as 0.35"),
        tilt=friction(friction_angle),
        roll=finite("roll", roll, "give radians, 0 for contact in the plane of curvature"),
        weber_fraction=positive(
            "weber_fraction",
            1.0 if weber_fraction is None else weber_fraction,
            "give a fraction, such as 0.1",
        ),
        tolerance=positive("tolerance", tolerance, "give a fraction, such as 0.1"),
    )
    n, shape = scenes.length.size, scenes.shape
    error, bias, model = np.empty((4, n)), np.empty((4, n)), np.empty(n, dtype=np.int8)
    for part, rows, (r, theta, psi, turn, k, allowed) in scenes.pieces():
        found = estimate(Scene.of(rows, r, theta, psi, turn))
        error[:, part], off = _relative(found, [_ROWS[name] for name in names], unknowns)
        bias[:, part] = error[:, part] if weber_fraction is None else off / k
        model[part] = np.argmax(bias[:, part] * MARGIN <= allowed, axis=0)
    return Choice(
        model.reshape(shape) if shape else Model(int(model[0])),
        error.T.reshape(*shape, 4),
        bias.T.reshape(*shape, 4),
        tolerance,
        SIGNAL_UNIT if weber_fraction is None else "JND",
    )


def _spec(cue: Any) -> tuple[tuple[str, ...], bool]:
    """The names of the signals, and whether the deflection angle is unknown."""
    if cue is None:
        return ("moment",), False
    names, unknowns = tuple(cue.signal_names), tuple(cue.unknowns)
    if not set(names) <= set(_ROWS) or unknowns not in _UNKNOWNS or len(names) < len(unknowns):
        raise ValueError(
            f"The ladder judges cues of {', '.join(_ROWS)} with no more unknowns "
            f"(radial_distance, deflection_angle) than signals, got {', '.join(names)} for "
            f"{', '.join(unknowns)}; write cue=weberwhisk.cues.ForceMap()."
        )
    return names, unknowns == _UNKNOWNS[1]


def _relative(found: Estimates, felt: list[int], angle_unknown: bool) -> tuple[Array, Array]:
    """Largest relative error of any signal, and that along the direction of r, each (4, n)."""
    with np.errstate(all="ignore"):
        relative = np.where(found.misses == 0, 0.0, found.misses / found.signals)
        slopes = found.slopes[felt] / found.signals[felt][:, None]
        off = np.abs((_direction(slopes, angle_unknown) * relative[:, felt]).sum(axis=1))
    worst = np.nan_to_num(np.abs(relative), nan=np.inf, posinf=np.inf).max(axis=1)
    # Where the slopes are lost, as at a fold, the worst signal is what there is.
    return worst, np.where(np.isfinite(off), off, worst)


def _direction(slopes: Array, angle_unknown: bool) -> Array:
    """The unit vector of relative signals (S, n) that tells of r, from ∂ln s/∂(r, θ_d)."""
    to_r, to_angle = slopes[:, 0], slopes[:, 1]
    if len(to_r) == 1:
        return np.ones_like(to_r)
    if angle_unknown and len(to_r) == 2:  # also where the two columns are parallel: a ridge
        q: NDArray[np.float64] = np.stack([to_angle[1], -to_angle[0]])
    elif angle_unknown:
        q = to_r - to_angle * (to_angle * to_r).sum(axis=0) / (to_angle**2).sum(axis=0)
    else:
        q = to_r
    return np.asarray(q / np.sqrt((q**2).sum(axis=0)))
