"""Speed against accuracy, measured here and now: beams, posteriors, JNDs, fits and growth.

Every part is a table in one form, a row for each method, scene and setting of the method's own
knob: `part`, `scene`, `method`, `knob`, `seconds` (CPU of one core, of one solution), `error`,
`failed` (share without an answer, or flagged by the method itself). Time and error are of the same
run. `make` joins rows of other tools to them.

The referee of a posterior's sd is a midpoint sum in the contact itself that shares no code with any
engine; a JND is the mean of such sds over the readings of one contact.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats
from scipy.integrate import cubature
from speed_accuracy.beams import Row, timed

from weberwhisk import (
    Observer,
    Outcome,
    Status,
    Trials,
    Whisker,
    cues,
    fit_population,
    fit_weber,
    flick_past,
    jnd_curve,
    locate,
    posterior,
    receptors,
    simulate_population,
    simulate_trials,
)
from weberwhisk.inference import Posterior
from weberwhisk.inference.approximate import find_mode, fisher_scoring
from weberwhisk.sensitivity import fisher_jnd, weber_propagation

Array = np.ndarray
WHISKER = Whisker(50e-3, 100e-6, 5e-6)
K = 0.1
OBSERVERS = {
    "one unknown: r": Observer(WHISKER, cues.Compliance(), receptors.Weber(K)),
    "two: r, θ_d": Observer(WHISKER, cues.ForceMap(), receptors.Weber(K)),
    "r and a nuisance: stiffness": Observer(
        WHISKER, cues.UnknownStiffness(cues.Compliance(), 0.2), receptors.Weber(K)
    ),
}
Engine = Callable[[Array], Posterior | Array]


def readings(observer: Observer, count: int, seed: int = 1) -> Array:
    """Noisy readings (count, S) of contacts all over the whisker."""
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.2, 0.9, count) * WHISKER.length
    contact = r[:, None]
    if "deflection_angle" in observer.unknowns:
        theta = flick_past(WHISKER, r).deflection_angle * rng.uniform(0.05, 0.7, count)
        contact = np.stack([r, theta], axis=-1)
    elif observer.bounded < len(observer.unknowns):
        contact = np.concatenate([contact, rng.lognormal(0, 0.2, (count, 1))], axis=-1)
        contact[:, 1] *= observer.at_middle(contact[:1, :1])[0, 1]
    return observer.read(contact, seed + 1)


def cells(observer: Observer, n: int, box: Array) -> tuple[Array, Array]:
    """Contacts in the middle of cells of a box, and the prior's weight of each, up to a factor.

    Axes: r over the reach, then the share of the largest θ_d, or a nuisance from −6 to 6 prior sds.
    """
    shares = [low + (np.arange(n) + 0.5) / n * (high - low) for low, high in box]
    if observer.bounded > 1:
        width = observer.space.angle_range(shares[0] * observer.reach[1])[1].repeat(n)
    else:
        width = np.ones(n ** len(shares))
    return _placed(observer, [a.ravel() for a in np.meshgrid(*shares, indexing="ij")], width)


def _placed(observer: Observer, shares: list[Array], width: Array) -> tuple[Array, Array]:
    """Contacts at shares of each axis, where θ_d reaches to `width`; see `cells`."""
    r = shares[0] * observer.reach[1]
    if len(shares) == 1:
        return r[:, None], width
    second = shares[1]
    if observer.bounded > 1:
        return np.stack([r, second * width], axis=-1), width
    # The prior is log-normal: ln of the stiffness over its median is normal.
    prior = observer.prior[observer.unknowns[1]]
    z = 12 * second - 6
    ends = np.log(prior.ppf([0.15865525393145707, 0.5]))
    value = np.exp(ends[1] + (ends[1] - ends[0]) * z)
    return np.stack([r, value], axis=-1), np.exp(-0.5 * z * z)


def summed(observer: Observer, rows: Array, n: int, *, zoom: bool = False) -> Array:
    """Sds of r (B,) by the midpoint sum; with `zoom` over a box of all but e⁻⁴⁰ of the density."""
    whole = np.tile([0.0, 1.0], (len(observer.unknowns), 1))
    contact, size = cells(observer, n, whole)
    signals, outcome = observer.signals(contact)
    held = outcome == 0
    out = []
    for row in rows:
        log = np.where(
            held, observer.noise.log_likelihood(row, np.where(held[:, None], signals, 1)), -np.inf
        )
        place, weight = contact[:, 0], size
        if zoom:
            near = (log + np.log(size) > (log + np.log(size)).max() - 40).reshape((n,) * len(whole))
            box = []
            for axis in range(near.ndim):
                at = np.flatnonzero(near.any(axis=tuple(k for k in range(near.ndim) if k != axis)))
                box.append([max(at[0] - 2, 0) / n, min(at[-1] + 3, n) / n])
            there, weight = cells(observer, n, np.array(box))
            place, log = there[:, 0], observer.log_likelihood(row, there)
        share = np.exp(log - log.max()) * weight
        mean = share @ place / share.sum()
        out.append(np.sqrt(share @ (place - mean) ** 2 / share.sum()))
    return np.array(out)


def by_cubature(observer: Observer, rows: Array, tolerance: float) -> Array:
    """Sds of r (B,) by SciPy's adaptive cubature over the prior's whole box, reading by reading.

    NaN where it does not converge in a thousand regions.
    """
    whole = len(observer.unknowns)
    middle = 0.5 * observer.reach[1]
    coarse, _ = cells(observer, 100, np.tile([0.0, 1.0], (whole, 1)))
    out = []
    for row in rows:
        top = float(observer.log_likelihood(row, coarse).max())  # against overflow

        def moments(at: Array, row: Array = row, top: float = top) -> Array:
            shares = list(np.atleast_2d(at.T))
            two = observer.bounded > 1
            width = observer.space.angle_range(shares[0] * observer.reach[1])[1] if two else 1.0
            contact, size = _placed(observer, shares, np.broadcast_to(width, shares[0].shape))
            mass = np.exp(observer.log_likelihood(row, contact) - top) * size
            off = contact[:, 0] - middle
            return np.stack([mass, mass * off, mass * off**2], axis=-1)

        found = cubature(
            moments, np.zeros(whole), np.ones(whole), rtol=tolerance, max_subdivisions=1000
        )
        mass, first, second = found.estimate
        good = found.status == "converged" and mass > 0
        out.append(np.sqrt(second / mass - (first / mass) ** 2) if good else np.nan)
    return np.array(out)


def importance(observer: Observer, rows: Array, n: int, seed: int = 5) -> Array:
    """Sds of r (B,) by importance sampling from Student's t about the mode."""
    mode, _, covariance = fisher_scoring(observer, rows, find_mode(observer, rows)[0], 1e-9, 1)
    root = 1.2 * np.linalg.cholesky(covariance)
    t = stats.multivariate_t(shape=np.eye(root.shape[1]), df=5, seed=seed)
    z = t.rvs(n).reshape(n, -1)
    value, contact = observer.log_density_and_contact(
        mode[:, None] + z @ root.swapaxes(1, 2), rows[:, None]
    )
    log = value - t.logpdf(z)
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    r = contact[..., 0]
    mean = (weight * r).sum(axis=1)
    return np.asarray(np.sqrt((weight * (r - mean[:, None]) ** 2).sum(axis=1)))


def _engines(observer: Observer, full: bool) -> Iterator[tuple[str, float, int, Engine]]:
    """Method, knob, how many readings, and what to run on them."""
    one = len(observer.unknowns) == 1

    def engine(method: str, **options: Any) -> Engine:
        return lambda rows: posterior(observer, rows, method=method, **options)

    bulk = (2048 if one else 256) if full else (256 if one else 32)
    one_by_one = lambda rows: np.array([posterior(observer, row).sd for row in rows])  # noqa: E731
    yield "quadrature, one by one", 0, 8, one_by_one
    tolerances = (1e-6,) if one else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5) if full else (1e-2, 1e-4)
    for tolerance in tolerances:
        yield "quadrature", tolerance, bulk, engine("quadrature", tolerance=tolerance)
    yield "Laplace", 0, bulk, engine("laplace")
    for n in (100, 300, 1000, 3000, 10_000) if full else (100, 3000):
        yield "importance sampling", n, 32, partial(importance, observer, n=n)
    for tolerance in (1e-2, 1e-4, 1e-6) if full else (1e-2,):
        yield "SciPy, cubature", tolerance, 4, partial(by_cubature, observer, tolerance=tolerance)
    for tolerance in (0.1, 0.05, 0.02, 0.01) if full else (0.1, 0.03):
        count = 256 if full else 32
        yield "emcee, stacked", tolerance, count, engine("emcee", tolerance=tolerance, seed=3)
    sizes = (30, 100, 300, 1000, 3000) if one else (10, 30, 100, 300)
    for n in sizes if full else sizes[:3]:
        yield "midpoint grid", n, 8, partial(summed, observer, n=n)


def posterior_row(
    scene: str, method: str, knob: float, sd: Array, good: Any, exact: Array, seconds: float
) -> Row:
    """A row of the table, from the sds that a method found and those it vouches for."""
    ratio = sd / exact - 1
    good = good & np.isfinite(ratio)
    return {
        "part": "posteriors",
        "scene": scene,
        "method": method,
        "knob": knob,
        "count": sd.size,
        "seconds": seconds,
        "error": float(np.sqrt(np.nanmean(ratio**2))) if np.isfinite(ratio).any() else np.nan,
        "failed": 1 - good.mean(),
        "worst_vouched": float(np.abs(ratio[good]).max()) if good.any() else np.nan,
    }


def exact_sds(observer: Observer, rows: Array, *, full: bool) -> tuple[Array, float]:
    """The referee's sds, and its own error: against a sum with half as many cells an axis."""
    n = {1: (4000, 20_000), 2: (500, 1500)}[len(observer.unknowns)][full]
    exact = summed(observer, rows, n, zoom=True)
    half = summed(observer, rows[:8], n // 2, zoom=True)
    # Halving quarters the error of a midpoint sum, or better.
    return exact, float(np.abs(half / exact[:8] - 1).max() / 3)


def measure_posteriors(
    *, full: bool = False, scenes: Iterable[str] = tuple(OBSERVERS)
) -> pd.DataFrame:
    """R.m.s. relative error of the sd of r, and CPU seconds a posterior, of every engine.

    The row "closed form" is the time of the linear sd (3.2), "referee" the error of the truth.
    """
    table: list[Row] = []
    for scene in scenes:
        observer = OBSERVERS[scene]
        rows = readings(observer, 2048 if full else 256)
        judged = (256 if len(observer.unknowns) == 1 else 32) if full else 8
        exact, doubt = exact_sds(observer, rows[:judged], full=full)
        middle = observer.at_middle(np.tile([25e-3, 0.2], (1000, 1))[:, : observer.bounded])
        _, seconds = timed(partial(weber_propagation, observer, middle, model="closed_form"))
        shared = {"part": "posteriors", "scene": scene}
        table.append({**shared, "method": "closed form", "seconds": seconds / 1000})
        table.append({**shared, "method": "referee", "error": doubt})
        for method, knob, count, run in _engines(observer, full):
            run(rows[:2])  # what is made once is not counted
            result, seconds = timed(partial(run, rows[:count]), repeats=1)
            if isinstance(result, Posterior):
                sd, good = result.sd, np.asarray(result.status) == Status.CONVERGED
            else:
                sd, good = result, np.ones(len(result), dtype=bool)
            kept = slice(min(count, judged))
            found = sd[kept], good[kept], exact[kept]
            table.append(posterior_row(scene, method, knob, *found, seconds / count))
    return pd.DataFrame(table)


# -- JND curves ----------------------------------------------------------------------------------


CURVES = {
    "JND curve, tap: r": cues.Compliance(),
    "JND curve, force map: r, θ_d": cues.ForceMap(),
}


def measure_jnds(*, full: bool = False) -> pd.DataFrame:
    """`measure_curve` of all `CURVES`."""
    curves = [measure_curve(scene, cue, full=full) for scene, cue in CURVES.items()]
    return pd.concat(curves, ignore_index=True)


def measure_curve(scene: str, cue: cues.Cue, *, full: bool = False) -> pd.DataFrame:
    """R.m.s. relative error of a curve of JNDs over distances, and CPU seconds a distance.

    The truth, at each distance, is the mean sd over many readings of its own by quadrature, whose
    sds `measure_posteriors` judges; the row "referee" is the Monte Carlo error of that mean.
    """
    r = np.linspace(0.2, 0.8, 4) * WHISKER.length
    observer = Observer(WHISKER, cue, receptors.Weber(K))
    angle = 0.1 if "deflection_angle" in observer.unknowns else None
    contact = np.stack([r, np.full(r.size, 0.1)], axis=-1)[:, : len(observer.unknowns)]
    exact = jnd_curve(observer, r, angle, n_readings=4000 if full else 150, seed=99)
    truth = exact["posterior"].to_numpy()
    doubt = float(np.sqrt(np.mean((exact["posterior_error"] / truth) ** 2)))

    def curve(count: int, method: str) -> Array:
        found = jnd_curve(observer, r, angle, method=method, n_readings=count, seed=7)
        return np.asarray(found["posterior"])

    calls: list[tuple[str, int, Callable[[], Array]]] = [
        ("closed form", 0, partial(weber_propagation, observer, contact, model="closed_form")),
        ("exact slope", 0, partial(weber_propagation, observer, contact)),
        ("Fisher information", 0, partial(fisher_jnd, observer, contact)),
    ]
    for method, counts in (
        ("quadrature", (10, 30, 100, 300, 1000) if full else (10, 100)),
        ("emcee", (10, 30, 100, 300) if full else (10,)),
    ):
        calls += [(f"posteriors, {method}", n, partial(curve, n, method)) for n in counts]
    shared = {"part": "jnds", "scene": scene}
    table: list[Row] = [{**shared, "method": "referee", "error": doubt}]
    for method, count, call in calls:
        found, seconds = timed(call, repeats=1)
        error = float(np.sqrt(np.mean((found / truth - 1) ** 2)))
        table.append({**shared, "method": method, "knob": count, "count": r.size,
                      "seconds": seconds / r.size, "error": error, "failed": 0.0})  # fmt: skip
    return pd.DataFrame(table)


# -- fits ------------------------------------------------------------------------------------------

#: Trials a level.
SIZES = (13, 33, 111)
#: Middle and 95 % interval of the Weber fraction; NaN where a tool gives no interval.
Answer = tuple[float, float, float]
Tool = Callable[[Trials], Answer]


def ours(**options: str) -> Tool:
    """This package's posterior median and 95 % interval."""

    def answer(trials: Trials) -> Answer:
        fit = fit_weber(trials, **options)  # type: ignore[arg-type]
        return (fit.weber_fraction, *fit.interval())

    return answer


TOOLS: dict[str, Tool] = {
    "quadrature": ours(),
    "emcee": ours(method="emcee"),
    "quadrature, equal-variance": ours(noise="equal-variance"),
}


def measure_tool(
    name: str, tool: Tool, per_level: int, sets: int, k: float = 0.1, lapse: float = 0.02
) -> Row:
    """One row: median CPU time, relative RMSE with its standard error, bias and coverage.

    The data sets go by their number and size alone, so that every tool has the same: nine signed
    levels to ±0.30 of one standard, answered with the Weber fraction k and lapses at either end.
    """
    times, middle, inside = [], [], []
    for seed in range(sets):
        trials = simulate_trials(
            weber_fraction=k, lapse_low=lapse, lapse_high=lapse, trials_per_level=per_level,
            seed=400_000 + 1000 * per_level + seed,
        )  # fmt: skip
        start = time.process_time()
        value, low, high = tool(trials)
        times.append(time.process_time() - start)
        middle.append(value / k - 1)
        inside.append(np.nan if np.isnan(low) else low < k < high)
    off = np.array(middle)
    square = off[np.isfinite(off)] ** 2
    error = float(np.sqrt(square.mean()))
    return {
        "part": "fits",
        "scene": f"{9 * per_level} trials",
        "method": name,
        "knob": 9 * per_level,
        "count": sets,
        "seconds": float(np.median(times)),
        "error": error,
        "error_se": float(square.std(ddof=1) / (2 * error * np.sqrt(square.size))),
        "failed": float(np.mean(~np.isfinite(off))),
        "bias": float(np.nanmedian(off)),
        "coverage": float(np.mean(inside)),
    }


def sizes(full: bool) -> tuple[int, ...]:
    """Trials a level: of all data sets, or in short of the smallest."""
    return SIZES if full else SIZES[:1]


def measure_fits(*, full: bool = False, sets: int | None = None) -> pd.DataFrame:
    """Relative RMSE of the Weber fraction, coverage of its 95 % interval, and CPU seconds a fit.

    All tools fit the same data sets: with fewer for the slow ones their RMSE is another number.
    """
    sets = sets or (100 if full else 3)
    return pd.DataFrame(
        [
            measure_tool(name, tool, per_level, sets)
            for per_level in sizes(full)
            for name, tool in TOOLS.items()
        ]
    )


# -- growth ----------------------------------------------------------------------------------------

TOUCH = 20  # rows of a touch in a film


def film(rows: int, seed: int = 1) -> pd.DataFrame:
    """Signals at the base of a curved whisker: touches at one distance each, in and out again."""
    rng = np.random.default_rng(seed)
    whisker = Whisker(40e-3, 80e-6, 4e-6, youngs_modulus=3.0e9, curvature=6.0)
    noise = receptors.GeneralisedWeber(0.03, floor=[1e-9, 1e-6])
    observer = Observer(whisker, cues.ForceMap(), noise)
    signals: list[Array] = []
    while len(signals) * TOUCH < rows:
        push = rng.uniform(0.05, 0.3) * np.sin(np.linspace(0.15, np.pi - 0.15, TOUCH))
        contact = np.column_stack([np.full(TOUCH, rng.uniform(10e-3, 32e-3)), push])
        exact, outcome = observer.signals(contact)
        if (outcome == Outcome.HELD).all():
            signals.append(noise.sample(exact, rng))
    table = pd.DataFrame(np.concatenate(signals), columns=["moment", "axial_force"])
    return table.assign(touch=np.arange(len(table)) // TOUCH)[:rows]


def _posteriors(scene: str, method: str, n: int) -> Callable[[], Any]:
    observer = OBSERVERS[scene]
    rows = np.resize(readings(observer, 4096), (n, len(observer.cue.signal_names)))
    return partial(posterior, observer, rows, method=method, seed=1)


def _fit(n: int) -> Callable[[], Any]:
    return partial(fit_weber, simulate_trials(trials_per_level=max(n // 9, 1), seed=1))


def _population(n: int) -> Callable[[], Any]:
    trials, _ = simulate_population(n, trials_per_level=15, seed=1)
    return partial(fit_population, trials, seed=1)


def _curve(n: int) -> Callable[[], Any]:
    observer = OBSERVERS["one unknown: r"]
    return partial(jnd_curve, observer, np.linspace(5e-3, 45e-3, n), n_readings=20, seed=1)


def _located(n: int) -> Callable[[], Any]:
    units = {"moment": "N m", "axial_force": "N"}
    return partial(locate, film(n), Whisker(40e-3, 80e-6, 4e-6), units=units)


class Job(NamedTuple):
    """What makes a call of size n, the least n, and the most in short and in full."""

    call: Callable[[int], Callable[[], Any]]
    least: int
    short: int  # 0 leaves out what takes seconds a call
    full: int


#: Each is called once before it is timed: what is kept between calls is not counted.
JOBS = {
    "posteriors, quadrature, r": Job(
        partial(_posteriors, "one unknown: r", "quadrature"), 1, 1024, 65_536
    ),
    "posteriors, quadrature, r and θ_d": Job(
        partial(_posteriors, "two: r, θ_d", "quadrature"), 1, 1024, 4096
    ),
    "posteriors, emcee, r": Job(partial(_posteriors, "one unknown: r", "emcee"), 1, 64, 1024),
    "trials, fit": Job(_fit, 16, 4096, 262_144),
    "subjects, population fit": Job(_population, 2, 0, 128),
    "distances, JND curve": Job(_curve, 1, 64, 1024),
    "rows, locate, unknown shape and stiffness": Job(_located, 20, 0, 5120),
}


def growing(full: bool) -> list[str]:
    """The `JOBS` that are measured."""
    return [what for what, job in JOBS.items() if full or job.short]


def measure_growing(what: str, *, full: bool = False) -> pd.DataFrame:
    """CPU seconds and peak bytes of one call against its size, with the exponents of both."""
    job = JOBS[what]
    job.call(64 if "θ_d" in what else job.least)()
    rows, n = [], job.least
    while n <= (job.full if full else job.short):
        call = job.call(n)
        start = time.process_time()
        call()
        seconds = time.process_time() - start
        tracemalloc.start()
        call()
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        rows.append(
            {"part": "growth", "method": what, "count": n, "seconds": seconds, "bytes": peak}
        )
        n *= 4
    part = pd.DataFrame(rows)
    for column in ("seconds", "bytes"):
        part[f"slope_{column}"] = slope(part["count"], part[column])
    return part


def slope(count: Any, value: Any) -> float:
    """Exponent of growth over the upper half of the sizes, by least squares.

    NaN of fewer than three sizes, and where they are no line: off it by more than a quarter.
    """
    half = max(len(count) // 2, 3)
    x, y = (np.log(np.asarray(v, dtype=float)[-half:]) for v in (count, value))
    if x.size < 3:
        return float("nan")
    line = np.polyfit(x, y, 1)
    straight = np.abs(np.polyval(line, x) - y).max() < np.log(1.25)
    return float(line[0]) if straight else float("nan")


# -- conclusions -----------------------------------------------------------------------------------

#: Errors that are small enough: of a moment 0.1 JND at k = 0.1; of an sd and of a JND 3 %.
ENOUGH = {"beams": 0.01, "posteriors": 0.03, "jnds": 0.03}
#: This package's methods in order of what they model.
MORE = {
    "beams": ("closed form", "elastica", "planar beam, 300 at once", "rod, one"),
    "posteriors": ("Laplace", "quadrature", "emcee, stacked"),
    "jnds": ("closed form", "exact slope", "posteriors, quadrature", "posteriors, emcee"),
}


def conclusions(table: pd.DataFrame) -> list[str]:
    """Three sentences: which method for which scene, where each fails, what more would have cost.

    Of the table of all parts; a method is quickest in a scene among those without a failure whose
    error is within `ENOUGH`, at the largest number of items in one call.
    """
    quickest, failing, extra = [], [], []
    for part, allowed in ENOUGH.items():
        here = table[(table["part"] == part) & table["failed"].notna()]
        for scene, rows in here.groupby("scene", sort=False):
            good = rows[(rows["error"] <= allowed) & (rows["failed"] == 0)]
            if good.empty:
                continue
            best = good.loc[good["seconds"].idxmin()]
            quickest.append(f"{scene}: {best['method']} ({in_time(best['seconds'])})")
            bad = [m for m, own in rows.groupby("method", sort=False)
                   if own["failed"].max() > 0 or own["error"].min() > allowed]  # fmt: skip
            if bad:
                failing.append(f"{scene}: {', '.join(bad)}")
            more = good[good["method"].isin(MORE[part]) & (good["method"] != best["method"])]
            costs = more.groupby("method", sort=False)["seconds"].min() / best["seconds"]
            if costs.size:
                each = ", ".join(f"{m} {two_digits(c)} times" for m, c in costs.items())
                extra.append(f"{scene}: {each}")
    allowed_words = "0.1 JND in a moment (k = 0.1), 3 % in an sd or a JND"
    return [
        f"Quickest within {allowed_words}: {'; '.join(quickest)}.",
        f"Never within that, or flagged or without an answer somewhere: {'; '.join(failing)}.",
        f"What modelling more would have cost, over the quickest: {'; '.join(extra)}.",
    ]


def in_time(seconds: float) -> str:
    """A time in the unit that suits it."""
    units = (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9))
    unit, size = next((u for u in units if seconds >= u[1]), units[-1])
    return f"{two_digits(seconds / size)} {unit}"


def two_digits(value: float) -> str:
    """A number to two digits, without an exponent below a million."""
    return f"{float(f'{value:.2g}'):,g}"
