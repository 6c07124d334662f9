"""The animals of a population, each fitted by itself: when first asked for, or on all cores."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from .._util import campaign
from .._util.values import Array
from .criticism import UNCHECKED
from .directions import LOOKED_FOR
from .encodings import Encoding
from .fit import WeberFit, fit_weber
from .importance import ImportancePosterior, Target
from .likelihood import WeberModel, build_model
from .posteriors import fraction_curve
from .trials import Trials
from .verdict import FitStatus

__all__ = ["DIRECTIONS", "LEFT_OUT", "AnimalFits", "fitted_alone"]

#: What an animal's own answers may be that inform of no Weber fraction.
LEFT_OUT = (FitStatus.NO_TRIALS, FitStatus.REVERSED, FitStatus.ONE_SIDED)
#: Names of effects that are looked for along directions of residuals.
DIRECTIONS = tuple(effect.name for effect in LOOKED_FOR)
CHUNKS = 24  # of animals, whatever does them, so that a bar moves
KEPT = 128  # fits that are kept once made
#: Independent draws behind the row of an animal, the fewest that count as converged, and draws of a
#: pass: lower ends are off by 0.02 sd r.m.s., as with 2000, which take half as long again; with
#: 1000 by 0.06.
DRAWS, PASS = 1200.0, 1400


@dataclass(frozen=True, eq=False, repr=False)
class AnimalFits(Mapping[Hashable, WeberFit]):
    """The fit of each animal with trials to its own data, made when it is first asked for.

    Examples
    --------
    >>> from weberwhisk.behaviour import simulate_population
    >>> trials, _ = simulate_population(3, trials_per_level=10, seed=1)
    >>> fits = AnimalFits.of(trials, {"bias": "none"})
    >>> len(fits), fits["s2"].parameters[0]
    (3, 'weber_fraction')
    """

    trials: Mapping[Hashable, Trials]
    options: Mapping[str, Any]
    seed: int = 1
    _made: dict[Hashable, WeberFit] = field(default_factory=dict, init=False)

    @classmethod
    def of(cls, trials: Trials, options: Mapping[str, Any], seed: int = 1) -> AnimalFits:
        """Of a table with a column of subjects, and options of `fit_weber`."""
        each = {subject: trials.select(subject=subject) for subject in trials.subjects}
        return cls({subject: one for subject, one in each.items() if one.n_trials}, options, seed)

    def __len__(self) -> int:
        return len(self.trials)

    def __iter__(self) -> Iterator[Hashable]:
        return iter(self.trials)

    def __repr__(self) -> str:
        return f"<AnimalFits of {len(self)} animals>"

    def __getitem__(self, subject: Hashable) -> WeberFit:
        if subject not in self._made:
            made = fit_weber(self.trials[subject], seed=self.seed, **self.options)
            if len(self._made) >= KEPT:
                return made
            self._made[subject] = made
        return self._made[subject]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_made": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    def quick(self, subject: Hashable) -> WeberFit:
        """The fit of an animal for its estimates, status and checks, by draws: a third of what
        quadrature takes, and ends of its interval to 0.03 sd."""
        model, encoding, bias = self._built(subject)
        target = Target(model.merged())
        posterior = _QuickPosterior(target, target.weighted(DRAWS, size=PASS))
        return WeberFit(
            self.trials[subject], model, encoding, self.options["noise"], bias, "importance",
            posterior,
        )  # fmt: skip

    def model(self, subject: Hashable, whole: bool = False) -> WeberModel:
        """The model of an animal, with all cells or as few as give its likelihood."""
        model = self._built(subject)[0]
        return model if whole else model.merged()

    def _built(self, subject: Hashable) -> tuple[WeberModel, Encoding, str]:
        o = self.options
        return build_model(
            self.trials[subject], o["encoding"], o["observer"], o["bias"], o["noise"], o["priors"],
            o["effects"],
        )  # fmt: skip


def fitted_alone(
    fits: AnimalFits,
    check: bool,
    *,
    workers: int,
    scheduler: str | None,
    progress: Callable[[float], None] | None,
) -> pd.DataFrame:
    """A row an animal: `alone`, `alone_lower`, `alone_upper`, its `n` trials, its `status`, and of
    each of `DIRECTIONS` how far its answers go along it, in sds, NaN where that was not checked."""
    count = len(fits)
    chunks = [
        {"animals": numbers.tolist()}
        for numbers in np.array_split(np.arange(count), min(count, CHUNKS))
    ]
    work = partial(_chunk, fits=fits, check=check)
    table = campaign.run(
        work, chunks, seed=1, workers=workers, scheduler=scheduler, title="Animals",
        progress=progress,
    )  # fmt: skip
    return table.set_axis(list(fits), axis=0)


def _chunk(
    chunk: dict[str, Any], seed: np.random.SeedSequence, *, fits: AnimalFits, check: bool
) -> pd.DataFrame:
    subjects = list(fits)
    return pd.DataFrame([_row(fits.quick(subjects[number]), check) for number in chunk["animals"]])


def _row(fit: WeberFit, check: bool) -> dict[str, Any]:
    low, middle, high = fit.posterior.quantile("weber_fraction", [0.025, 0.5, 0.975])
    row: dict[str, Any] = {
        "n": fit.trials.n_trials,
        "alone": float(middle),
        "alone_lower": float(low),
        "alone_upper": float(high),
        "status": fit.unchecked.name,
    }
    row |= dict.fromkeys(DIRECTIONS, np.nan)
    if check and fit.unchecked not in UNCHECKED:
        seen = fit.checked["observed"]
        row |= {name: float(seen[name]) for name in DIRECTIONS if name in seen}
        # Whatever it does to k: what is behind it, the animals say together.
        row["status"] = (fit.unweighed if fit.unweighed.is_misfit else fit.unchecked).name
    return row


class _QuickPosterior(ImportancePosterior):
    def score_curve(self) -> tuple[Array, Array]:
        return fraction_curve(self.model, self.reproducible_draws().thinned(60))
