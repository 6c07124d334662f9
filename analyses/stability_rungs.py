"""The rungs' part of `stability.py`: every rung held against SciPy's DOP853 in raw SI units.

A case is a whisker (any taper, curvature) against a point at a share of its length and at a share
of the angle at which it flicks past, with friction. The reference walks the branch from rest on
its own, and says whether there is an equilibrium as well as what is felt there.
"""

from __future__ import annotations

import numpy as np
from fault_search import Axis, Domain, Fate, Judged
from reference_beam import Beams

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics.rod import RodBending

Array = np.ndarray
Case = dict[str, Array]

LENGTH, BASE, MODULUS = 50e-3, 100e-6, 3e9
#: Relative error up to which a rung that claims less is forgiven: what `press` asks of rung 2.
TOLERANCE = 1e-9
#: Times a claimed error up to which it has been said: estimates are above the true error nearly,
#: not always, and next to a fold, where they go with the root of what is left, half of it at times.
SAID = 3.0
#: Claimed errors from which the claim is a warning, and says that no digit can be relied on.
ROUGH, HOPELESS = 0.01, 0.3
#: Share of the last angle, and radians, about which a walk in steps does not know on which side
#: of it it is: the angle is level at a fold, not so at the tip.
UNDECIDED, LAST_STEP = 1e-5, 3e-4
#: Contact's give out of the plane, in r per the force that turns it by a radian, that is not zero.
SIDEWAYS = 1e-3
SIGNALS = ("moment", "axial_force", "transverse_force")

STRAIGHT = {
    "distance": Axis(0.01, 1.02, special=(1.0,)),
    "push": Axis(1e-4, 1.3, special=(1.0,)),
    "tip": Axis(0.0, 1.0, special=(0.05,)),
}
CURVED = {
    **STRAIGHT,
    "push": Axis(-1.3, 1.3, special=(-1.0, 0.0, 1.0)),
    "tip": Axis(0.01, 1.0, special=(0.05,)),
    "curvature": Axis(-1.5, 1.5, special=(0.0,)),
    "friction": Axis(-0.7, 0.7, special=(0.0,)),
}


def _scene(case: Case) -> tuple[ww.Whisker, Beams, Array, Array, Array]:
    """Whisker, the same for the reference, distance, angle and friction of each case."""
    n = case["distance"].size
    zero = np.zeros(n)
    curvature, friction = case.get("curvature", zero) / LENGTH, case.get("friction", zero)
    tip = BASE * case["tip"]
    whisker = ww.Whisker(LENGTH, BASE, tip, MODULUS, curvature)
    beams = Beams(zero + LENGTH, zero + BASE, tip, zero + MODULUS, curvature, friction)
    r = case["distance"] * LENGTH
    side = np.where(case["push"] < 0, -1.0, 1.0)
    end = ww.flick_past(whisker, r, friction, side=side).deflection_angle
    _, rest = beams.at_rest(r)
    # Where the package knows no last angle, a case is placed all the same.
    end = np.where(np.isfinite(end), end, np.nan_to_num(rest) + side)
    theta = np.nan_to_num(rest) + np.abs(case["push"]) * (end - np.nan_to_num(rest))
    return whisker, beams, r, np.clip(theta, -np.pi, np.pi), friction  # `press` refuses more


def _press(
    whisker: ww.Whisker, rung: str, r: Array, theta: Array, friction: Array
) -> ww.mechanics.Bending:
    return ww.press(whisker, r, theta, friction, model=rung)


def answered(
    bent: ww.mechanics.Bending | RodBending, exists: Array, error: Array, own: Array
) -> tuple[Array, Array, Array]:
    """Fates of what is held where something is, ln of true over admitted error, what is hopeless.

    `own` is the reference's error. What is not held is refused, so far.
    """
    held, claimed = np.asarray(bent.outcome) == Outcome.HELD, np.nan_to_num(bent.error, nan=np.inf)
    with np.errstate(all="ignore"):
        allowed = np.maximum(SAID * bent.error, TOLERANCE) + 3 * own
        excess = np.log(np.maximum(error, 1e-300) / allowed)
    fate = np.full(held.size, Fate.REFUSED)
    right = held & exists & (error <= allowed)
    fate[right] = np.where(claimed[right] > ROUGH, Fate.WARNED, Fate.RIGHT)
    # A claimed error of a third and more says that no digit is to be relied on.
    hopeless = claimed > HOPELESS
    fate[held & exists & (error > allowed)] = Fate.SILENT
    fate[held & exists & hopeless] = Fate.WARNED
    return fate, np.where(hopeless, np.minimum(excess, 0.0), excess), hopeless


def told(
    fate: Array,
    excess: Array,
    bent: ww.mechanics.Bending | RodBending,
    exists: Array,
    error: Array,
    reference: Array,
) -> Judged:
    """The judgement, with what was seen."""
    outcome = np.asarray(bent.outcome)
    compared = (outcome == Outcome.HELD) & exists
    excess = np.where(compared, excess, np.where(fate == Fate.SILENT, 50.0, -np.inf))
    seen = {"outcome": outcome, "error": np.where(compared, error, np.nan), "claimed": bent.error}
    return Judged(fate, excess, {**seen, "reference": reference})


def judge(case: Case, rung: str) -> Judged:
    """Each case pressed by a rung, beside the reference."""
    whisker, beams, r, theta, friction = _scene(case)
    if rung in ("closed_form", "elastica"):
        whisker = ww.Whisker(LENGTH, BASE, BASE * case["tip"], MODULUS)
    bent = _press(whisker, rung, r, theta, friction)
    held = np.asarray(bent.outcome) == Outcome.HELD
    walk = beams.walk(r, theta)
    there = (walk["end"] == 0) | (held & (walk["end"] != 3))
    # From the walk's own end; where it ended in doubt, from the rung's contact.
    near = np.abs(walk["angle"] - theta) < np.maximum(UNDECIDED * np.abs(theta), LAST_STEP)
    near |= np.abs(np.abs(case["push"]) - 1) < UNDECIDED  # at the very end that `flick_past` names
    own_start, lost_way = walk["end"] == 0, walk["end"] == 4
    lost = ~np.isfinite(bent.arc_length)
    arc = np.where(own_start | lost, walk["arc"], bent.arc_length)
    force = np.where(own_start | lost, walk["force"], bent.force)
    exact = beams.polish(r, theta, np.minimum(arc, LENGTH), force, steps=6)
    with np.errstate(all="ignore"):
        solved = (exact["left"] < 1e-7) & (exact["force"] * (theta - walk["rest"]) >= 0)
        solved &= exact["arc"] <= LENGTH * (1 + 1e-12)
        # A walk that lost its way settles nothing: a stable contact found from the rung's will do.
        stable = (near | lost_way) & (exact["det"] * beams.scale(r) > 0)
        exists = there & solved & (own_start | stable)
        least = (
            1e-3 * np.abs(exact["force"]) * np.stack([r, np.minimum(np.abs(theta), 1), 1 + 0 * r])
        )
        size = np.maximum(np.abs([exact[k] for k in SIGNALS]), least)
        error = np.max(np.abs([getattr(bent, k) - exact[k] for k in SIGNALS]) / size, axis=0)
        own = np.max(exact["own"] / size, axis=0)
    # An angle nearer to the branch's end than the walk resolves settles nothing by itself.
    doubt = near & ~exists
    at_tip = np.abs(np.where(lost, walk["arc"], bent.arc_length) / LENGTH - 1) < 1e-7
    fate, excess, hopeless = answered(bent, exists, error, own)
    # Held where nothing is: a warning if the claimed error says that anything may be.
    nothing = held & ~exists & ~doubt & ~at_tip
    fate[nothing] = np.where(hopeless[nothing], Fate.WARNED, Fate.SILENT)
    fate[held & ~exists & (doubt | at_tip)] = Fate.WARNED
    fate[held & ~exists & (lost_way | ~np.isfinite(exact["moment"]))] = Fate.UNJUDGED
    refused = ~held & exists & ~at_tip & ~near
    if rung == "rod":
        # In space a whisker may leave the plane where in it all is well: it is past the contact.
        give = np.full(r.size, np.inf)
        give[exists] = beams.take(exists).sideways(exact["arc"][exists], exact["force"][exists])
        give = give * beams.scale(r) / r
        gone, calm = give < -SIDEWAYS, give > SIDEWAYS
        fate[held & exists & gone] = Fate.SILENT
        refused &= calm
    # Refused where there is an equilibrium, by more than the last digits of its end.
    fate[refused] = Fate.SILENT
    return told(fate, excess, bent, exists, error, walk["end"])


DOMAINS = [
    Domain("closed form", STRAIGHT, lambda case: judge(case, "closed_form")),
    Domain("elastica", STRAIGHT, lambda case: judge(case, "elastica")),
    Domain("profile", CURVED, lambda case: judge(case, "profile")),
    Domain("rod, in the plane", CURVED, lambda case: judge(case, "rod")),
]
