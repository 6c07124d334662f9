"""The domain in which every number is true, or flagged by its own error estimate.

``docs/theory/engines.md`` has its table. Outside, numbers may still be right, and one flag says
what lies outside: `outside_domain` of a `Bending`, `Status.OUTSIDE_DOMAIN` of a posterior. What can
only be a slip of units (a whisker of 41 m) is refused where it is given.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike

from ._util.refusals import Refusal

__all__ = [
    "CONTACTS", "FITTED_WEBER_FRACTIONS", "LENGTHS", "RADIUS_RATIOS", "TRIALS", "WEBER_FRACTIONS",
    "of_contact", "of_observer", "of_weber_fractions", "of_whisker", "refuse_length", "sentence",
]  # fmt: skip

#: Lengths of whiskers, m: rats' whiskers are 5 to 60 mm long, seals' to 480 mm.
LENGTHS = (2e-3, 0.2)
#: Base radius over tip radius; a perfect cone, whose ratio is infinite, is inside as well.
RADIUS_RATIOS = (1.0, 1000.0)
#: Radial distance over the largest one that can be reached.
CONTACTS = (0.01, 1.0)
#: Weber fractions of receptors.
WEBER_FRACTIONS = (0.01, 0.6)
#: Weber fractions that fits and plans may find.
FITTED_WEBER_FRACTIONS = (0.01, 3.0)
#: Trials of a fit or a plan.
TRIALS = (1, 10**6)


def refuse_length(length: ArrayLike, base_radius: ArrayLike) -> None:
    """Refuse whiskers that can only be a slip of units: longer than 20 m, or wider than long."""
    longest = float(np.max(length))
    if longest > 100 * LENGTHS[1]:
        raise Refusal(
            f"A whisker of {longest:g} m is none: did you pass millimetres?",
            remedy=f"write {longest / 1e3:g} for {longest:g} mm",
        )
    # A stub of the radius's own length is an exercise in scaling, a wider one is no beam.
    wide = np.asarray(base_radius) > np.asarray(length)
    if np.any(wide):
        at = np.broadcast_to(base_radius, wide.shape)[wide].flat[0]
        raise Refusal(
            "The base must not be wider than the whisker is long",
            f"base_radius {at:g} m: did you pass micrometres or millimetres?",
            "write 100e-6 for 100 µm",
        )


def hint_at_curvature(curvature: ArrayLike, length: ArrayLike) -> None:
    """Warn of curvatures that no whisker has in 1/m and all have in 1/mm: by how far they turn."""
    curvature, length = np.broadcast_arrays(curvature, length)
    turn = np.abs(curvature * length)
    if np.any(slip := (turn > 1e-4) & (turn < 2e-3)):
        at = float(curvature[slip].flat[0])
        warn(
            f"curvature is in 1/m, got {at:g}: did you pass 1/mm? Write {1e3 * at:g}.",
            stacklevel=4,
        )


def of_whisker(whisker: Any) -> tuple[str, ...]:
    """What of a whisker lies outside, a sentence each; none if nothing does."""
    whisker = getattr(whisker, "whisker", whisker)  # of a profile
    ratio = np.asarray(whisker.radius_ratio)
    ratio = np.where(np.isinf(ratio), 1.0, ratio)
    low, high = (f"{1e3 * end:g}" for end in LENGTHS)
    where = f"where whiskers are {low} to {high} mm long"
    out = [f"a length of {1e3 * v:g} mm, {where}" for v in _beyond(whisker.length, LENGTHS)]
    where = f"where 1 to {RADIUS_RATIOS[1]:g} and the perfect cone are covered"
    out += [f"a radius ratio of {v:g}, {where}" for v in _beyond(ratio, RADIUS_RATIOS)]
    return tuple(out)


def of_contact(radial_distance: ArrayLike, reach: ArrayLike) -> tuple[str, ...]:
    """What of radial distances lies outside, a sentence each."""
    share = np.asarray(radial_distance, dtype=float) / np.asarray(reach, dtype=float)
    where = f"where {CONTACTS[0]:g} to {CONTACTS[1]:g} are covered"
    return tuple(f"a contact at {v:g} of the reach, {where}" for v in _beyond(share, CONTACTS))


def of_weber_fractions(
    weber_fractions: ArrayLike, covered: tuple[float, float] = WEBER_FRACTIONS
) -> tuple[str, ...]:
    """What of Weber fractions lies outside, a sentence each; 0 stands for none."""
    k = np.asarray(weber_fractions, dtype=float)
    hint = ": did you pass per cent?" if np.max(k, initial=0.0) > 1 else ""
    where = f"where {covered[0]:g} to {covered[1]:g} are covered{hint}"
    return tuple(f"a Weber fraction of {v:g}, {where}" for v in _beyond(k[k > 0], covered))


def of_observer(observer: Any) -> tuple[str, ...]:
    """What of an observer's whisker and receptors lies outside, a sentence each."""
    return of_whisker(observer.whisker) + of_weber_fractions(observer.usual_weber_fractions)


def sentence(outside: Iterable[str]) -> str:
    """All that lies outside, in one sentence; empty if nothing does."""
    sentences = list(outside)
    return f"Outside the domain: {'; '.join(sentences)}." if sentences else ""


def _beyond(values: Any, ends: tuple[float, float]) -> list[float]:
    """The least and the largest of what lies beyond either end."""
    array = np.asarray(values, dtype=float)
    low, high = array[array < ends[0] * (1 - 1e-9)], array[array > ends[1] * (1 + 1e-9)]
    return [float(f(side)) for f, side in ((np.min, low), (np.max, high)) if side.size]
