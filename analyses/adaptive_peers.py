"""Adaptive placement beside other packages', on the same simulated observers.

    python analyses/adaptive_peers.py [folder] [--short] [--workers 2]

Needs `pip install questplus SweetSpot psihope` (with torch for psihope); what is not installed is
left out and said so. Observers compare with one standard, 2AFC, with 3 % lapses a side and biases
of their own (sd 0.3), at k = 0.1; each is the same for every method, down to the uniform
numbers that decide its answers. Every package chooses from the same comparisons, and the same fit
(`fit_weber`) reads the trials, so that what differs is the trials that were chosen. Writes
adaptive_peers.csv, a row a fit, and adaptive_peers_trials.csv: the trials until the median 95 %
interval of k is within ±20 %, and CPU a trial, of choosing and of learning together.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from adaptive import BIAS_SD, EXPECTED, LAPSE, crossing
from command import options
from scipy import stats
from scipy.special import ndtr, ndtri

import weberwhisk as ww
from weberwhisk import campaign
from weberwhisk._util.output import Run
from weberwhisk.behaviour import IdentityEncoding, response_probability, task_named
from weberwhisk.design import BayesianPlacer, Hypothesis, lattice

#: Each method, with the module that it needs.
METHODS = {
    "weberwhisk": "weberwhisk", "weberwhisk, no easy trials": "weberwhisk",
    "questplus": "questplus", "SweetSpot": "SweetSpot", "psihope": "hope", "constant": "weberwhisk",
}  # fmt: skip
MARKS = (50, 100, 150, 200, 300, 400, 500, 600)
#: Of a method that takes longer with every trial.
MARKS_OF_SLOW = (50, 100, 150, 200, 300)
SLOW = ("psihope",)
MARKS_SHORT = (10, 20)
OBSERVERS = 4
WEBER_FRACTIONS = (0.1,)
WIDTH = 0.2
SEED = 20110166
SCHEME = lattice(IdentityEncoding(), np.array([1.0]))
LEVELS = np.array(SCHEME.comparisons[0])
#: Normal noise of both stimuli is, in ln of the comparison, an sd of k√2 about.
WIDER = np.sqrt(2.0)


class Placer:
    """The next comparison, and what its answer changes."""

    def __init__(self, seed: int) -> None:
        self.number = 0

    def next(self) -> float:
        raise NotImplementedError

    def learn(self, comparison: float, answer: int) -> None:
        raise NotImplementedError


class OurPlacer(Placer):
    """Expected information about k, others marginalised, of the observer's own model."""

    def __init__(self, seed: int, **how: Any) -> None:
        hypothesis = Hypothesis("Weber", IdentityEncoding(), bias="shared")
        self._placer = BayesianPlacer([hypothesis], SCHEME, goal="weber_fraction", seed=seed, **how)

    def next(self) -> float:
        return float(self._placer.next().comparison)

    def learn(self, comparison: float, answer: int) -> None:
        self._placer.record(1.0, comparison, answer)


class ConstantPlacer(Placer):
    """Six levels about the expected observer, at random."""

    def __init__(self, seed: int) -> None:
        z = np.array([-2.0, -1.2, -0.6, 0.6, 1.2, 2.0])
        self._levels, self._rng = np.exp(z * EXPECTED * WIDER), np.random.default_rng(seed)

    def next(self) -> float:
        return float(self._rng.choice(self._levels))

    def learn(self, comparison: float, answer: int) -> None:
        """No trial changes what comes next."""


#: Priors of the grids below: as ours of k, with the bias as a shift of ln comparison.
SDS = EXPECTED * WIDER * np.exp(np.linspace(-2.5, 2.5, 21))
SHIFTS = np.linspace(-0.35, 0.35, 15)
LAPSES = np.array([0.0, 0.03, 0.1])
OF_LAPSES = np.diff(stats.beta(0.7, 20).cdf([0.0, 0.015, 0.06, 1.0]))


class QuestPlusPlacer(Placer):
    """questplus: a normal in ln comparison with two lapses, entropy of all four parameters."""

    def __init__(self, seed: int) -> None:
        from questplus import QuestPlus

        of_sds = stats.norm(0, 1.099).pdf(np.log(SDS / (EXPECTED * WIDER)))
        of_shifts = stats.norm(0, EXPECTED * WIDER).pdf(SHIFTS)
        self._quest = QuestPlus(
            stim_domain={"intensity": np.log(LEVELS)},
            param_domain={"mean": SHIFTS, "sd": SDS, "lower_asymptote": LAPSES,
                          "lapse_rate": LAPSES},
            prior={"mean": of_shifts / of_shifts.sum(), "sd": of_sds / of_sds.sum(),
                   "lower_asymptote": OF_LAPSES / OF_LAPSES.sum(),
                   "lapse_rate": OF_LAPSES / OF_LAPSES.sum()},
            outcome_domain={"response": ["second", "first"]},
            func="norm_cdf",
            stim_scale="linear",
        )  # fmt: skip

    def next(self) -> float:
        return float(np.exp(self._quest.next_stim["intensity"]))

    def learn(self, comparison: float, answer: int) -> None:
        stimulus = {"intensity": self._quest.next_stim["intensity"]}
        self._quest.update(stim=stimulus, outcome={"response": ("first", "second")[answer]})


class SweetSpotPlacer(Placer):
    """SweetSpot: psi-marginal, a logistic in ln comparison; entropy of the slope alone."""

    def __init__(self, seed: int) -> None:
        from SweetSpot import Logistic, PsiMarginal, PsychometricFunction

        curve = PsychometricFunction(shape=Logistic(0.5), gamma=0.02, lambda_=0.02)
        middle = np.log(stats.norm.pdf(0) / (EXPECTED * WIDER))  # ln of the slope
        curve.Grid(alpha=(SHIFTS[0], SHIFTS[-1], SHIFTS.size),
                   beta=(middle - 2.5, middle + 2.5, SDS.size),
                   gamma=(0.0, 0.1, 3), lambda_=(0.0, 0.1, 3))  # fmt: skip
        curve.SetPrior(alpha=(0.0, EXPECTED * WIDER), beta=(middle, 1.099), gamma=(0.02, 0.03),
                       lambda_=(0.02, 0.03))  # fmt: skip
        self._psi = PsiMarginal(
            curve, np.log(LEVELS), parameterOfInterest="beta", maxIterations=None
        )

    def next(self) -> float:
        return float(np.exp(self._psi.PendingValue()))

    def learn(self, comparison: float, answer: int) -> None:
        self._psi.Observe(answer)


class HopePlacer(Placer):
    """psihope: the observer's own model (a curve of one's own), 1000 particles, its defaults."""

    def __init__(self, seed: int) -> None:
        from hope import HopeSampler
        from hope.psychometric_model import BinaryPsychometricModel

        def curve(x: Any, parameters: Any) -> Any:
            x, parameters = np.atleast_1d(x).reshape(-1), np.atleast_2d(parameters)
            ln_k, bias, low, high = parameters.T[:, :, None]
            d = (x - 1) / (np.exp(ln_k) * np.hypot(x, 1)) + bias
            return low + (1 - low - high) * ndtr(d)

        priors = {"ln_k": stats.norm(np.log(EXPECTED), 1.099), "bias": stats.norm(0, 1),
                  "low": stats.beta(0.7, 20), "high": stats.beta(0.7, 20)}  # fmt: skip
        # With a `seed` of the model all parameters of a draw from the prior are the same quantile
        # (findings/psihope_seeded_priors_are_one_quantile.sh).
        np.random.seed(seed)  # noqa: NPY002
        model = BinaryPsychometricModel(curve, priors)
        self._hope = HopeSampler(model, LEVELS[:, None], seed=seed)

    def next(self) -> float:
        return float(self._hope.get_next_stimulus()[0])

    def learn(self, comparison: float, answer: int) -> None:
        self._hope.update_posterior(np.array([comparison]), answer)


def placer_of(method: str, seed: int) -> Placer:
    """A placer by the name of its method."""
    if method == "weberwhisk, no easy trials":
        return OurPlacer(seed, easy_share=0.0)
    return {
        "weberwhisk": OurPlacer, "questplus": QuestPlusPlacer, "SweetSpot": SweetSpotPlacer,
        "psihope": HopePlacer, "constant": ConstantPlacer,
    }[method](seed)  # fmt: skip


def experiment(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """One observer with one method: its fits, and the CPU of placement."""
    return pd.DataFrame(fits_of(chunk)).assign(
        method=chunk["method"], weber_fraction=chunk["weber_fraction"], observer=chunk["observer"]
    )


def fits_of(chunk: dict[str, Any]) -> Iterator[dict[str, float]]:
    """Of each mark, the fit of the trials until then; observers are the same for all methods."""
    rng = np.random.default_rng([SEED, chunk["observer"]])
    bias = BIAS_SD * float(ndtri(rng.random()))
    uniform = rng.random(max(chunk["marks"]))
    started = time.process_time()
    placer = placer_of(chunk["method"], chunk["observer"])
    setup, spent, rows = time.process_time() - started, 0.0, []
    for number in range(1, max(chunk["marks"]) + 1):
        started = time.process_time()
        comparison = placer.next()
        spent += time.process_time() - started
        chance = response_probability(
            task_named("2AFC"), IdentityEncoding(), 1.0, comparison,
            weber_fraction=chunk["weber_fraction"], lapse_low=LAPSE, lapse_high=LAPSE, bias=bias,
        )  # fmt: skip
        answer = int(uniform[number - 1] < float(np.ravel(chance)[0]))
        rows.append((1.0, comparison, answer))
        started = time.process_time()
        placer.learn(comparison, answer)
        spent += time.process_time() - started
        if number in chunk["marks"]:
            table = pd.DataFrame(rows, columns=["standard", "comparison", "choice"])
            fit = ww.fit_weber(ww.read_trials(table))
            low, high = fit.interval()
            yield {"n": number, "k": fit.weber_fraction, "low": low, "high": high,
                   "ms_a_trial": 1e3 * spent / number, "s_to_begin": setup}  # fmt: skip


def installed() -> tuple[list[str], list[str]]:
    """The methods whose package is there, and those whose is not."""
    there, missing = [], []
    for method, module in METHODS.items():
        try:
            importlib.import_module(module)
            there.append(method)
        except ImportError:
            missing.append(method)
    return there, missing


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Of each method and k: trials to ±20 %, what the estimates at the end were off, and CPU."""
    rows = []
    half = (table["high"] - table["low"]) / (table["high"] + table["low"])
    table = table.assign(half=half, off=np.log(table["k"] / table["weber_fraction"]))
    for (method, k), own in table.groupby(["method", "weber_fraction"], sort=False):
        last = own[own["n"] == own["n"].max()]
        holds = (last["low"] < k) & (k < last["high"])
        rows.append({
            "method": method, "k": k, "observers": len(last),
            "trials_to_20_percent": crossing(own.groupby("n")["half"].median(), WIDTH),
            "half_width_at_300": float(own[own["n"] == 300]["half"].median()),
            "rms_ln_k_at_300": float(np.sqrt(np.mean(own[own["n"] == 300]["off"] ** 2))),
            "n_at_end": int(last["n"].iloc[0]),
            "half_width_at_end": float(last["half"].median()),
            "rms_ln_k_at_end": float(np.sqrt(np.mean(last["off"] ** 2))),
            "held": int(holds.sum()),
            "ms_a_trial": float(last["ms_a_trial"].median()),
            "s_to_begin": float(last["s_to_begin"].median()),
        })  # fmt: skip
    return pd.DataFrame(rows)


def make(folder: Path, *, short: bool = False, workers: int = 1) -> dict[str, pd.DataFrame]:
    """Both tables into `folder`; the runs stream into a file beside them and resume."""
    folder.mkdir(parents=True, exist_ok=True)
    methods, missing = installed()
    print(f"methods: {', '.join(methods)}; not installed: {', '.join(missing) or 'none'}")
    chunks = [
        {"method": method, "weber_fraction": k, "observer": observer,
         "marks": list(MARKS_SHORT if short else MARKS_OF_SLOW if method in SLOW else MARKS)}
        for k in WEBER_FRACTIONS
        for observer in range(1 if short else OBSERVERS)
        for method in methods
    ]  # fmt: skip
    of_fits = campaign.run(
        experiment, chunks, seed=SEED, workers=workers,
        out=folder / f"adaptive_peers.{'short' if short else 'full'}.jsonl", title="placement",
    )  # fmt: skip
    tables = {"adaptive_peers": of_fits, "adaptive_peers_trials": summary(of_fits)}
    packages = {m: version(m) for m in ("questplus", "SweetSpot", "psihope") if m in methods}
    with Run(folder, "adaptive_peers", {"short": short, "versions": packages}, SEED) as run:
        for name, table in tables.items():
            run.table(name, table)
    return tables


if __name__ == "__main__":
    # By its own name, which workers can import.
    import adaptive_peers

    given = options(__file__, __doc__, short="one observer, few trials", workers=True)
    made = adaptive_peers.make(given.folder, short=given.short, workers=given.workers or 1)
    print(made["adaptive_peers_trials"].to_string(index=False, float_format="{:.3g}".format))
