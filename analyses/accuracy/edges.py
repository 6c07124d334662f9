"""Readings of observers with priors, and of contacts at edges, beside plain sums: which are wrong?

    python analyses/accuracy/edges.py [table] [--count 300] [--seed 20261128 20261129]

Appends a row a reading to `edges.csv`, and prints a row a kind; what the table has is not made
again. The kinds: priors of the angle that begin above zero, priors of the distance that end inside
the whisker, the tip of whiskers that rub, and contacts beside the fold; a third of the readings are
at an edge, which is an end of the prior, the tip or the fold to within a hundredth.

The sums are over distance r and share v of the angles there, θ = low + (high − low) sin²(πv/2),
high being the fold or the prior's end: many lines are near either. Each line of one distance has a
stretch of v of its own, found by looking at the density to the power 1/16, 1/4 and 1. Sums over
every second line say what error is left, and lines are doubled until it is a third of the bars;
readings where it stays more are left out. Nothing of `weberwhisk.inference` but `Observer` has a
part in it, and the likelihood is that of `truth.py`.

A reading is silently wrong if it is *converged* and off by more than three times its claim and more
than 1e-2 sd in mean or sd, or 2e-2 sd in an end of the 95 % interval.
"""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from cases import largest_angle
from compare import off
from numpy.typing import NDArray
from scipy import stats
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.optimize import brentq
from truth import log_likelihood

sys.path.insert(0, str(Path(__file__).parents[1]))
from command import resumed

import weberwhisk as ww
from weberwhisk import cues, receptors

Array = NDArray[np.float64]

TABLE = Path(__file__).with_name("edges.csv")
KINDS = ("angle above zero", "distance within", "rubbing tip", "beside the fold")
MOMENTS, ENDS = 1e-2, 2e-2
SURE = 1 / 3  # of the bars that the sums may be off by
#: Powers of the density that are looked at with lines of distance and angle, lines of the sums, and
#: ln of the share below which nothing is summed.
LOOKS, LINES, DROP = ((16.0, (300, 600)), (4.0, (400, 200)), (1.0, (500, 100))), (1000, 200), 28.0


def between(low: float, high: float, rng: np.random.Generator) -> Any:
    """A prior with that support: even, normal cut off at its ends, or a beta."""
    which, width = rng.integers(3), high - low
    if which == 0:
        return stats.uniform(low, width)
    if which == 1:
        middle, sd = rng.uniform(low, high), width * rng.uniform(0.2, 1.0)
        return stats.truncnorm((low - middle) / sd, (high - middle) / sd, middle, sd)
    return stats.beta(*rng.uniform(1.0, 4.0, 2), loc=low, scale=width)


class Case:
    """An observer, its reading and its domain.

    Parameters
    ----------
    index, seed : int
    """

    def __init__(self, index: int, seed: int) -> None:
        rng = np.random.default_rng([seed, index])
        self.kind = KINDS[index % len(KINDS)]
        self.edge = bool(rng.random() < 1 / 3)
        while True:
            try:
                self._draw(rng)
                return
            except ValueError:  # of a whisker or a contact that there is not
                continue

    def _draw(self, rng: np.random.Generator) -> None:
        tip = self.kind == "rubbing tip"
        ratio = rng.uniform(1.5, 4.0) if tip else np.exp(rng.uniform(np.log(3), np.log(40)))
        base, curved = rng.uniform(60e-6, 120e-6), not tip and rng.random() < 0.2
        self.whisker = ww.Whisker(
            rng.uniform(20e-3, 60e-3), base, base / ratio, 3e9,
            curvature=rng.uniform(3, 15) * rng.choice([-1, 1]) if curved else 0.0,
        )  # fmt: skip
        self.cue: Any = cues.ForceMap()
        if tip:
            self.cue = cues.Friction(cues.ForceMap(), angle=float(rng.uniform(0.03, 0.2)))
        length, k = self.whisker.length, float(np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
        self.group = {"k": [k, k], "floor": [1e-9, 1e-6] if tip or curved else [0.0, 0.0], "rho": 0}
        self.prior: dict[str, Any] = {}
        least, most, self.low = 0.002 * length, float(self.cue.farthest(self.whisker)), 0.0
        if self.kind == "angle above zero" or (
            self.kind == "beside the fold" and rng.random() < 0.5
        ):
            low = float(rng.uniform(0.05, 0.6))
            self.prior["deflection_angle"] = between(low, low + rng.uniform(0.05, 0.5), rng)
            self.low = low
            most = float(brentq(lambda r: self.fold(np.array([r]))[0] - low, 0.05 * length, most))
        if self.kind == "distance within":
            first = float(rng.uniform(0.1, 0.7)) * length
            last = min(first + float(rng.uniform(0.1, 0.5)) * length, 0.98 * most)
            self.prior["radial_distance"] = between(first, last, rng)
            least, most = first, last
        self.ends = least, most
        noise = receptors.GeneralisedWeber(k, floor=self.group["floor"])
        self.observer = ww.Observer(self.whisker, self.cue, noise, self.prior)
        share = rng.uniform(0.1, 0.9)
        if self.edge and self.kind in ("distance within", "rubbing tip"):
            share = rng.choice([0.01, 0.99]) if self.kind == "distance within" else 0.995
        r = least + share * (most - least)
        high = self.high(np.array([r]))[0]
        across = rng.uniform(0.05, 0.95)
        if self.kind == "beside the fold":
            across = rng.uniform(0.99, 0.9999) if self.edge else rng.uniform(0.9, 0.99)
        elif self.edge and self.kind == "angle above zero":
            across = rng.choice([0.01, 0.99])
        contact = np.array([r, self.low + across * (high - self.low)])
        self.reading = self.observer.read(contact, rng)

    def fold(self, r: Array) -> Array:
        """Largest angle held at distances, rad."""
        contact = np.stack([r, np.zeros(r.shape)], axis=-1)
        return largest_angle(self.cue, self.whisker, contact)

    def high(self, r: Array) -> Array:
        """The largest angle that is summed at distances, rad."""
        if "deflection_angle" not in self.prior:
            return self.fold(r)
        return np.minimum(self.fold(r), self.prior["deflection_angle"].support()[1])

    def density(self, r: Array, v: Array) -> tuple[Array, Array, Array]:
        """Angles and ln of the density in v (m, n), and the steps of v (m, 1)."""
        width = np.maximum(self.high(r) - self.low, 0.0)[:, None]
        angle = self.low + width * np.sin(0.5 * np.pi * v) ** 2
        contact = np.stack(np.broadcast_arrays(r[:, None], angle), axis=-1)
        with np.errstate(all="ignore"):
            signals, outcome = self.observer.signals(contact)
            log = log_likelihood([self.group], self.reading, signals)
            log = np.where(outcome == 0, log, -np.inf) + np.log(
                width * 0.5 * np.pi * np.sin(np.pi * v)
            )
        if "deflection_angle" in self.prior:
            log = log + self.prior["deflection_angle"].logpdf(angle)
        if "radial_distance" in self.prior:
            log = log + self.prior["radial_distance"].logpdf(r)[:, None]
        return angle, np.where(np.isnan(log), -np.inf, log), v[:, 1:2] - v[:, :1]


def middles(first: float, last: float, count: int) -> Array:
    """Middles of even steps."""
    return first + (last - first) * (np.arange(count) + 0.5) / count


def summed(case: Case) -> tuple[Array, float]:
    """Mean, sd and ends of the 95 % interval of distance and angle, (2, 4), and the error left as a
    share of the bars; lines are doubled until that is a third."""
    (first, last), low, high = case.ends, np.zeros(2), np.ones(2)
    at = np.array([first, last])
    for power, count in LOOKS:
        r = middles(first, last, count[0])
        v = spaced(np.interp(r, at, low), np.interp(r, at, high), count[1])
        _, log, step = case.density(r, v)
        first, last, at, low, high = stretches(r, v, log > log.max() - power * DROP, step)
    bars = np.array([MOMENTS, MOMENTS, ENDS, ENDS])
    for times in (1, 2, 4):
        r = middles(first, last, times * LINES[0])
        v = spaced(np.interp(r, at, low), np.interp(r, at, high), times * LINES[1])
        angle, log, step = case.density(r, v)
        weight = np.exp(log - log.max()) * step
        distance = np.broadcast_to(r[:, None], angle.shape)
        edges = np.linspace(first, last, len(r) + 1)
        out = np.array([described(distance, weight, edges), described(angle, weight)])
        half = slice(1, None, 2)
        coarse = [described(distance[half, half], weight[half, half], edges[::2]),
                  described(angle[half, half], weight[half, half])]  # fmt: skip
        left = float((np.abs(out - coarse) / out[:, 1:2] / bars).max())
        if left < SURE:
            break
    return out, left


def spaced(low: Array, high: Array, count: int) -> Array:
    """Middles (n, count) of even steps between ends (n,)."""
    return low[:, None] + (high - low)[:, None] * middles(0.0, 1.0, count)


def stretches(
    r: Array, v: Array, inside: NDArray[np.bool_], step: Array
) -> tuple[float, float, Array, Array, Array]:
    """Of the domain inside: where distances begin and end, and at distances (n,), rising, where
    shares of the angles do, with two lines more on every side."""
    held, lines = np.flatnonzero(inside.any(axis=1)), np.arange(len(r))
    apart, rows = r[1] - r[0], lines[max(held[0] - 2, 0) : held[-1] + 3]
    first = np.where(inside, v, np.inf).min(axis=1) - 2 * step[:, 0]
    last = np.where(inside, v, -np.inf).max(axis=1) + 2 * step[:, 0]
    # A line may slip through between two nodes.
    first, last = (np.interp(lines, held, end[held]) for end in (first, last))
    first, last = minimum_filter1d(first, 5)[rows], maximum_filter1d(last, 5)[rows]
    ends = r[rows[0]] - 0.5 * apart, r[rows[-1]] + 0.5 * apart
    return *ends, r[rows], np.clip(first, 0, 1), np.clip(last, 0, 1)


def described(x: Array, weight: Array, edges: Array | None = None) -> Array:
    """Mean, sd and ends of the 95 % interval of values with weights, by a smooth curve through the
    mass below each of the edges."""
    share = weight / weight.sum()
    mean = float((share * x).sum())
    sd = float(np.sqrt((share * (x - mean) ** 2).sum()))
    if edges is None:
        edges = np.linspace(x.min(), x.max(), 2001)
    mass, _ = np.histogram(x, edges, weights=share)
    with np.errstate(over="ignore"):  # of slopes where there is no mass
        below = PchipInterpolator(edges, np.r_[0, np.cumsum(mass)])
    fine = np.linspace(edges[0], edges[-1], 100_001)
    return np.array([mean, sd, *np.interp([0.025, 0.975], below(fine), fine)])


def judged(index: int, seed: int) -> dict[str, Any]:
    """One reading: its posterior beside the sums."""
    case = Case(index, seed)
    truth, left = summed(case)
    found = ww.posterior(case.observer, case.reading)
    truth_of = dict(zip(case.cue.unknowns, truth, strict=True))
    return {
        "index": index, "seed": seed, "kind": case.kind, "edge": case.edge,
        "curved": case.whisker.curvature != 0, "status": found.status.name, "left": left,
        **off(found, truth_of, MOMENTS, ENDS),
    }  # fmt: skip


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row a kind, and one of all; readings whose sums are not good enough are left out."""
    sure, out = rows[rows["left"] < SURE], []
    for kind, own in [*sure.groupby("kind", sort=False), ("all", sure)]:
        silent = own[own["status"] == "CONVERGED"]
        out.append({
            "kind": kind, "readings": len(own), "at an edge": int(own["edge"].sum()),
            "flagged": len(own) - len(silent), "silently wrong": int((silent["bar"] > 1).sum()),
            "worst mean, sd": silent["moments"].max(), "worst end": silent["ends"].max(),
        })  # fmt: skip
    return pd.DataFrame(out)


def search(
    judged: Callable[..., dict[str, Any]], doc: str, table: Path, count: int, seeds: list[int]
) -> None:
    """Judge the cases that the table lacks, and print what is found; `doc` is the script's, and the
    table, how many cases of a seed and the seeds may be said otherwise."""
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(doc), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", type=Path, nargs="?", default=table)
    parser.add_argument("--count", type=int, default=count, help=f"of a seed; by default {count}")
    parser.add_argument("--seed", type=int, nargs="+", default=seeds)
    given = parser.parse_args()
    if given.count < 1:
        parser.error(f"--count must be at least 1, not {given.count}; write {count}, say")
    designs = [{"index": i, "seed": seed} for seed in given.seed for i in range(given.count)]
    rows = resumed(
        given.table, judged, designs, digits=4, columns=["kind", "edge", "status", "left", "bar"]
    )
    print(summary(rows).to_string(index=False, float_format="{:.3g}".format))
    worst = rows[(rows["bar"] > 1) & (rows["left"] < SURE)]
    if len(worst):
        print("\nBeyond the bars (`bar` is how many times):")
        print(worst.to_string(index=False, float_format="{:.3g}".format))


if __name__ == "__main__":
    search(judged, __doc__ or "", TABLE, 300, [20261128, 20261129])
