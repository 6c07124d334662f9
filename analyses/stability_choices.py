"""The part of `stability.py` that searches JNDs and in fits of choices.

JNDs by propagation are held against slopes of DOP853 trajectories. A fit of choices is held against
the integral of its own model on an even grid, written anew with SciPy's distributions: the ends of
the 95 % interval and the median of the Weber fraction, and whether the data exclude both ends of
the prior, as the status says.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from fault_search import Axis, Domain, Fate, Judged
from reference_beam import Beams
from scipy import stats
from scipy.interpolate import CubicSpline
from scipy.special import ndtr, ndtri, xlogy

import weberwhisk as ww
from weberwhisk import Observer, Outcome, Whisker, cues, domain, receptors
from weberwhisk.behaviour import FitStatus, fit_weber, read_trials
from weberwhisk.sensitivity import weber_propagation

Array = np.ndarray
Case = dict[str, Array]
LENGTH, BASE, MODULUS = 50e-3, 100e-6, 3e9


# -- JNDs -----------------------------------------------------------------------------------------

JND_AXES = {
    "distance": Axis(0.02, 1.0, special=(1.0,)),
    "push": Axis(1e-3, 1.0, special=(1.0,)),
    "tip": Axis(0.0, 1.0, special=(0.05,)),
    "k_moment": Axis(*domain.WEBER_FRACTIONS, log=True),
    "k_force": Axis(*domain.WEBER_FRACTIONS, log=True),
    "correlation": Axis(-0.99, 0.99, special=(0.0,)),
}
#: Relative error of a JND from which it is wrong; what differences of DOP853 leave is less.
JND_ERROR = 1e-4


def judge_jnd(case: Case) -> Judged:
    """Weber propagation of moment and axial force, beside slopes by differences."""
    n = case["distance"].size
    r, tip = case["distance"] * LENGTH, BASE * case["tip"]
    whisker = Whisker(LENGTH, BASE, tip, MODULUS)
    end = np.nan_to_num(ww.flick_past(whisker, r).deflection_angle)
    theta = case["push"] * end
    one = np.ones(n)
    beams = Beams(LENGTH * one, BASE * one, tip, MODULUS * one, 0 * one, 0 * one)
    walk = beams.walk(r, theta)
    exact = beams.polish(r, theta, walk["arc"], walk["force"], steps=6)
    inside = np.minimum(exact["arc"], LENGTH * (1 - 2e-5))
    here, slope = beams.contact_slopes(inside, exact["force"])
    found, jnd, known = np.full((3, n), np.nan)
    held = np.zeros(n, dtype=bool)
    for i in range(n):
        one_whisker = Whisker(LENGTH, BASE, float(tip[i]), MODULUS)
        noise = receptors.Weber(
            [case["k_moment"][i], case["k_force"][i]], correlation=float(case["correlation"][i])
        )
        o = Observer(one_whisker, cues.ForceMap(), noise)
        if not theta[i] > 0 or o.signals([r[i], theta[i]])[1] != Outcome.HELD:
            continue
        held[i] = True
        jnd[i] = weber_propagation(o, np.array([r[i], theta[i]]))
        sd = np.abs(here[:2, i]) * [case["k_moment"][i], case["k_force"][i]]
        rho = case["correlation"][i]
        scaled = slope[:2, :, i] / sd[:, None] * [r[i], theta[i]]
        with np.errstate(all="ignore"):
            if abs(np.linalg.det(scaled / np.linalg.norm(scaled, axis=0))) > 1e-7:
                row = np.linalg.inv(scaled)[0]
                found[i] = np.sqrt(row @ np.array([[1, rho], [rho, 1]]) @ row) * r[i]
                # What the differences leave (1e-8) through the inverse.
                known[i] = 1e-7 * np.linalg.norm(row) ** 2 / (row @ [[1, rho], [rho, 1]] @ row)
                known[i] *= np.linalg.cond(scaled / np.linalg.norm(scaled, axis=0))
    solved = (walk["end"] == 0) & (exact["left"] < 1e-7) & np.isfinite(found)
    with np.errstate(all="ignore"):
        error = np.abs(jnd / found - 1)
        # Next to an apex, of whose distance the differences' steps are a part.
        room = 1 - (1 - case["tip"]) * inside / LENGTH
        known += 3 * (1e-5 / room) ** 2
        allowed = JND_ERROR + known + 1e-8 / np.maximum(1 - case["push"], 1e-12)
        excess = np.log(np.maximum(error, 1e-300) / allowed)
    fate = np.full(n, Fate.REFUSED)
    fate[held & ~np.isfinite(jnd)] = Fate.WARNED  # infinite: the signals cannot tell distance
    fate[held & np.isfinite(jnd) & ~solved] = Fate.UNJUDGED
    right = held & np.isfinite(jnd) & solved
    fate[right] = np.where(error[right] > allowed[right], Fate.SILENT, Fate.RIGHT)
    # Steps of 1e-5 do not tell slopes so close to the fold, or so close to the tip.
    fate[right & ((allowed > 0.01) | (exact["arc"] > inside))] = Fate.UNJUDGED
    seen = {"jnd": jnd, "exact": found, "error": error}
    return Judged(
        fate, np.where(fate <= Fate.SILENT, np.where(right, excess, -np.inf), -np.inf), seen
    )


# -- fits -----------------------------------------------------------------------------------------

FIT_AXES = {
    "weber_fraction": Axis(*domain.FITTED_WEBER_FRACTIONS, log=True, special=(0.1,)),
    "lapse": Axis(0.0, 0.45, special=(0.02,)),
    "bias": Axis(-3.0, 3.0, special=(0.0,)),
    "trials": Axis(1.0, 1000.0, log=True),
    "levels": Axis(1.0, 9.0),
    "span": Axis(0.01, 0.9, log=True),
    "answers": Axis(0.0, 1.0, special=(0.5,)),
}
ENDS = np.array([0.025, 0.5, 0.975])
#: Error of the interval's ends and median allowed, in posterior sds of ln k.
FIT_ERROR = 0.03
#: How well the grid must know its own answer to judge.
UNKNOWN = 0.02
#: Draws from the prior that count from which their weighing judges better than a grid.
ENOUGH = 30_000
#: Sum of both lapses near which a grid has steps, and the mass there that is too little to matter.
ALL_LOST, LITTLE = 0.9, 0.01
#: Likelihood ratio at 3 prior sds that a status calls open or not, and how near is undecided.
OPEN, UNSURE = 0.1, 0.3
FAR = 3.0


def table(case: Case, i: int) -> tuple[Array, int, Array]:
    """Comparisons against 1, trials of each, and answers: quantiles of the binomial."""
    count = round(float(case["levels"][i]))
    x = np.linspace(-1, 1, count) if count > 1 else np.array([1.0])
    levels = 1 + x * case["span"][i]
    n = round(float(case["trials"][i]))
    drive = (levels - 1) / (case["weber_fraction"][i] * np.hypot(levels, 1))
    lapse = case["lapse"][i]
    p = lapse + (1 - 2 * lapse) * ndtr(drive + case["bias"][i])
    # Answers vary with level in a way that the case repeats: a low-discrepancy sequence.
    u = (case["answers"][i] + 0.6180339887498949 * np.arange(count)) % 1
    return levels, n, stats.binom.ppf(np.clip(u, 1e-6, 1 - 1e-6), n, p)


BIAS = stats.cauchy(0, 0.7)


@cache
def believed() -> tuple[Array, Array, Array, Array]:
    """Scores of k, lapses and biases as believed beforehand: a low-discrepancy sequence."""
    z, low, high, bias = ndtri(stats.qmc.Sobol(4, seed=1).random_base2(19)).T
    lapses = stats.beta(0.7, 20)
    other = lapses.ppf(ndtr(0.7 * low + np.sqrt(0.51) * high))
    return z, lapses.ppf(ndtr(low)), other, BIAS.ppf(ndtr(bias))


def weighed_fit(levels: Array, n: int, answers: Array) -> tuple[Array, float]:
    """Quantiles of ln k by weighing what was believed; how many of these draws count."""
    z, low, high, bias = believed()
    log = np.where(low + high < 1, 0.0, -np.inf)
    for drive, hits in zip((levels - 1) / np.hypot(levels, 1), answers, strict=True):
        u = drive * np.exp(-np.log(3.0) * z) / 0.1 + bias
        p = low * ndtr(-u) + (1 - high) * ndtr(u)
        q = (1 - low) * ndtr(-u) + high * ndtr(u)
        log += xlogy(hits, np.maximum(p, 1e-300)) + xlogy(n - hits, np.maximum(q, 1e-300))
    weight = np.exp(log - log.max())
    order = np.argsort(z)
    rise = np.cumsum(weight[order])
    ends = np.interp(ENDS, rise / rise[-1], z[order])
    return ends * np.log(3.0) + np.log(0.1), float(rise[-1] ** 2 / (weight**2).sum())


def exact_fit(levels: Array, n: int, answers: Array) -> tuple[Array, float, Array, float]:
    """Quantiles of ln k, its sd, ln likelihood ratios at ±3 prior sds, and how well known."""
    drive = (levels - 1) / np.hypot(levels, 1)
    # Scores of k (a perfect observer's far below what is believed) and of both lapses, the bias.
    windows = [(-9.0, 5.5), (-5.5, 5.5), (-5.5, 5.5), (-30.0, 30.0)]
    pair = stats.multivariate_normal(cov=[[1, 0.7], [0.7, 1]])
    lapses = stats.beta(0.7, 20)
    for sizes in ((59, 15, 15, 121), (61, 15, 15, 61), (121, 19, 19, 41)):
        k, low, high, b = (np.linspace(*w, m) for w, m in zip(windows, sizes, strict=True))
        p_low, p_high = (lapses.ppf(ndtr(z))[:, None] for z in (low, high))
        p_low, p_high = p_low[:, None, :], p_high[None, :, :]
        prior = pair.logpdf(np.stack(np.meshgrid(low, high, indexing="ij"), -1))
        prior = np.where((p_low + p_high)[..., 0] < 1, prior, -np.inf)
        log = np.empty(sizes)
        for i, z in enumerate(k):
            up = ndtr(drive * np.exp(-np.log(3.0) * z) / 0.1 + b[:, None])  # (bias, cells)
            down = ndtr(-drive * np.exp(-np.log(3.0) * z) / 0.1 - b[:, None])
            total = np.zeros(sizes[1:])
            for c in range(levels.size):
                p = p_low * down[:, c] + (1 - p_high) * up[:, c]
                q = (1 - p_low) * down[:, c] + p_high * up[:, c]
                total += answers[c] * np.log(np.maximum(p, 1e-300))
                total += (n - answers[c]) * np.log(np.maximum(q, 1e-300))
            log[i] = total + prior[..., None] + BIAS.logpdf(b) - 0.5 * z**2
        weight = np.exp(log - log.max())
        axes = (k, low, high, b)
        marginal = np.log(np.maximum(weight.sum(axis=(1, 2, 3)), 1e-300)) + 0.5 * k**2
        inside = np.abs(k) <= FAR + 0.5
        ratio = np.interp([-FAR, FAR], k, marginal, left=-np.inf, right=-np.inf)
        ratio -= marginal[inside].max(initial=-700.0)
        for i, axis in enumerate(axes):
            mass = weight.sum(axis=tuple(j for j in range(4) if j != i))
            held = np.flatnonzero(mass > 1e-8 * mass.max())
            step = axis[1] - axis[0]
            windows[i] = (axis[held[0]] - step, axis[held[-1]] + step)
    found = []
    for every in (1, 2):
        part = weight[::every, ::every, ::every, ::every].sum(axis=(1, 2, 3))
        z = k[::every]
        fine = np.linspace(z[0], z[-1], 2001)
        density = np.exp(CubicSpline(z, np.log(np.maximum(part, 1e-290 * part.max())))(fine))
        rise = np.cumsum(density)
        found.append(np.interp(ENDS, rise / rise[-1], fine) * np.log(3.0))
        sd = float(np.sqrt(np.average((fine - np.average(fine, weights=density)) ** 2,
                                      weights=density))) * np.log(3.0)  # fmt: skip
    off = float(np.abs(found[0] - found[1]).max()) / sd
    # Lapses that leave no rise are cut off: where mass lies against that, the grid has steps.
    cut = weight[:, (p_low + p_high)[..., 0] > ALL_LOST].sum() / weight.sum()
    weighed, counted = weighed_fit(levels, n, answers)
    if counted > ENOUGH:
        return weighed, sd, ratio, 3 / np.sqrt(counted)
    return found[0] + np.log(0.1), sd, ratio, off if cut < LITTLE else np.inf


def judge_fit(case: Case, method: str = "quadrature") -> Judged:
    """Each case's fit beside the grid."""
    n = case["trials"].size
    fate, excess = np.full(n, Fate.RIGHT), np.full(n, -np.inf)
    seen = {key: np.full(n, np.nan) for key in ("error", "low", "median", "high", "ratio_below",
                                                "ratio_above")}  # fmt: skip
    status = np.full(n, "", dtype=object)
    for i in range(n):
        levels, count, answers = table(case, i)
        frame = pd.DataFrame(
            {"standard": 1.0, "comparison": levels, "n": count, "n_greater": answers.astype(int)}
        )
        fit = fit_weber(read_trials(frame), method=method, seed=1)
        status[i] = fit.status.name
        if fit.posterior.trouble:
            fate[i] = Fate.WARNED
            continue
        exact, sd, ratio, known = exact_fit(levels, count, answers)
        got = np.log([float(fit.posterior.quantile("weber_fraction", p)) for p in ENDS])
        error = float(np.abs(got - exact).max()) / sd
        allowed = FIT_ERROR * (1 if method == "quadrature" else 5) + known
        seen["error"][i] = error
        seen["low"][i], seen["median"][i], seen["high"][i] = np.exp(got)
        seen["ratio_below"][i], seen["ratio_above"][i] = ratio
        if known > UNKNOWN:
            fate[i] = Fate.UNJUDGED
            continue
        excess[i] = np.log(max(error, 1e-300) / allowed)
        if fit.status is not FitStatus.DETERMINED:
            fate[i] = Fate.WARNED
        if error > allowed:
            fate[i] = Fate.SILENT
        # An end that the data leave open, called theirs.
        if fit.status is FitStatus.DETERMINED and ratio.max() > np.log(OPEN) + UNSURE:
            fate[i], excess[i] = Fate.SILENT, max(excess[i], ratio.max() - np.log(OPEN))
    return Judged(fate, excess, {**seen, "status": status})


def _by_emcee(case: Case) -> Judged:
    return judge_fit(case, "emcee")


AT_CHANCE = FIT_AXES | {"weber_fraction": Axis(3.0, 100.0, log=True), "lapse": Axis(0.0, 0.5)}
PERFECT = FIT_AXES | {
    "weber_fraction": Axis(1e-6, 0.01, log=True),
    "lapse": Axis(0.0, 1e-3, special=(0.0,)),
}
FEW = FIT_AXES | {"trials": Axis(1.0, 3.0), "levels": Axis(1.0, 4.0)}

DOMAINS = [
    Domain("JND by propagation", JND_AXES, judge_jnd),
    Domain("fit of choices", FIT_AXES, judge_fit),
    Domain("fit of choices at chance", AT_CHANCE, judge_fit),
    Domain("fit of perfect choices", PERFECT, judge_fit),
    Domain("fit of few choices", FEW, judge_fit),
    Domain("fit of choices by emcee", FIT_AXES, _by_emcee),
    Domain("fit of few choices by emcee", FEW, _by_emcee),
]
