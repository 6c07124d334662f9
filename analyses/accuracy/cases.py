"""The cases of the referee: observers and readings, drawn at random and written down as JSON.

A case is rebuilt from its row alone: `observer_of` makes the observer, and the reading is stored.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import weberwhisk as ww
from weberwhisk import cues, receptors

Array = NDArray[np.float64]

#: Readings of each kind among 500.
COUNTS = {
    "taper": 70,
    "cylinder": 20,
    "curved": 45,
    "friction": 45,
    "curved and friction": 20,
    "fusion": 50,
    "one unknown": 30,
    "unknown stiffness": 44,
    "unknown curvature": 44,
    "unknown hinge": 44,
    "unknown friction": 44,
    "space, straight": 22,
    "space, curved": 22,
}
EDGES = ("base", "tip", "flick-past", "light")
#: Sd of a direction and of an angle of balance, rad.
DIRECTION_SD, ANGLE_SD = 0.1, float(np.radians(1.0))
#: Signals that may change sign.
SIGNED = ("axial_force", "transverse_force")


@dataclass(frozen=True)
class Case:
    """One reading of one observer.

    Attributes
    ----------
    kind, edge : str
        What sort of observer, and at which edge of the domain the contact is ("" for none).
    spec : dict
        The observer: fields of the whisker, the cue as nested lists, the noise as groups.
    contact, reading : list of float
        The true contact and the reading drawn from it.
    """

    kind: str
    edge: str
    spec: dict[str, Any]
    contact: list[float]
    reading: list[float]


def observer_of(spec: dict[str, Any]) -> ww.Observer:
    """The observer of a stored case.

    Parameters
    ----------
    spec : dict
        As in the column ``observer`` of the table.

    Returns
    -------
    Observer
    """
    groups = spec["noise"]
    noises = [_noise(group) for group in groups]
    sizes = [len(group["k"]) for group in groups]
    noise = receptors.Joint(noises, sizes) if len(groups) > 1 else noises[0]
    return ww.Observer(ww.Whisker(**spec["whisker"]), cue_of(spec["cue"]), noise)


def cue_of(spec: list[Any]) -> cues.Cue:
    """The cue of a nested list: its name, its fields, then the cues that it is made of."""
    name, fields, *inner = spec
    return getattr(cues, name)(*map(cue_of, inner), **fields)


def _noise(group: dict[str, Any]) -> receptors.ReceptorNoise:
    k, floor, rho = group["k"], group["floor"], group["rho"]
    if not np.any(floor):
        return receptors.Weber(k, correlation=rho)
    return receptors.GeneralisedWeber(k, floor=floor, correlation=rho)


def largest_angle(cue: cues.Cue, whisker: ww.Whisker, contact: Array) -> Array:
    """Largest deflection (n,) that is held at contacts (n, U), rad; 0 where there is none."""
    forward = cue.forward(whisker, contact)
    limit = np.broadcast_to(forward.limit(contact[:, 0]), contact.shape[:1])
    works = cue.largest_angle(forward if cue.takes_curved else whisker, contact[:, 0])
    return np.maximum(np.nan_to_num(np.minimum(limit, works)), 0.0)


# -- drawing -------------------------------------------------------------------------------------


def draw(index: int, seed: int) -> Case:
    """The case of an index; the same for the same seed.

    Whiskers that the package refuses (strongly curved ones without a table) are drawn anew, and
    those so nearly straight that the observer leaves their curvature out.

    Parameters
    ----------
    index, seed : int

    Returns
    -------
    Case
    """
    kinds = [kind for kind, count in COUNTS.items() for _ in range(count)]
    order = np.random.default_rng(seed).permutation(len(kinds))
    kind = kinds[order[index % len(kinds)]]
    rng = np.random.default_rng([seed, index])
    edge = str(rng.choice(EDGES)) if rng.random() < 1 / 3 else ""
    for _ in range(200):
        spec = _spec(kind, rng)
        try:
            whisker, cue = ww.Whisker(**spec["whisker"]), cue_of(spec["cue"])
            spec["noise"] = _groups(spec, whisker, cue, rng)
            observer = observer_of(spec)
            contact = _contact(spec, edge, whisker, cue, rng)
            reading = observer.read(contact, rng)
        except ValueError:
            continue
        if observer.solver is not None:  # a cheaper model was chosen, which may not be for ever
            continue
        turned = np.flatnonzero(cue.circular)
        if turned.size:  # the second direction in the turn that is nearest to the first
            first = reading[turned[0]]
            reading[turned] -= 2 * np.pi * np.round((reading[turned] - first) / (2 * np.pi))
        if "deflection_angle" not in cue.unknowns and edge in EDGES[2:]:
            edge = ""
        return Case(kind, edge, spec, contact.tolist(), reading.tolist())
    raise RuntimeError(f"No case of kind {kind!r} at index {index}.")


def _digits(value: float, count: int = 5) -> float:
    return float(f"{value:.{count}g}")


def _spec(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """Whisker and cue of a kind."""
    base, length = rng.uniform(60e-6, 120e-6), rng.uniform(20e-3, 60e-3)
    ratio = np.exp(rng.uniform(np.log(5), np.log(40)))
    curvature = hinge = None
    plane: list[Any] = ["ForceMap", {}]
    cue = plane
    angle = _digits(np.radians(rng.uniform(-26, 26)))
    if kind == "cylinder":
        ratio = 1.0
    if kind in ("curved", "curved and friction"):
        curvature = rng.uniform(-25, 25)
    if kind in ("friction", "curved and friction"):
        cue = ["Friction", {"angle": angle}, plane]
    if kind == "unknown stiffness":
        cue = ["UnknownStiffness", {"spread": 0.42}, plane]
    if kind == "unknown curvature":
        curvature = rng.choice([0.0, rng.uniform(-10, 10)])
        length = rng.uniform(15e-3, 45e-3)
        cue = ["UnknownCurvature", {"spread": _digits(rng.uniform(1, 3), 3)}, plane]
    if kind == "unknown hinge":
        hinge = np.exp(rng.uniform(np.log(1e-5), np.log(4e-5)))
        cue = ["UnknownHinge", {"spread": 0.3}, plane]
    if kind == "unknown friction":
        curvature = rng.choice([0.0, rng.uniform(-15, 15)])
        cue = ["Friction", {}, plane]
    if kind.startswith("space"):
        curvature = rng.uniform(-10, 10) if kind.endswith("curved") else 0.0
        cue = ["SpaceMap", {}]
    if kind == "fusion":
        cue, curvature = _fusion(angle, rng)
    if kind == "one unknown":
        tap = {"tap_angle": _digits(rng.uniform(0.05, 0.4), 3)}
        known = {"deflection_angle": _digits(rng.uniform(0.05, 0.6), 3)}
        impact = {"impact_angle": _digits(rng.uniform(0.9, 1.4), 3)}
        several: list[list[Any]] = [
            ["Compliance", {}],
            ["Compliance", tap],
            ["Vibration", {"count": 2}],
            ["Vibration", {"count": 3}],
            ["BalanceOfMoments", impact],
            ["ForceMap", known],
            ["Fused", {}, ["Compliance", {}], ["Vibration", {"count": 2}]],
        ]
        cue = several[rng.integers(len(several))]
    whisker = {
        "length": _digits(length),
        "base_radius": _digits(base),
        "tip_radius": _digits(base if ratio == 1 else base / ratio),
        "youngs_modulus": 3e9,
        "curvature": _digits(curvature or 0.0),
    }
    if ratio == 1:
        whisker["tip_radius"] = whisker["base_radius"]
    if hinge is not None:
        whisker["hinge_stiffness"] = _digits(hinge)
    return {"whisker": whisker, "cue": cue}


def _fusion(angle: float, rng: np.random.Generator) -> tuple[list[Any], float]:
    """A fusion of two unknowns, and the curvature of its whisker, 1/m."""
    plane, tap = ["ForceMap", {}], ["Compliance", {}]
    across = ["ForceMap", {"signal_names": ["moment", "transverse_force"]}]
    felt = ["BalanceOfMoments", {"effort": None}]
    which = rng.integers(6)
    if which == 0:
        return ["Fused", {}, tap, plane], float(rng.choice([0.0, rng.uniform(-20, 20)]))
    if which == 1:
        return ["Fused", {}, plane, ["Vibration", {"count": int(rng.integers(2, 4))}]], 0.0
    if which == 2:
        return ["Fused", {}, plane, across], 0.0
    if which == 3:
        return ["Fused", {}, felt, plane], 0.0
    if which == 4:
        return ["Friction", {"angle": angle}, ["Fused", {}, tap, plane]], 0.0
    return ["Fused", {}, tap, across], 0.0


def _groups(
    spec: dict[str, Any], whisker: ww.Whisker, cue: cues.Cue, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """The noise, one group for each run of signals with a law of its own."""
    k = _digits(np.exp(rng.uniform(np.log(0.03), np.log(0.3))), 4)
    names = [name.rstrip("_0123456789") for name in cue.signal_names]
    text = json.dumps(spec["cue"])
    bends = (
        whisker.curvature != 0
        or "Friction" in text
        or "UnknownCurvature" in text
        or "SpaceMap" in text
        or "transverse_force" in text
    )
    usual = np.zeros(len(names))
    if bends:
        usual = _usual(whisker, cue)
    floor = [
        _digits(0.01 * usual[i]) if bends and name in SIGNED else 0.0
        for i, name in enumerate(names)
    ]
    sharp = _digits(np.exp(rng.uniform(np.log(0.03), np.log(0.3))), 4)  # of cues fused with it
    groups: list[dict[str, Any]] = []
    before = ""
    for i, name in enumerate(cue.signal_names):
        sort, rho = name.split("_")[0], 0.0
        if sort == "mode":  # ratios to one amplitude: any two are correlated by ½
            own = _digits(np.sqrt(2) * sharp), 0.05
            rho = 0.5 if "mode_3_ratio" in cue.signal_names else 0.0
        elif "direction" in name:
            sort, own = "direction", (0.0, DIRECTION_SD)
        elif name == "balance_angle":
            sort, own = "effort", (0.0, _digits(ANGLE_SD))
        elif sort == "effort" or "rate" in name:
            own = sharp, 0.0
        else:
            sort, own = "force", (k, floor[i])
        if sort != before:
            groups.append({"k": [], "floor": [], "rho": rho})
        groups[-1]["k"].append(own[0])
        groups[-1]["floor"].append(own[1])
        before = sort
    return groups


def _usual(whisker: ww.Whisker, cue: cues.Cue) -> Array:
    """Magnitudes (S,) below which signals of three quarters of the contacts are."""
    share = (np.arange(24) + 0.5) / 24
    u, v = (a.ravel() for a in np.meshgrid(share, share))
    contact = np.zeros((u.size, len(cue.unknowns)))
    contact[:, 0] = cue.farthest(whisker) * u
    priors = cue.priors(whisker)
    for i, name in enumerate(cue.unknowns[2:], start=2):
        contact[:, i] = priors[name].ppf((np.arange(u.size) * 0.618 % 1) * 0.9 + 0.05)
    contact[:, 1] = v * largest_angle(cue, whisker, contact)
    signals, outcome = cue.signals(whisker, contact)
    return np.quantile(np.abs(signals[outcome == 0]), 0.75, axis=0)


def _contact(
    spec: dict[str, Any], edge: str, whisker: ww.Whisker, cue: cues.Cue, rng: np.random.Generator
) -> Array:
    """A contact that is held, at the edge named."""
    contact = np.zeros(len(cue.unknowns))
    ends = {"base": (0.01, 0.08), "tip": (0.93, 0.999)}.get(edge, (0.08, 0.93))
    contact[0] = cue.farthest(whisker) * rng.uniform(*ends)
    priors = cue.priors(whisker)
    for i, name in enumerate(cue.unknowns[2:], start=2):
        contact[i] = priors[name].ppf(np.clip(rng.random(), 0.006, 0.994))
    if len(contact) > 1:
        ends = {"flick-past": (0.95, 0.9999), "light": (0.001, 0.02)}.get(edge, (0.02, 0.95))
        contact[1] = rng.uniform(*ends) * largest_angle(cue, whisker, contact[None])[0]
    _, outcome = cue.signals(whisker, contact[None])
    if outcome[0] != 0:
        raise ValueError("This contact is not held.")
    return np.array([_digits(value, 8) for value in contact])
