"""The rod out of its plane: part of `stability.py`, judged by `reference_rod.py`.

A case is a whisker whose plane of curvature is rolled, against a point that is pushed from where
the whisker rests, along a great circle about the base, in any direction: ``bearing`` off that
plane, by a share of the last angle that holds there.
"""

from __future__ import annotations

import numpy as np
from fault_search import Axis, Domain, Fate, Judged
from reference_beam import Beams
from reference_rod import LOST, NEVER, REACHED, Rods
from stability_rungs import (
    BASE,
    CURVED,
    LAST_STEP,
    LENGTH,
    MODULUS,
    UNDECIDED,
    Case,
    answered,
    told,
)

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics import rod

Array = np.ndarray

AXES = {
    **CURVED,
    "push": Axis(1e-4, 1.3, special=(1.0,)),
    "bearing": Axis(0.0, np.pi, special=(np.pi / 2,)),
    "roll": Axis(0.0, np.pi, special=(np.pi / 2,)),
}
#: Longest push, rad: short of a whole turn, past which a point does not tell how it got there.
MOST = 6.2
#: About half a turn no arc of a great circle is the shorter: rad.
HALF_TURN = 1e-6
#: Least determinant, over that at rest, that is not zero; own error past which nothing is known.
LEVEL, VAGUE = 1e-3, 0.01


def scene(case: Case) -> tuple[ww.Whisker, Rods, dict[str, Array], Array]:
    """Whisker, the same for the reference, its walk to the end, and the angle of the push, rad."""
    zero = np.zeros(case["distance"].size)
    tip, curvature = BASE * case["tip"], case["curvature"] / LENGTH
    whisker = ww.Whisker(LENGTH, BASE, tip, MODULUS, curvature)
    beams = Beams(zero + LENGTH, zero + BASE, tip, zero + MODULUS, curvature, case["friction"])
    r = case["distance"] * LENGTH
    rods = Rods.pushed(beams, r, case["roll"], case["bearing"])
    # Shares of what the reference finds to hold, in which nothing is taken from the package.
    walk = rods.walk(np.full(zero.size, MOST))
    reach = np.where((walk["end"] == NEVER) | (walk["angle"] <= 0), 1.0, walk["angle"])
    return whisker, rods, walk, np.minimum(case["push"] * reach, MOST)


def _press(whisker: ww.Whisker, rods: Rods, angle: Array) -> rod.RodBending:
    point, far = np.nan_to_num(rods.point(angle).T, nan=LENGTH), angle > np.pi
    return rod.press(whisker, point, rods.beams.friction, plane=rods.roll, round_back=far)


def _parts(force: Array, moment: Array) -> Array:
    """Sizes of axial and transverse force, torsion and bending."""
    return np.abs(
        [force[0], np.hypot(force[1], force[2]), moment[0], np.hypot(moment[1], moment[2])]
    )


def _differ(off_force: Array, off_moment: Array, force: Array, moment: Array) -> Array:
    """Relative size of errors of force and moment, as the rod claims it."""
    whole = np.repeat([np.linalg.norm(force, axis=0), np.linalg.norm(moment, axis=0)], 2, axis=0)
    least = np.maximum(_parts(force, moment), 1e-3 * whole)
    return np.max(_parts(off_force, off_moment) / least, axis=0)


def judge(case: Case) -> Judged:
    """Each case pressed by the rod, beside the reference."""
    whisker, rods, walk, angle = scene(case)
    bent = _press(whisker, rods, angle)
    held = np.asarray(bent.outcome) == Outcome.HELD
    end, point = walk["end"], rods.point(angle)
    force, arc, least = rods.at(walk["trail"], angle)
    margin = np.maximum(UNDECIDED * angle, LAST_STEP)
    near = np.abs(walk["angle"] - angle) < margin
    # From where the walk came by; where it ended in doubt, from the rod's contact.
    own_start = (end != NEVER) & (angle <= walk["angle"])
    lost = ((end == LOST) & ~own_start) | (np.abs(angle - np.pi) < HALF_TURN)
    # Where nothing is, shooting along a thin tip is slow, and settles nothing.
    sought = np.flatnonzero(own_start | (held & (near | lost)))
    found = rods.take(sought).polish(
        angle[sought],
        np.where(own_start, force, bent.force.T)[:, sought],
        np.minimum(np.where(own_start, arc, bent.arc_length), LENGTH)[sought],
    )
    exact = {k: np.full((*v.shape[:-1], angle.size), np.nan) for k, v in found.items()}
    for k, v in found.items():
        exact[k][..., sought] = v
    with np.errstate(all="ignore"):
        solved = (exact["left"] < 1e-7) & (exact["arc"] <= LENGTH * (1 + 1e-12))
        exists = solved & (end != NEVER) & (exact["det"] * walk["sign"] > 0)
        moment = np.cross(point, exact["force"], axis=0)
        doubt = exact["own"] / np.sqrt(3) * np.ones((3, 1))
        own = _differ(doubt, doubt * rods.distance, exact["force"], moment)
        error = _differ(
            bent.force.T - exact["force"], bent.moment.T - moment, exact["force"], moment
        )
    at_tip = np.abs(np.where(held, bent.arc_length, arc) / LENGTH - 1) < 1e-7
    fate, excess, hopeless = answered(bent, exists, error, own)
    nothing = held & ~exists
    fate[nothing] = np.where(hopeless[nothing] | near[nothing] | at_tip[nothing], Fate.WARNED,
                             Fate.SILENT)  # fmt: skip
    fate[nothing & (lost | own_start)] = Fate.UNJUDGED
    # Refused where the walk came by: with room to spare there, and all along?
    clear = ~near & ~at_tip & (least > LEVEL)
    fate[~held & own_start & exists] = Fate.UNJUDGED
    fate[~held & own_start & exists & clear] = Fate.SILENT
    fate[~held & (lost | (own_start & ~exists))] = Fate.UNJUDGED
    fate[held & exists & (own > VAGUE) & ~hopeless] = Fate.UNJUDGED
    return told(fate, excess, bent, exists, error, np.where(own_start, REACHED, end))


DOMAINS = [Domain("rod, out of the plane", AXES, judge)]
