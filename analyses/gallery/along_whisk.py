"""What a whisk tells as it goes on: the JND of distance against push, speed, torque and direction.

Tables behind the gallery's charts for §2g, §3b and §3c of the paper. Distances are in m, angles in
rad; a JND is that of the information in the moment and the axial force at the base.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from command import with_units
from gallery.quasi_static import quasi_static
from numpy.typing import ArrayLike
from scipy.optimize import elementwise

from weberwhisk import Observer, Outcome, Whisker, press
from weberwhisk.cues import ForceMap
from weberwhisk.receptors import GeneralisedWeber, Weber
from weberwhisk.sensitivity import fisher_jnd
from weberwhisk.sweeping import Body, Sweep, cylinder, follow, peg, sweep, wall

Array = np.ndarray


def bodies(distance: float, radii: Sequence[float] = (2e-3, 5e-3, 15e-3)) -> dict[str, Any]:
    """A peg and cylinders of some radii (m) that a straight whisker meets at a distance, m."""
    round_ones = {
        f"cylinder, {1e3 * radius:g} mm": cylinder(distance, -radius, radius) for radius in radii
    }
    return {"peg": peg(distance, 0.0), **round_ones}


def resolution_along_push(
    whisker: Whisker,
    radial_distance: float,
    push: ArrayLike,
    *,
    weber_fraction: float = 0.1,
) -> pd.DataFrame:
    """JND of the radial distance against push, for a peg, cylinders, and a wall that the tip meets.

    Parameters
    ----------
    whisker : Whisker
        Straight.
    radial_distance : float
        Of the first contact, m; a wall stands where the tip meets it, at 60° to the whisker.
    push : array (n,)
        Rotation of the base since first contact, rad, ascending from above 0.
    weber_fraction : float
        Of moment and axial force.

    Returns
    -------
    DataFrame
        A row an object and push: `object`, `push_deg`, `radial_distance_mm`,
        `deflection_angle_deg`, `jnd_mm`, `tip` (whether the tip touches), `outcome`. NaN once the
        whisker has flicked past.

    Notes
    -----
    §3c: what a push tells depends on slip. Against a peg r stays and θ_d is the push; against a
    body that is rounded the contact runs along the whisker, and the same push bends it less.
    """
    angles = np.atleast_1d(push)
    observer = Observer(whisker, ForceMap(), Weber(weber_fraction))
    objects = bodies(radial_distance) | {"wall, by the tip": leaning(whisker)}
    parts = []
    for name, body in objects.items():
        found = sweep(whisker, body, np.r_[-0.2, angles])
        start = found.first_contact if np.isfinite(found.first_contact) else 0.0
        if abs(start) > 1e-9:
            found = sweep(whisker, body, np.r_[start - 0.2, start + angles])
        r, theta, jnd, _ = _along(found, observer)
        tip, outcome = (np.asarray(a)[1:] for a in (found.tip, found.bending.outcome))
        parts.append(
            pd.DataFrame(
                {"object": name, "push": angles, "radial_distance": r, "deflection_angle": theta,
                 "jnd": jnd, "tip": tip, "outcome": [Outcome(int(o)).name for o in outcome]}
            )
        )  # fmt: skip
    table = pd.concat(parts, ignore_index=True)
    return with_units(table, ["radial_distance", "jnd"], ["push", "deflection_angle"])


def leaning(whisker: Whisker, angle: float = np.pi / 3) -> Body:
    """A wall that the tip of a straight whisker meets, at an angle to it, rad."""
    return wall(float(whisker.length), 0.0, angle)


def _along(found: Sweep, observer: Observer) -> tuple[Array, Array, Array, Array]:
    """Distance, deflection and JND along a sweep but for its start, and where the flank touches."""
    bent = found.bending
    r, theta = (np.asarray(a, dtype=float)[1:] for a in (bent.radial_distance,
                                                         bent.deflection_angle))  # fmt: skip
    flank = np.isfinite(r) & (theta > 0) & ~np.asarray(found.tip)[1:]
    jnd = np.full(r.shape, np.nan)
    if flank.any():
        jnd[flank] = fisher_jnd(observer, np.stack([r, theta], axis=-1)[flank])
    return r, theta, jnd, flank


def lateral_sweep(
    whisker: Whisker,
    radial_distance: float,
    push: ArrayLike,
    *,
    weber_fraction: float = 0.1,
    radius: float = 15e-3,
    n_sweeps: int = 20,
    seed: int = 1,
) -> pd.DataFrame:
    """The distance followed along a sweep, from readings of the moment alone (§2g).

    Parameters
    ----------
    whisker, radial_distance, push, weber_fraction
        As of `resolution_along_push`.
    radius : float
        Of the cylinder beside the peg, m.
    n_sweeps : int
        Sweeps with noise in every moment.
    seed : int

    Returns
    -------
    DataFrame
        `object`, `push_deg`, `true_distance_mm`, `radial_distance_mm` (followed from exact
        moments), `lower_mm` and `upper_mm` (between which 95 % of the noisy sweeps that still
        follow it are), `lost` (the share of those that do not, as no contact near the one before
        has such a moment).
    """
    angles = np.atleast_1d(push)
    noise, rng = Weber(weber_fraction), np.random.default_rng(seed)
    parts = []
    for name, body in bodies(radial_distance, [radius]).items():
        bent = sweep(whisker, body, np.concatenate([[-0.2], angles])).bending
        moment, true = (np.asarray(a)[1:] for a in (bent.moment, bent.radial_distance))
        held = np.isfinite(moment)
        moment = moment[held]
        readings = [noise.sample(moment[:, None], rng)[:, 0] for _ in range(n_sweeps)]
        noisy = [follow(whisker, angles[held], reading).radial_distance for reading in readings]
        lower, upper = np.nanquantile(noisy, [0.025, 0.975], axis=0)
        parts.append(
            pd.DataFrame(
                {
                    "object": name,
                    "push": angles[held],
                    "true_distance": true[held],
                    "radial_distance": follow(whisker, angles[held], moment).radial_distance,
                    "lower": lower,
                    "upper": upper,
                    "lost": np.isnan(noisy).mean(axis=0),
                }
            )
        )
    table = pd.concat(parts, ignore_index=True)
    return with_units(table, ["true_distance", "radial_distance", "lower", "upper"], ["push"])


def limits(
    whisker: Whisker,
    places: ArrayLike,
    *,
    weber_fraction: float = 0.1,
    push: float = 0.1,
    torque: float = 4e-6,
    threshold: float = 3e-8,
    saturation: float = 2.5e-6,
) -> pd.DataFrame:
    """The JND curve with the limits that §3b names: torque, threshold and saturation.

    Parameters
    ----------
    whisker : Whisker
    places : array (n,)
        Radial distances, m.
    weber_fraction : float
        Of the moment.
    push : float
        Deflection angle that the whisker is pushed to where torque allows, rad.
    torque : float
        The largest moment that the muscles hold, N m: near the base the push stops short.
    threshold, saturation : float
        Sd of the noise that stays where the moment vanishes, and the moment above which receptors
        are saturated, N m.

    Returns
    -------
    DataFrame
        `radial_distance_mm`, `deflection_angle_deg` (the one reached), `moment_micronewton_metre`,
        and the JNDs `weber_mm` (Weber's law alone), `threshold_mm` (with the floor) and `all_mm`
        (with saturation too: NaN where the moment is above it, as no reading tells one distance
        from another there); `stopped` says where the torque was the limit, `outcome` what became
        of the contact: all but `HELD` has no JND.

    Notes
    -----
    The paper gives no numbers for the three; the defaults are for looking at.
    The angle reached is known to the animal, so that the JND is that of the moment alone at it,
    sd(M)/|∂M/∂r|. Where the torque stops the push, the angle at which it did tells the same.
    """
    r = np.atleast_1d(places)
    angle = np.full(r.shape, push)
    # The moment has its peak before the whisker flicks past, and torque stops it on the way up.
    way = np.linspace(0.0, push, 401)
    above = np.asarray(press(whisker, r[:, None], way).moment) > torque
    stopped = above.any(axis=1)
    if stopped.any():

        def excess(theta: Array, at: Array) -> Array:
            return np.asarray(press(whisker, at, theta).moment) - torque

        first = above[stopped].argmax(axis=1)
        bracket = way[first - 1], way[first]
        angle[stopped] = elementwise.find_root(excess, bracket, args=(r[stopped],)).x
    held = press(whisker, r, angle)
    moment, h = np.asarray(held.moment), 1e-5 * r
    ends = [np.asarray(press(whisker, r + s * h, angle).moment) for s in (1, -1)]
    slope = np.abs(ends[0] - ends[1]) / (2 * h)
    floored = GeneralisedWeber(weber_fraction, floor=threshold)
    curves = {
        name: noise.sd(moment[:, None])[:, 0] / slope
        for name, noise in (("weber", Weber(weber_fraction)), ("threshold", floored))
    }
    curves["all"] = np.where(moment < saturation, curves["threshold"], np.nan)
    table = pd.DataFrame(
        {"radial_distance": r, "deflection_angle": angle,
         "moment_micronewton_metre": 1e6 * moment, **curves, "stopped": stopped,
         "outcome": [Outcome(int(o)).name for o in np.asarray(held.outcome)]}
    )  # fmt: skip
    return with_units(table, ["radial_distance", *curves], ["deflection_angle"])


def reversal(
    whisker: Whisker,
    radial_distance: float,
    push: ArrayLike,
    *,
    friction_coefficient: float = 0.3,
    weber_fraction: float = 0.1,
    objects: Mapping[str, Body] | None = None,
) -> pd.DataFrame:
    """Objects pressed and let go again, by a base that turns and by one that moves sideways.

    Parameters
    ----------
    whisker, radial_distance, weber_fraction
        As of `resolution_along_push`.
    push : array (n,)
        On the way in, rad, ascending; the way out has the same. A base that moves sideways goes
        r₀ tan(push), which deflects it as much at a peg.
    friction_coefficient : float
        Of the object. The whisker slides outwards over it as it is let go, inwards as it is pressed
        (see `mechanics.profile`): the friction angle changes sign on reversal.
    objects : mapping of name to Body, optional
        By default a peg, a cylinder of 5 mm, and a wall that the tip meets.

    Returns
    -------
    DataFrame
        A row an object, way of moving, direction and push: `object`, `base` (rotates or
        translates), `direction` (pressed or let go), `push_deg`, `deflection_angle_deg`,
        `radial_distance_mm`, `jnd_mm` (without friction), and `bias_mm`: how far the distance of an
        observer who takes no account of friction is off. NaN where no contact without friction has
        that moment and axial force, while the tip touches, and from flick-past on.

    Notes
    -----
    Turning about its base, the whisker keeps its distance to a peg. A base that moves by y sideways
    goes away from it: r = √(r₀² + y²) with tan θ_d = y/r₀.
    """
    angles = np.atleast_1d(push)
    own = bodies(radial_distance, [5e-3]) | {"wall, by the tip": leaning(whisker)}
    tilt = float(np.arctan(friction_coefficient))
    observer = Observer(whisker, ForceMap(), Weber(weber_fraction))
    rows = []
    for (name, body), base in product((objects or own).items(), ("rotates", "translates")):
        way = np.r_[-0.1, angles]
        how = {"rotation": way} if base == "rotates" else {"travel": radial_distance * np.tan(way)}
        for direction, sign in (("pressed", -1.0), ("let go", 1.0)):
            found = sweep(whisker, body, friction_angle=sign * tilt, **how)
            r, theta, jnd, flank = _along(found, observer)
            reading = np.stack([found.bending.moment, found.bending.axial_force], axis=-1)[1:]
            assumed = np.full(r.shape, np.nan)
            if flank.any():
                assumed[flank] = ForceMap().contact(whisker, reading[flank])[0][:, 0]
            rows.append(
                pd.DataFrame(
                    {"object": name, "base": base, "direction": direction, "push": angles,
                     "deflection_angle": theta, "radial_distance": r, "jnd": jnd,
                     "bias": assumed - r}
                )
            )  # fmt: skip
    table = pd.concat(rows, ignore_index=True)
    return with_units(table, ["radial_distance", "jnd", "bias"], ["push", "deflection_angle"])


def speed(
    whisker: Whisker, places: ArrayLike, frequencies: Sequence[float] = (2.0, 8.0, 20.0)
) -> pd.DataFrame:
    """Up to which whisking frequency quasi-static answers hold, at contacts along a whisker.

    Parameters
    ----------
    whisker : Whisker
    places : array (n,)
        m.
    frequencies : sequence of float
        Hz, at which the bound of the error of the moment is given.

    Returns
    -------
    DataFrame
        `radial_distance_mm`, `first_frequency_hz`, `one_percent_hz` and `ten_percent_hz` (up to
        which the moment is off by no more), for each frequency `error_8Hz`: the largest share that
        inertia takes off the moment, and `settled_s`: after a first contact, from when the moment
        rings with a tenth of itself at most, one JND at k = 0.1, where modes are damped to a tenth
        of critical. See `quasi_static`.

    Examples
    --------
    >>> table = speed(Whisker(50e-3, 100e-6, 5e-6), [10e-3, 45e-3])
    >>> table["one_percent_hz"].round(1).tolist()
    [22.0, 2.5]
    """
    r = np.atleast_1d(places)
    rows = []
    for at in r:
        found = quasi_static(whisker, float(at))
        errors = {f"error_{f:g}Hz": float(found.error(f)[1]) for f in frequencies}
        rows.append(
            {"radial_distance_mm": 1e3 * at, "first_frequency_hz": found.first_frequency,
             "one_percent_hz": float(found.limit(0.01)), "ten_percent_hz": float(found.limit(0.1)),
             **errors, "settled_s": found.settled(0.1)}
        )  # fmt: skip
    return pd.DataFrame(rows)
