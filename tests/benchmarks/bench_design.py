"""Simulated experiments a second, against a plain loop of fits, and a whole power analysis.

    OMP_NUM_THREADS=1 python tests/benchmarks/bench_design.py [experiments]

An experiment of 504 trials (three standards, six levels) is simulated, fitted by quadrature under
two models and compared: in this process, by its CPU seconds, and by `power` on two worker
processes, by the clock: from the call to the table, and from the first chunk to the last, which
leaves out what the workers take to begin. The power analysis is `smallest` with its defaults, by
the clock too. Clocks tell of the package only where nothing else runs.

November 2026, a machine of two cores with ten things running: 1600 to 1680 experiments a CPU
second with one animal as it is, 1130 to 1190 with animals that differ, so that two cores do some
2300 to 3300 a second. `weberwhisk design --animals 3 --half-width 0.2 --standard-mm 10,20,30
--weber-fraction 0.15` took 127 CPU seconds, a minute of two cores, and 0.7 GB a worker at most; it
ends by saying that 1000 trials a comparison will not do. A plan of 18 000 trials with its lists,
page and figures (`--trials 1000 --runs 0`) took 6.7 CPU seconds where it took six minutes.
"""

from __future__ import annotations

import sys
import time

import numpy as np

import weberwhisk as ww
from weberwhisk.behaviour import fit_weber, simulate_trials
from weberwhisk.design import Hypothesis, Scheme, SubjectPopulation, power, smallest, taper
from weberwhisk.design.simulation import compare, simulate

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
PLACES = [15e-3, 30e-3, 45e-3]
LEVELS = (-2.0, -1.2, -0.6, 0.6, 1.2, 2.0)  # sds of the expected difference
ANIMALS = {
    "one animal as it is": SubjectPopulation(0.1, 0.0, 0.03, 0.0, lapses_vary=False),
    "animals that differ": SubjectPopulation(),
}


def engine(hypotheses: tuple[Hypothesis, ...], animals: SubjectPopulation, count: int) -> float:
    """Experiments a CPU second."""
    scheme = Scheme.spaced(hypotheses[0].encoding, PLACES, levels=LEVELS, trials=28)
    start = time.process_time()
    counts, _ = simulate(hypotheses[0], scheme, animals, count, np.random.default_rng(1))
    compare(hypotheses, hypotheses[0].name, scheme, counts)
    return count / (time.process_time() - start)


def together(
    hypotheses: tuple[Hypothesis, ...], animals: SubjectPopulation, count: int
) -> tuple[float, float]:
    """Experiments a second of `power` on two worker processes: in all, and once they have begun."""
    scheme = Scheme.spaced(hypotheses[0].encoding, PLACES, levels=LEVELS, trials=28)
    done: list[tuple[float, float]] = []
    start = time.perf_counter()
    power(
        scheme, hypotheses, expected=animals, truths=[hypotheses[0].name], runs=count, workers=2,
        progress=lambda more: done.append((time.perf_counter(), more)),
    )  # fmt: skip
    end, chunks = time.perf_counter(), [(when, more) for when, more in done if more]
    share = sum(more for _, more in chunks[1:]) / sum(more for _, more in chunks)
    return count / (end - start), share * count / (chunks[-1][0] - chunks[0][0])


def loop(hypotheses: tuple[Hypothesis, ...], count: int) -> float:
    """The named alternative: `simulate_trials` and `fit_weber`, one experiment after another."""
    scheme = Scheme.spaced(hypotheses[0].encoding, PLACES, levels=LEVELS, trials=28)
    start = time.process_time()
    for seed in range(count):
        trials = simulate_trials(
            encoding=hypotheses[0].encoding, standards=PLACES, comparisons=scheme.comparisons,
            trials_per_level=28, lapse_low=0.03, lapse_high=0.03, seed=seed,
        )  # fmt: skip
        fits = [fit_weber(trials, encoding=h.encoding, bias="per standard") for h in hypotheses]
        _ = fits[0].log_evidence - fits[1].log_evidence, fits[0].interval(0.95)
    return count / (time.process_time() - start)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2048
    hypotheses = taper(WHISKER)
    plain = loop(hypotheses, 10)
    print(f"a loop of fit_weber: {plain:.1f} experiments per CPU second")
    for words, animals in ANIMALS.items():
        engine(hypotheses, animals, 64)  # tables of priors are made once
        rate = engine(hypotheses, animals, count)
        print(f"batched, {words}: {rate:.0f} per CPU second, {rate / plain:.0f} times the loop")
        whole, steady = together(hypotheses, animals, 8 * count)
        print(
            f"power on two workers, {words}: {whole:.0f} a second by the clock, {steady:.0f} once "
            "they have begun",
            flush=True,
        )
    scheme = Scheme.spaced(hypotheses[0].encoding, PLACES, levels=LEVELS)
    start = time.perf_counter()
    _, found = smallest(scheme, hypotheses, workers=2)
    print(found.report())
    print(f"a whole power analysis, two workers: {time.perf_counter() - start:.0f} s of wall time")


if __name__ == "__main__":
    main()
