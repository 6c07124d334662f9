"""What every cue tells of distance, on one whisker: the numbers behind the surveys' charts.

The JND of each cue against distance, by every route; which cue is best at every contact; what each
adds to the others; the posterior's ridge on a cylinder; and Weber's law in two dimensions (§3c),
the whole family between the paper's two limits.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from command import with_units
from gallery.lateral_slip import LateralSlip

from weberwhisk import Observer, Outcome, Status, Whisker, flick_past, jnd_curve, posterior, press
from weberwhisk.cues import (
    AngleSideAngle,
    BalanceOfMoments,
    ComparativeLength,
    Compliance,
    ContactAndDetachment,
    Cue,
    ForceMap,
    Friction,
    Fused,
    TwoWhiskers,
    Vibration,
    VibrissaLength,
)
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.mechanics.model_choice import of_shape_at_rest
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import added_information, fisher_jnd, weber_propagation
from weberwhisk.sensitivity.curves import linear_surface, up_to_the_fold
from weberwhisk.whisker import identities

Array = np.ndarray
WHISKER = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)
K = 0.1
#: Deflection where a cue does not say, rad.
ANGLE = np.radians(5.0)
SEED = 20110166
ARRAY = "which of three whiskers touch (b)"


#: Which of three whiskers touch: the other two are shorter, with bases 3 and 6 mm in front.
NEIGHBOURS = ComparativeLength(
    [0.8 * WHISKER.length, 0.6 * WHISKER.length], [[0.0, 3e-3], [0.0, 6e-3]]
)
#: One line a cue, in the order of the paper's sections.
CUES: dict[str, Cue] = {
    "whisker length (a)": VibrissaLength(),
    ARRAY: NEIGHBOURS,
    "angle-side-angle (c)": AngleSideAngle(),
    "two whiskers (c)": TwoWhiskers(),
    "contact and detachment (c)": ContactAndDetachment(),
    "vibration, 3 modes with phase (d)": Vibration(3, phase=True),
    "tap (e)": Compliance(),
    "tap, velocity felt (e)": Compliance(velocity_spread=0.5),
    "tap on a tilted surface (e)": LateralSlip(),
    "moment and axial force (f)": ForceMap(),
    "moment and both forces (f)": ForceMap(SIGNALS),
    "moment at a known angle (f)": ForceMap("moment", deflection_angle=ANGLE),
    "balance of moments (h)": BalanceOfMoments(),
}
#: Those that a contact of any distance and angle has.
MAPPED = ("vibration, 3 modes with phase (d)", "tap (e)", "moment and axial force (f)",
          "moment and both forces (f)")  # fmt: skip


def curves(points: int, draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """The JND of every cue by every route, a row for each cue and distance.

    Up to the tip for all of them: where a method does not work there its ``outcome`` says why.
    """
    tables, r = [], np.linspace(0.03, 0.97, points) * WHISKER.length
    for name, cue in CUES.items():
        angle = ANGLE if "deflection_angle" in cue.unknowns else None
        curve = jnd_curve(Observer(WHISKER, cue), r, angle, n_readings=draws, seed=seed)
        table = curve.table.reset_index()
        table.insert(0, "cue", name)
        tables.append(table.assign(place=r / WHISKER.length))
    return pd.concat(tables, ignore_index=True)


def curvatures(points: int, draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """JNDs of moment and axial force for observers that know a whisker's curvature and friction.

    Touched on the concave side, straight and on the convex side: curvatures of −1, 0 and 1 over the
    length; and straight, sliding inwards with a friction angle of −5°. ``model`` is the one each
    observer chose.
    """
    r, tables = np.linspace(0.05, 0.95, points) * WHISKER.length, []
    scenes = (("concave", -1, 0), ("straight", 0, 0), ("convex", 1, 0), ("rubbing", 0, -5))
    for name, turn, degrees in scenes:
        curved = replace(WHISKER, curvature=turn / WHISKER.length)
        cue = Friction(ForceMap(), np.radians(degrees)) if degrees else ForceMap()
        made = Observer(curved, cue, default_noise(curved, cue, K))
        table = jnd_curve(made, r, ANGLE, n_readings=draws, seed=seed).table.reset_index()
        table = table.assign(curvature_per_m=curved.curvature, friction_angle_deg=degrees)
        table = table.assign(whisker=name, model=str(made.model), place=r / WHISKER.length)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def taken_as_straight(rows: str = "ABCDE") -> pd.DataFrame:
    """How far a straight model of each of the rat's whiskers moves the distance, in JNDs.

    ``bias_jnd`` is what `Observer.note` says: the most of 16 contacts, by moment and axial force.
    """
    found = []
    for name in (name for name in identities() if name[0] in rows):
        straight = Observer(Whisker.from_identity(name), ForceMap(), Weber(K))
        bow = Whisker.from_identity(name, curved=True).curvature
        found.append((name, bow, of_shape_at_rest(straight)))
    return pd.DataFrame(found, columns=["identity", "curvature_per_m", "bias_jnd"])


#: What may fail otherwise than at an edge of the reach: by chance, or altogether.
FAILING: dict[str, Cue] = {
    **{
        name: CUES[name]
        for name in ("whisker length (a)", ARRAY, "angle-side-angle (c)",
                     "contact and detachment (c)", "moment and axial force (f)",
                     "balance of moments (h)")
    },
    "vibration, 6 damped modes (d)": Vibration(6, damping_ratio=0.2),
}  # fmt: skip


def outcomes(points: int, draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """What becomes of contacts and, by each cue's own method, of noisy readings of them.

    A row for each cue, distance (to a fifth beyond the tip) and `Outcome`: its ``share`` of the
    readings, or 1 where there is no reading.
    """
    rng, tables = np.random.default_rng(seed), []
    r = np.linspace(0.03, 1.2, points) * WHISKER.length
    for name, cue in FAILING.items():
        observer = Observer(WHISKER, cue)
        count = observer.bounded
        contact = observer.at_middle(np.stack([r, np.full(points, ANGLE)], axis=-1)[:, :count])
        signals, lost = observer.signals(contact)
        of_readings = np.repeat(lost[:, None], draws, axis=1)
        held = lost == Outcome.HELD
        if held.any():
            readings = observer.noise.sample(np.repeat(signals[held], draws, axis=0), rng)
            of_readings[held] = observer.reading_outcome(readings).reshape(-1, draws)
        for outcome in np.unique(of_readings):
            share = (of_readings == outcome).mean(axis=1)
            table = pd.DataFrame({"cue": name, "radial_distance_mm": 1e3 * r, "share": share})
            label = Outcome(int(outcome)).message.split(":")[0]
            tables.append(table.assign(outcome=label, place=r / WHISKER.length))
    return pd.concat(tables, ignore_index=True)


def best(points: int) -> pd.DataFrame:
    """Fisher JND of the mapped cues at contacts up to the last that is held.

    The name of the least is ``best``; ``limit_deg`` is the largest deflection at that distance,
    ``beyond`` what becomes of a contact beyond it, and ``share`` the deflection over the limit.
    """
    r = np.linspace(0.03, 0.99, points) * WHISKER.length
    share = np.linspace(0.02, 0.99, points)
    limit = np.asarray(flick_past(WHISKER, r).deflection_angle)
    lost = np.asarray(press(WHISKER, r, limit * 1.05).outcome)
    beyond = np.array([Outcome(int(k)).message.split(":")[0] for k in lost])
    place, part = (a.ravel() for a in np.meshgrid(np.arange(points), share, indexing="ij"))
    contact = np.stack([r[place], limit[place] * part], axis=-1)
    table = pd.DataFrame(contact, columns=["radial_distance", "deflection_angle"])
    table = table.assign(
        share=part, limit=limit[place], beyond=beyond[place], place=r[place] / WHISKER.length
    )
    for name in MAPPED:
        observer = Observer(WHISKER, CUES[name])
        table[name] = fisher_jnd(observer, contact[:, : len(observer.unknowns)])
    table["best"] = table[list(MAPPED)].idxmin(axis=1)
    return with_units(table, ["radial_distance", *MAPPED], ["deflection_angle", "limit"])


def bits(draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """What the mapped cues tell alone and add to the others."""
    fused = Fused(*(CUES[name] for name in MAPPED[:3]))
    table = added_information(Observer(WHISKER, fused), n_readings=draws, seed=seed)
    table["cue"] = [*MAPPED[:3], "all three"]
    return table


#: The contact whose reading has the posteriors of `ridge`: r over the length, θ_d in rad.
RIDGE = (0.5, 0.3)


def ridge(draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """Draws from the posterior of one reading of M and Fx, tapered and cylindrical; its status."""
    tables = []
    for name, shape in (("tapered", WHISKER), ("cylinder", WHISKER.cylinder())):
        observer = Observer(shape, ForceMap(), Weber(0.03))
        reading = observer.signals([RIDGE[0] * WHISKER.length, RIDGE[1]])[0]
        found = posterior(observer, reading)
        drawn = found.solution.draws(draws // 4, seed)[0].reshape(-1, 2)
        table = pd.DataFrame(drawn, columns=["radial_distance", "deflection_angle"])
        status = Status(int(found.status)).name.lower()
        tables.append(table.assign(whisker=name, status=status))
    joined = pd.concat(tables, ignore_index=True)
    return with_units(joined, ["radial_distance"], ["deflection_angle"])


# -- Weber's law in two dimensions -----------------------------------------------------------------

NONE = 1e-9
#: Weber fractions of moment and axial force.
FAMILY = {
    "moment noise alone": (K, NONE),
    "both alike": (K, K),
    "axial force noise alone": (NONE, K),
}
#: Where the false zero is shown.
PLACE = 0.7


def observer(k_moment: float, k_force: float, correlation: float = 0.0) -> Observer:
    """The paper's pair of signals under Weber noise."""
    noise = Weber([k_moment, k_force], correlation=correlation)
    return Observer(WHISKER, ForceMap(), noise)


def closed_form(r: Array, k_moment: float, k_force: float, rho: float) -> Array:
    """½(A−r)(3A−2r)/(2A−r)·√(4k_M² + k_F² − 4ρk_Mk_F): the JND at small angle, m."""
    a = WHISKER.apex_distance
    noise = np.sqrt(4 * k_moment**2 + k_force**2 - 4 * rho * k_moment * k_force)
    return 0.5 * (a - r) * (3 * a - 2 * r) / (2 * a - r) * noise


def surface(k_moment: float, k_force: float, points: int = 90) -> pd.DataFrame:
    """The linear JND at every contact up to flick-past."""
    return linear_surface(observer(k_moment, k_force), points)


def posterior_surface(points: int, draws: int, *, seed: int = SEED) -> pd.DataFrame:
    """Figure 4b's surface by full posteriors, with noise in both signals alike.

    As `surface`, with the columns of a `JNDCurve`'s table; 30 × 30 contacts of 100 readings take
    some 10 s of one core.
    """
    places, shares = np.linspace(0.05, 0.97, points), np.linspace(0.005, 0.98, points)
    contact, angle = up_to_the_fold(WHISKER, places, shares)
    noisy, (r, theta) = observer(K, K), np.moveaxis(contact, -1, 0)
    table = jnd_curve(noisy, r, theta, n_readings=draws, seed=seed).table.reset_index()
    return table.assign(jnd_mm=table["posterior_mm"], contact_angle_deg=np.degrees(angle).ravel())


def false_zero(draws: int, degrees: Array | None = None, *, seed: int = SEED) -> pd.DataFrame:
    """Linear, Fisher and posterior JNDs with noise in the axial force and next to none else.

    A noise of 0.003 in the moment, which still has posteriors.
    """
    share = np.array([0.08, 0.2, 0.33, 0.45, 0.57, 0.7, 0.77, 0.81, 0.85, 0.875, 0.915, 0.955])
    theta = share * _last_angle() if degrees is None else np.radians(degrees)
    noisy = observer(0.003, K)
    curve = jnd_curve(noisy, PLACE * WHISKER.length, theta, n_readings=draws, seed=seed)
    kept = ["fisher_mm", "posterior_mm", "posterior_error_mm", "unreliable"]
    return _linear(theta).join(curve.table.reset_index()[kept])


def linear_between() -> pd.DataFrame:
    """The linear JND of `false_zero` at deflections in between, up to flick-past."""
    return _linear(np.linspace(0.04, 0.99, 400) * _last_angle())


def _last_angle() -> float:
    """Deflection at which it flicks past where the false zero is shown, rad."""
    return float(flick_past(WHISKER, PLACE * WHISKER.length).deflection_angle)


def _linear(theta: Array) -> pd.DataFrame:
    """The linear JND there, with noise in the axial force alone."""
    contact = np.stack([np.full(theta.size, PLACE * WHISKER.length), theta], axis=-1)
    linear = weber_propagation(observer(NONE, K), contact)
    return pd.DataFrame({"deflection_angle_deg": np.degrees(theta), "linear_jnd_mm": 1e3 * linear})


def gain() -> pd.DataFrame:
    """JNDs as the noise of k_F = 2k_M becomes one gain: at small angle and at 10 degrees."""
    r = 0.5 * WHISKER.length
    contact = np.array([[r, 1e-4], [r, np.radians(10.0)]])
    rows = []
    for rho in (-0.9, 0.0, 0.9, 0.99, 0.999, 0.9999, 0.999999):
        o = observer(K, 2 * K, rho)
        rows.append((rho, float(closed_form(np.array(r), K, 2 * K, rho)),
                     *weber_propagation(o, contact), *fisher_jnd(o, contact)))  # fmt: skip
    columns = ["rho", "closed_form", "linear_0", "linear_10", "fisher_0", "fisher_10"]
    return with_units(pd.DataFrame(rows, columns=columns), columns[1:])
