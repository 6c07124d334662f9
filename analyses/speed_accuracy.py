"""Speed against accuracy: bent whiskers, and posteriors of one and of two unknowns.

    python analyses/speed_accuracy.py [--short] [folder]

Writes speed_accuracy (CSV, PNG, SVG). Every method of inference is swept over its own knob on the
same readings; time (CPU of one core) and error are of the same run. Error is the r.m.s. of
sd/exact − 1, exact being a midpoint sum in the contact itself that shares no code with any engine.
The beams are those of `referees.py`, read from `referees.csv`: one contact at a time.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import platform
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import emcee
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import weberwhisk as ww
from weberwhisk import Status, figures
from weberwhisk.runs import Run

HERE = Path(__file__).parent
W = ww.Whisker(50e-3, 100e-6, 5e-6)
K = 0.1
OBSERVERS = {
    "one unknown": ww.Observer(W, ww.cues.Compliance(), ww.receptors.Weber(K)),
    "two unknowns": ww.Observer(W, ww.cues.ForceMap(), ww.receptors.Weber(K)),
}
SCENES = {
    "easy": "easy: s = 0.4 L, α = 10°",
    "middling": "middling: s = 0.6 L, α = 45°",
    "hard": "hard: r = 0.7 L, 0.999 of the fold",
}
Array = np.ndarray
Row = dict[str, object]


def readings(name: str, count: int, seed: int = 1) -> Array:
    """Noisy readings of contacts all over the whisker."""
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.2, 0.9, count) * W.length
    contact = r[:, None]
    if name == "two unknowns":
        theta = ww.flick_past(W, r).deflection_angle * rng.uniform(0.05, 0.7, count)
        contact = np.stack([r, theta], axis=-1)
    return OBSERVERS[name].read(contact, seed + 1)


def cells(name: str, n: int, box: Array) -> tuple[Array, Array]:
    """Contacts in the middle of n (or n × n) cells of a box of r/L (and θ_d over its limit).

    With them the size of each cell, as the limit of θ_d differs with distance.
    """
    shares = [low + (np.arange(n) + 0.5) / n * (high - low) for low, high in box]
    if name == "one unknown":
        return shares[0][:, None] * W.length, np.ones(n)
    r, angle = (a.ravel() for a in np.meshgrid(*shares, indexing="ij"))
    limit = ww.flick_past(W, shares[0] * W.length).deflection_angle.repeat(n)
    return np.stack([r * W.length, angle * limit], axis=-1), limit


def summed(name: str, rows: Array, n: int, *, zoom: bool = False) -> Array:
    """Sds of r by the midpoint sum over the whole reach: what one would write without a package.

    With `zoom` over the box that holds all but e⁻⁴⁰ of the density: to 1e-4 on narrow ridges at
    n = 1500.
    """
    observer = OBSERVERS[name]
    whole = np.tile([0.0, 1.0], (len(observer.unknowns), 1))
    contact, size = cells(name, n, whole)
    signals, _ = observer.signals(contact)
    out = []
    for row in rows:
        r, area, log = contact[:, 0], size, observer.noise.log_likelihood(row, signals)
        if zoom:
            near = (log > log.max() - 40).reshape((n,) * len(whole))
            box = []
            for axis in range(near.ndim):
                held = np.flatnonzero(
                    near.any(axis=tuple(k for k in range(near.ndim) if k != axis))
                )
                box.append([max(held[0] - 2, 0) / n, min(held[-1] + 3, n) / n])
            there, area = cells(name, n, np.array(box))
            r, log = there[:, 0], observer.log_likelihood(row, there)
        weight = np.exp(log - log.max()) * area
        mean = weight @ r / weight.sum()
        out.append(np.sqrt(weight @ (r - mean) ** 2 / weight.sum()))
    return np.array(out)


def importance(name: str, rows: Array, n: int, seed: int = 5) -> Array:
    """Sds of r by importance sampling from Student's t about the mode."""
    from scipy import stats

    from weberwhisk.posterior.mode import find_mode
    from weberwhisk.posterior.solution import mode_root

    observer = OBSERVERS[name]
    mode = find_mode(observer, rows)
    root = mode_root(mode, widen=1.2)
    t = stats.multivariate_t(shape=np.eye(root.shape[1]), df=5, seed=seed)
    z = t.rvs(n).reshape(n, -1)
    x = mode.x[:, None] + z @ root.swapaxes(1, 2)
    value, contact = observer.log_density_and_contact(x, rows[:, None])
    log = value - t.logpdf(z)
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    r = contact[..., 0]
    mean = (weight * r).sum(axis=1)
    return np.sqrt((weight * (r - mean[:, None]) ** 2).sum(axis=1))


def plain_emcee(name: str, rows: Array, steps: int, seed: int = 7) -> Array:
    """Sds of r by a loop over readings, 32 walkers each, the first fifth left out."""
    observer, rng = OBSERVERS[name], np.random.default_rng(seed)
    start = ww.posterior(observer, rows, method="laplace")
    out = []
    for i, row in enumerate(rows):
        middle = np.stack([e.mean[i] for e in start.estimates.values()])
        x = observer.coordinates(middle) + 0.1 * rng.standard_normal((32, len(middle)))
        sampler = emcee.EnsembleSampler(
            32, len(middle), observer.log_density, args=(row,), vectorize=True
        )
        sampler.run_mcmc(x, steps)
        draws = sampler.get_chain(discard=steps // 5, flat=True)
        out.append(observer.contact(draws)[0][:, 0].std())
    return np.array(out)


def sweeps(name: str, short: bool) -> Iterator[tuple[str, float, int, Callable[[Array], object]]]:
    """Method, knob, how many readings, and what to run on them."""
    observer, one = OBSERVERS[name], name == "one unknown"

    def engine(method: str, **options: object) -> Callable[[Array], object]:
        return lambda rows: ww.posterior(observer, rows, method=method, **options)  # type: ignore[arg-type]

    bulk, few = (256, 4) if short else (4096 if one else 1024, 8)
    for tolerance in (1e-6,) if one else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        yield "quadrature", tolerance, bulk, engine("quadrature", tolerance=tolerance)
    yield "Laplace", 0.0, bulk, engine("laplace")
    for tolerance in (0.1, 0.03) if short else (0.1, 0.05, 0.02, 0.01):
        count = 64 if short else 512
        yield "emcee, stacked", tolerance, count, engine("emcee", tolerance=tolerance, seed=3)
    for n in (100, 1000) if short else (100, 300, 1000, 3000, 10_000):
        yield "importance sampling", n, 64, lambda rows, n=n: importance(name, rows, n)
    for n in (100, 300) if short else (100, 300, 1000, 3000):
        yield "emcee, a loop", n, few, lambda rows, n=n: plain_emcee(name, rows, n)
    sizes = (30, 100, 300, 1000, 10_000) if one else (10, 30, 100, 300)
    for n in sizes[:3] if short else sizes:
        yield (
            "grid in r" if one else "grid in r, θ_d",
            n,
            few,
            lambda rows, n=n: summed(name, rows, n),
        )


def posteriors(short: bool) -> pd.DataFrame:
    """Error and time of every method and knob."""
    table: list[Row] = []
    for name in OBSERVERS:
        rows = readings(name, 4096)
        exact_of, n = (512, 20_000) if name == "one unknown" else (48, 1500)
        if short:
            exact_of, n = 8, min(n, 700)
        exact = summed(name, rows[:exact_of], n, zoom=True)
        for method, knob, count, run in sweeps(name, short):
            run(rows[:2])  # what is made once is not counted
            start = time.process_time()
            result = run(rows[:count])
            seconds = (time.process_time() - start) / count
            shown = min(count, exact_of)
            sd = result.sd[:shown] if isinstance(result, ww.Posterior) else np.asarray(result)
            good = np.ones(shown, dtype=bool)
            if isinstance(result, ww.Posterior):
                good = np.asarray(result.status)[:shown] == Status.CONVERGED
            ratio = sd[:shown] / exact[:shown] - 1
            table.append(
                {
                    "unknowns": name,
                    "method": method,
                    "knob": knob,
                    "readings": count,
                    "seconds": seconds,
                    "error": np.sqrt(np.mean(ratio**2)),
                    "worst": np.abs(ratio).max(),
                    "flagged": 1 - good.mean(),
                    "worst_unflagged": np.abs(ratio[good]).max() if good.any() else np.nan,
                }
            )
    return pd.DataFrame(table)


def growth(short: bool) -> pd.DataFrame:
    """Time against the number of posteriors."""
    table: list[Row] = []
    for name, observer in OBSERVERS.items():
        for method in ("quadrature", "emcee"):
            most = {"quadrature": 65_536, "emcee": 1024}[method] // (64 if short else 1)
            rows = np.resize(readings(name, 4096), (most, len(observer.cue.signal_names)))
            count = 1
            while count <= most and not (name == "two unknowns" and count > 8192):
                start = time.process_time()
                ww.posterior(observer, rows[:count], method=method, seed=1)
                seconds = time.process_time() - start
                table.append(
                    {"unknowns": name, "method": method, "count": count, "seconds": seconds}
                )
                count *= 4
    return pd.DataFrame(table)


def machine() -> str:
    """What the times are of."""
    names = ("numpy", "scipy", "emcee")
    versions = ", ".join(f"{name} {version(name)}" for name in names)
    return (
        f"Python {platform.python_version()}, weberwhisk {ww.__version__}, {versions}; "
        f"{platform.machine()}, one core, CPU time"
    )


def _beams(ax: Axes, scene: str) -> None:
    table = pd.read_csv(HERE / "referees.csv")
    table = table[(table["scene"] == SCENES[scene]) & (table["given"] == "contact")]
    for i, (_, row) in enumerate(table.iterrows()):
        ours = str(row["method"]).startswith("rung")
        ax.loglog(
            row["cpu_seconds"],
            max(row["error_moment"], 1e-16),
            figures.MARKERS[i % len(figures.MARKERS)],
            color=figures.COLOURS[i % len(figures.COLOURS)],
            markerfacecolor=None if ours else "none",
            label=row["method"],
        )
    ax.set(title=f"one contact, {scene}", xlabel="CPU time (s)", ylabel="error of the moment")
    ax.set(ylim=(1e-17, 10))
    if scene == "easy":
        ax.legend(fontsize=5.5, loc="center left")


def _posteriors(ax: Axes, table: pd.DataFrame) -> None:
    for i, (method, part) in enumerate(table.groupby("method", sort=False)):
        ax.loglog(
            part["seconds"],
            np.maximum(part["error"], 1e-10),
            "-" + figures.MARKERS[i],
            color=figures.COLOURS[i],
            label=method,
        )
        flagged = part[part["flagged"] > 0]
        for _, row in flagged.iterrows():
            ax.annotate(
                f"{row['flagged']:.0%}",
                (row["seconds"], max(row["error"], 1e-10)),
                textcoords="offset points",
                xytext=(3, 3),
                fontsize=5,
            )
    ax.set(xlabel="CPU time of a posterior (s)", ylabel="r.m.s. error of the sd")


def _growth(ax: Axes, table: pd.DataFrame) -> None:
    for i, ((name, method), part) in enumerate(table.groupby(["unknowns", "method"], sort=False)):
        late = part[part["seconds"] > 5 * part["seconds"].min()]
        slope = (
            np.polyfit(np.log(late["count"]), np.log(late["seconds"]), 1)[0]
            if len(late) > 2
            else np.nan
        )
        ax.loglog(
            part["count"],
            part["seconds"],
            "-" + figures.MARKERS[i],
            color=figures.COLOURS[i],
            label=f"{method}, {name}" + (f": slope {slope:.2f}" if slope > 0 else ""),
        )
    ax.set(title="growth", xlabel="posteriors in one call", ylabel="CPU time (s)")
    ax.set(ylim=(None, 3e4))
    ax.legend(fontsize=5.5, loc="upper left")


@figures.styled
def draw(table: pd.DataFrame, grown: pd.DataFrame) -> Figure:
    """Beams above, posteriors and growth below."""
    figure = figures.new_figure(figures.DOUBLE, 5.0)
    above, below = figure.subplots(2, 3)
    for ax, scene in zip(above, SCENES, strict=True):
        _beams(ax, scene)
    for ax, name in zip(below, OBSERVERS, strict=False):
        _posteriors(ax, table[table["unknowns"] == name])
        ax.set(title=f"posterior, {name}, k = {K:g}")
    below[0].legend(fontsize=5.5, loc="center right")
    _growth(below[2], grown)
    figure.text(
        0.01, -0.015, f"Above: referees.csv. Below: {machine()}. Percentages: flagged.", fontsize=5
    )
    return figure


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Tables and figure into `folder`."""
    with Run(folder, "speed_accuracy", {"short": short, "machine": machine()}, 1) as run:
        table, grown = posteriors(short), growth(short)
        run.table("speed_accuracy", table)
        run.table("growth", grown)
        run.figure("speed_accuracy", draw(table, grown))
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    default = HERE.parent / "results" / "speed_accuracy"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--short", action="store_true", help="few readings, few knobs")
    given = parser.parse_args()
    print(
        make(given.folder, short=given.short).to_string(index=False, float_format="{:.3g}".format)
    )
    print(f"Written to {given.folder}.")
