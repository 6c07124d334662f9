"""CPU time of a trial placed and recorded, and how far the belief is from the fit.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_adaptive.py [sessions]

A session has 300 trials. Times are CPU milliseconds of `next` and `record` together: the median,
the mean, 99 in 100, and the longest, in which the grid was laid anew. November 2026, a busy
machine, two sessions each: k at one standard 0.7, 0.8, 3.6 and 7.7 ms; with a bias at each of three
standards 1.5, 1.7, 9.3 and 15. Quantiles are off by 0.02 posterior sd at most.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import weberwhisk as ww
from weberwhisk.behaviour import IdentityEncoding, response_probability
from weberwhisk.design import BayesianPlacer, Hypothesis, Scheme, lattice, taper

TRIALS = 300


def timed(name: str, make: object, sessions: int) -> None:
    times, off, begin = [], [], []
    for seed in range(sessions):
        start = time.process_time()
        placer = make(seed)  # type: ignore[operator]
        begin.append(time.process_time() - start)
        h, rng = placer.hypotheses[0], np.random.default_rng(seed)
        for _ in range(TRIALS):
            start = time.process_time()
            trial = placer.next()
            middle = time.process_time()
            p = response_probability(
                h.asked, h.encoding, trial.standard, trial.comparison,
                weber_fraction=0.1, lapse_low=0.03, lapse_high=0.03,
            )  # fmt: skip
            choice, again = int(rng.random() < p[0]), time.process_time()
            placer.record(trial.standard, trial.comparison, choice)
            times.append(time.process_time() - again + middle - start)
        if isinstance(placer, BayesianPlacer):
            fit, at = placer.fits()[placer.best.hypothesis.name], np.array([0.025, 0.5, 0.975])
            gap = placer.best.quantile(at) - fit.posterior.quantile("weber_fraction", at)
            off.append(np.abs(gap).max() / fit.posterior.sd("weber_fraction"))
    t = 1e3 * np.array(times)
    error = f", quantiles off by {max(off):.3f} posterior sd at most" if off else ""
    print(
        f"{name:38s} {np.median(t):5.2f} {t.mean():5.2f} {np.quantile(t, 0.99):5.2f} "
        f"{t.max():6.1f} ms; over 5 ms: {100 * np.mean(t > 5):4.1f} %; to begin "
        f"{1e3 * np.median(begin):.0f} ms{error}",
        flush=True,
    )


def main() -> None:
    sessions = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    one = Hypothesis("Weber", IdentityEncoding(), bias="shared")
    several = Hypothesis("Weber", IdentityEncoding())
    pair = taper(ww.Whisker(50e-3, 100e-6, 5e-6))
    places = np.array([15e-3, 30e-3, 45e-3])
    levels = [lattice(h.encoding, places, each_side=10).offsets for h in pair]
    both = Scheme(places, [sorted({*a, *b}) for a, b in zip(*levels, strict=True)])
    single, triple = lattice(one.encoding, 1.0), lattice(one.encoding, [0.5, 1.0, 2.0])
    for name, make in (
        ("k, one standard", lambda s: BayesianPlacer(one, single, seed=s)),
        ("k, three standards, a bias each", lambda s: BayesianPlacer(several, triple, seed=s)),
        ("taper, three standards, a bias each",
         lambda s: BayesianPlacer(pair, both, goal="hypothesis", seed=s)),
        ("everything (QUEST+), one standard",
         lambda s: BayesianPlacer(one, single, goal="everything", seed=s)),
    ):  # fmt: skip
        timed(name, make, sessions)


if __name__ == "__main__":
    main()
