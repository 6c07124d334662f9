"""Measured contacts whose noise and misfit nobody gave: do 95 % intervals hold the distance?

    python analyses/contacts/make.py [--short] [--sets N] [--only tables] [--only taps]
        [--only calibrations] [folder]

*tables*: contacts of a whisker that is curved as a spiral at rest (R = 15). The direction of the
force is off by 7° (sd) in each touch and drifts by 3.5° within it, magnitudes scatter by 3 %.
`weberwhisk.locate` is given moment and axial force, or the transverse force too; the shape at rest
or none; the touches or none; no noise.

*taps*: twelve taps at each of eleven distances, from a sensor on a hinge whose stiffness grows with
the load, as no calibration here has it. Each distance is left out in turn and located by the
calibration of the others.

*calibrations*: twelve taps at each of eleven distances of a sensor as calibrations have it, or with
slopes off by 5 % (sd) at each of seven distances, or twenty taps at each of ten, of which one in a
hundred is off by 9 sds. Touches of as many taps as these, at new distances, are located.

Writes a table (CSV) of each, a row a set.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parent.parent))

from command import options

import weberwhisk as ww

SIGNALS = ["moment", "axial_force", "transverse_force"]
WHISKER = ww.Whisker(40e-3, 90e-6, 6e-6, youngs_modulus=3e9)
CURVED = ww.mechanics.Profile.of(WHISKER).curved(ww.mechanics.Spiral(6.0, 300.0))
SENSOR = ww.Whisker(0.12, 0.8e-3, 0.2e-3, youngs_modulus=3e9)
NOMINAL = ww.Whisker(0.12, 0.8e-3, 0.4e-3, youngs_modulus=2e9)
#: Of calibrations: number of distances, taps at each, scatter of taps, sd of the misfit at each
#: distance, and share of taps that are off by 9 sds.
KINDS = {"obeying": (11, 12, 0.025, 0.0, 0.0), "misfit": (7, 12, 0.025, 0.05, 0.0),
         "gross": (10, 20, 0.027, 0.0, 0.01)}  # fmt: skip
#: Of sensors: compliance of the hinge (m) without load, share by which its stiffness grows at the
#: load of the middle distance, power of the load by which it grows, and scatter of taps.
SENSORS = [(0.012, 1.0, 1, 0.025), (0.012, 4.0, 1, 0.005), (0.03, 1.0, 2, 0.01),
           (0.03, 4.0, 2, 0.003)]  # fmt: skip


def contacts(seed: int, touches: int = 8, rows: int = 4) -> pd.DataFrame:
    """A table of contacts of the curved whisker, with the true distance of each."""
    rng = np.random.default_rng(seed)
    observer = ww.Observer(CURVED, ww.cues.ForceMap(SIGNALS))
    out = []
    for touch in range(touches):
        r = rng.uniform(0.2, 0.9) * WHISKER.length
        least, held = (float(np.ravel(v)[0]) for v in observer.space.angle_range(np.array([r])))
        theta = least + held * np.linspace(0.05, rng.uniform(0.15, 0.6), rows)
        m, fx, fy = observer.signals(np.stack([np.full(rows, r), theta], axis=-1))[0].T
        off = 7.0 * rng.standard_normal() + 3.5 * rng.standard_normal() * np.linspace(-1, 1, rows)
        force = (fx + 1j * fy) * np.exp(1j * np.radians(off))
        force *= 1 + 0.03 * rng.standard_normal(rows)
        m = m * (1 + 0.03 * rng.standard_normal(rows))
        own = {"moment": m, "axial_force": force.real, "transverse_force": force.imag}
        out.append(pd.DataFrame(own | {"touch": touch, "true_mm": 1e3 * r}))
    return pd.concat(out, ignore_index=True)


def held(found: pd.DataFrame, of: str = "") -> dict[str, float]:
    """Shares held by 95 % intervals, and outside them by over 2 mm, and what the intervals say."""
    truth, middle = found["true_mm"], found[f"{of}radial_distance_mm"]
    low, high = found[f"{of}lower_mm"], found[f"{of}upper_mm"]
    inside, error = truth.between(low, high), (middle - truth).abs()
    return {f"{of}held": inside.mean(), f"{of}far_outside": (~inside & (error > 2)).mean(),
            f"{of}error_mm": error.median(), f"{of}width_mm": (high - low).median()}  # fmt: skip


def located(
    seed: int, signals: int, shape: bool, touch: bool, size: tuple[int, int] = (8, 4)
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A table of so many touches and rows, and what `locate` makes of it."""
    table = contacts(seed, *size).drop(columns=SIGNALS[signals:])
    whisker, by = CURVED if shape else WHISKER, "touch" if touch else None
    return table, ww.locate(table, whisker, touch=by, known_stiffness=True)


def tables(sets: int, short: bool = False) -> pd.DataFrame:
    """A row for each set, signals, shape given or not, and touches given or not."""
    rows = []
    for seed, count, shape, touch in product(range(sets), (2, 3), (True, False), (False, True)):
        found = located(seed, count, shape, touch, (6, 3) if short else (8, 4))[1]
        row = {"set": seed, "signals": count, "shape_given": shape, "touches_given": touch}
        row |= held(found)
        if touch:
            row |= held(found.drop_duplicates("touch"), "touch_")
        rows.append(row)
    return pd.DataFrame(rows)


def sensor_taps(kind: str, r: np.ndarray, rng: np.random.Generator) -> pd.DataFrame:
    """Taps at distances r (m) of a kind, and which of them are gross."""
    _, each, k, misfit, share = KINDS[kind]
    off = k * rng.standard_normal((r.size, each)) + misfit * rng.standard_normal((r.size, 1))
    gross = rng.random(off.shape) < share
    off[gross] = 9 * k * rng.choice([-1, 1], gross.sum())
    slope = slopes(0.012, 0.0, 1, r)[:, None] * (1 + off)
    return pd.DataFrame({
        "radial_distance_mm": np.repeat(1e3 * r, each), "touch": np.repeat(np.arange(r.size), each),
        "moment_rate": slope.ravel(), "gross": gross.ravel(),
    })  # fmt: skip


def calibrations(sets: int, kinds: Sequence[str] = tuple(KINDS)) -> pd.DataFrame:
    """A row for each kind and set: how many of eleven touches at new distances are held."""
    rows = []
    for kind, seed in product(kinds, range(sets)):
        rng = np.random.default_rng(seed)
        table = sensor_taps(kind, np.linspace(0.03, 0.105, KINDS[kind][0]), rng)
        new = sensor_taps(kind, np.sort(rng.uniform(0.03, 0.105, 11)), rng)
        found = ww.calibrate(table.drop(columns=["gross", "touch"]), NOMINAL)
        named = table.index.isin(found.gross.index)
        own = new.rename(columns={"radial_distance_mm": "true_mm"})
        rows.append({
            "kind": kind, "set": seed, "k": KINDS[kind][2],
            "k_found": float(found.noise.weber_fraction), "misfit": found.misfit,
            **touches_held(own, found), "gross": int(table["gross"].sum()),
            "gross_named": int((named & table["gross"]).sum()),
            "falsely_named": int((named & ~table["gross"]).sum()),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def touches_held(table: pd.DataFrame, found: ww.recordings.Calibration) -> dict[str, float]:
    """How many touches are held, and the mean errors (mm) of their means and of the best fit."""
    each = ww.locate(table, found, touch="touch").drop_duplicates("touch")
    best = ww.locate(table, found.whisker, cue=found.cue, noise=found.noise, touch="touch")
    best = best.drop_duplicates("touch")
    inside = each["true_mm"].between(each["touch_lower_mm"], each["touch_upper_mm"])
    error, best_error = ((t["touch_radial_distance_mm"] - t["true_mm"]).abs() for t in (each, best))
    return {
        "touches": len(each), "touches_held": int(inside.sum()), "error_mm": error.mean(),
        "best_fit_error_mm": best_error.mean(), "largest_error_mm": error.max(),
    }  # fmt: skip


def slopes(hinge: float, growth: float, power: float, r: np.ndarray) -> np.ndarray:
    """Slopes of taps at distances r whose load stiffens the hinge, by fixed-point iteration."""
    beam = 1 / (1 / r - 1 / SENSOR.apex_distance)
    load = 1 / (beam + hinge)
    middle = np.median(load)
    for _ in range(500):
        load = (load + 1 / (beam + hinge / (1 + growth * (load / middle) ** power))) / 2
    return np.asarray(load * SENSOR.compliance_constant)


def taps(
    sets: int, sensors: Sequence[tuple[float, float, int, float]] = SENSORS,
    left_out: Sequence[int] = range(11),
) -> pd.DataFrame:  # fmt: skip
    """A row for each sensor and set: how many of the distances left out in turn are held."""
    r = np.repeat(np.linspace(0.03, 0.105, 11), 12)
    rows = []
    for sensor, seed in product(sensors, range(sets)):
        hinge, growth, power, k = sensor
        noise = 1 + k * np.random.default_rng(seed).standard_normal(r.size)
        table = pd.DataFrame({"radial_distance_mm": 1e3 * r, "touch": np.arange(r.size) // 12,
                              "moment_rate": slopes(hinge, growth, power, r) * noise})  # fmt: skip
        whole, each, located = ww.calibrate(table, NOMINAL), [], []
        for touch in left_out:
            out = table["touch"] == touch
            own = table[out].rename(columns={"radial_distance_mm": "true_mm"})
            rest = ww.calibrate(table[~out], NOMINAL)
            each.append(touches_held(own, rest))
            located.append(ww.locate(own, rest))
        every = pd.DataFrame(each)
        rows.append({
            "hinge_m": hinge, "growth": growth, "power": power, "scatter": k, "set": seed,
            "p_value": whole.p_value, "misfit": whole.misfit,
            "touches_held": int(every["touches_held"].sum()),
            "rows_held": float(held(pd.concat(located))["held"]),
            "error_mm": every["error_mm"].mean(),
            "best_fit_error_mm": every["best_fit_error_mm"].mean(),
            "largest_error_mm": every["largest_error_mm"].max(),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return pd.DataFrame(rows)


PARTS = {"taps": taps, "calibrations": calibrations}

if __name__ == "__main__":
    asked = options(__file__, __doc__, short="one set of each, tables of 18 contacts", sets=5,
                    parts=("tables", "taps", "calibrations"))  # fmt: skip
    asked.folder.mkdir(parents=True, exist_ok=True)
    sets = 1 if asked.short else asked.sets
    for name in asked.only or ("tables", "taps", "calibrations"):
        made = tables(sets, asked.short) if name == "tables" else PARTS[name](sets)
        made.to_csv(asked.folder / f"{name}.csv", index=False)
        kinds = [n for n in ("signals", "shape_given", "touches_given", "hinge_m", "growth",
                             "kind")
                 if n in made]  # fmt: skip
        print(made.drop(columns="set").groupby(kinds).mean().round(3).to_string())
