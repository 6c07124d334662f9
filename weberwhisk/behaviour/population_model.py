"""What a population of animals is fitted by: options that all animals share, and beliefs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from .._util import campaign
from .._util.values import interval_text, weighted_quantiles
from .alone import AnimalFits
from .causes import MOST, MOVED, STRONG, WIDER, Cause, possible_causes
from .effects import Effect
from .hierarchy import Animal, Hierarchy
from .likelihood import encoding_of, pairs_shown
from .population import Population, integrate_population
from .priors import Priors, priors_for
from .trials import Trials
from .verdict import FitStatus

__all__ = ["CauseSearch", "PopulationModel", "search_causes"]


#: Causes with which there is no one k for all stimuli, wherever its median lies.
AGAINST_LAW = ("exponent", "floor")


@dataclass(frozen=True)
class PopulationModel:
    """The options of `fit_population` for a table; `spreads` are priors of spreads by name."""

    trials: Trials
    encoding: Any
    observer: Any
    bias: str | None
    noise: str
    effects: tuple[Effect, ...]
    priors: Any
    spreads: Mapping[str, Any]
    seed: int

    @property
    def believed(self) -> Priors:
        """Priors of every parameter; what an effect believes goes by the stimuli of all animals."""
        encoded = encoding_of(self.trials, self.encoding, self.observer, self.noise)
        cells, by_subject = self.trials.cells(), self.trials.subjects
        bound = [
            effect.bound(pairs_shown(cells, encoded, self.noise), cells.n)
            for effect in self.effects
        ]
        by_name = {effect.name: effect.prior for effect in bound}
        each = (self.trials.select(subject=subject) for subject in by_subject)
        shown = (pairs_shown(one.cells(), encoded, self.noise) for one in each if one.n_trials)
        return priors_for(
            self.priors, cells, self.trials.unit_known, self.trials.task, by_name, shown
        )

    def fits(self) -> AnimalFits:
        """Each animal by itself."""
        options = {
            "encoding": self.encoding, "observer": self.observer, "bias": self.bias,
            "noise": self.noise, "effects": self.effects, "priors": self.believed,
        }  # fmt: skip
        return AnimalFits.of(self.trials, options, self.seed)

    def integrated(
        self, fits: AnimalFits, subjects: Sequence[Hashable], quick: bool = False
    ) -> Population:
        """The posterior of a population of these animals."""
        models = [fits.model(subject) for subject in subjects]
        hierarchy = Hierarchy.of(models, fits.options["priors"], self.spreads)
        return integrate_population([Animal.of(m, hierarchy) for m in models], hierarchy, quick)

    def with_effects(self, effects: Sequence[Effect], bias: str | None = None) -> PopulationModel:
        """The same with further effects, and another bias if one is named."""
        return replace(self, effects=(*self.effects, *effects), bias=bias or self.bias)

    def with_causes(self, causes: Sequence[Cause]) -> PopulationModel:
        """The same with causes in it."""
        effects = [effect for cause in causes for effect in cause.effects]
        return self.with_effects(effects, next((c.bias for c in causes if c.bias), None))


@dataclass(frozen=True)
class CauseSearch:
    """What was tried: a row each in `table`, the best first, with index `cause` and columns
    `log_evidence`, `log_bayes_factor` over the fit, `weber_fraction` with `lower` and `upper`, the
    population's, and `change`, how far the median of ln k moves in posterior sds of the fit;
    `chosen` are the causes with strong evidence."""

    table: pd.DataFrame
    chosen: tuple[Cause, ...]
    matters: bool
    sentence: str


def search_causes(
    model: PopulationModel,
    fits: AnimalFits,
    subjects: Sequence[Hashable],
    plain: Population,
    statuses: Sequence[FitStatus],
    *,
    workers: int,
    scheduler: str | None,
    progress: Callable[[float], None] | None,
) -> CauseSearch:
    """Try what may be behind misfits of these statuses, forwards: the best cause, then another
    beside it, as long as the evidence for it is strong, up to three."""
    shown = [possible_causes(fits[subject]) for subject in subjects[:3]]
    named = {cause.name: cause for causes in shown for cause in causes}
    left = [c for c in named.values() if c.states == 1 and c.status in statuses]
    base = _summary(plain)
    rows: dict[str, dict[str, Any]] = {}
    chosen: tuple[Cause, ...] = ()
    best = base
    while left and len(chosen) < MOST:
        work = partial(_tried, model=model, subjects=list(subjects), named=named)
        chunks = [{"causes": [c.name for c in (*chosen, new)]} for new in left]
        table = campaign.run(
            work, chunks, seed=1, workers=workers, scheduler=scheduler, title="Causes",
            progress=progress,
        )  # fmt: skip
        for chunk, row in zip(chunks, table.to_dict("records"), strict=True):
            rows[" + ".join(chunk["causes"])] = {str(k): v for k, v in row.items()}
        gains = table["log_evidence"].to_numpy() - best["log_evidence"]
        at = int(np.argmax(gains))
        if gains[at] < STRONG:
            break
        chosen = (*chosen, left[at])
        best = rows[" + ".join(cause.name for cause in chosen)]
        left = [cause for cause, gain in zip(left, gains, strict=True)
                if gain > 0 and cause is not left[at]]  # fmt: skip
    if chosen:  # as good as any fit
        name = " + ".join(cause.name for cause in chosen)
        with_them = model.with_causes(chosen)
        rows[name] = best = _summary(with_them.integrated(with_them.fits(), subjects))
    out = pd.DataFrame.from_dict(rows, "index", columns=[*base]).rename_axis("cause")
    out["log_bayes_factor"] = out["log_evidence"] - base["log_evidence"]
    out["change"] = np.log(out["weber_fraction"] / base["weber_fraction"]) / base["sd"]
    kept = [name for name in out.index
            if "+" not in name or name == " + ".join(c.name for c in chosen)]  # fmt: skip
    order = ["log_evidence", "log_bayes_factor", "weber_fraction", "lower", "upper", "change"]
    out = out.loc[kept, order].sort_values("log_evidence", ascending=False)
    change = float(np.log(best["weber_fraction"] / base["weber_fraction"]) / base["sd"])
    matters = abs(change) > MOVED or best["sd"] > WIDER * base["sd"]
    matters = matters or any(cause.name in AGAINST_LAW for cause in chosen)
    return CauseSearch(out, chosen, matters, _sentence(chosen, base, best, change))


def _summary(population: Population) -> dict[str, float]:
    """Evidence, and median, interval and sd of ln k of the population."""
    values, weights = population.values["weber_fraction"], population.draws.weights
    middle, low, high = weighted_quantiles(values, weights, [0.5, 0.025, 0.975])
    log_k = np.log(values)
    sd = np.sqrt(weights @ (log_k - weights @ log_k) ** 2)
    named = {"weber_fraction": middle, "lower": low, "upper": high, "sd": sd}
    return {"log_evidence": population.log_evidence} | {k: float(v) for k, v in named.items()}


def _tried(
    chunk: dict[str, Any], seed: np.random.SeedSequence, *,
    model: PopulationModel, subjects: Sequence[Hashable], named: Mapping[str, Cause],
) -> pd.DataFrame:  # fmt: skip
    with_them = model.with_causes([named[name] for name in chunk["causes"]])
    return pd.DataFrame([_summary(with_them.integrated(with_them.fits(), subjects, quick=True))])


def _sentence(
    chosen: Sequence[Cause], base: Mapping[str, float], best: Mapping[str, float], change: float
) -> str:
    if not chosen:
        return "None of the causes that were tried has strong evidence."
    shown = " and ".join(cause.words for cause in chosen)
    ends = best["weber_fraction"], best["lower"], best["upper"]
    k = interval_text(*ends).replace("95 %: ", "")
    factor = f"log Bayes factor {best['log_evidence'] - base['log_evidence']:.3g}"
    if abs(change) > MOVED:
        effect = f": with it the median k is {k} in place of {base['weber_fraction']:.3g}"
    elif best["sd"] > WIDER * base["sd"]:
        effect = (
            f": with it the median k is {k} in place of {base['weber_fraction']:.3g}, and its sd "
            f"{best['sd'] / base['sd']:.2g} times as large"
        )
    else:
        effect = (
            f", which moves the median k by less than its sd, from {base['weber_fraction']:.3g} "
            f"to {k}"
        )
    return f"The answers of the animals together show {shown}{effect} ({factor})."
