"""What an experiment is to reach, and the animals that it is planned for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from .. import _checks
from ..behaviour.population import draw_animals


@dataclass(frozen=True)
class SubjectPopulation:
    """What the animals are expected to be like.

    Parameters
    ----------
    weber_fraction : float
        Median k of the animals.
    spread : float
        Standard deviation of ln k between animals.
    lapse : float
        Share of trials lost on either side; its mean, where `lapses_vary`.
    bias_spread : float
        Standard deviation of the animals' biases, in sds of the difference between the two signals.
    lapses_vary : bool
        Whether each animal has lapses of its own, from Beta(2, 2/lapse − 2), or all have the same.
    """

    weber_fraction: float = 0.1
    spread: float = 0.3
    lapse: float = 0.03
    bias_spread: float = 0.2
    lapses_vary: bool = True

    def __post_init__(self) -> None:
        _checks.positive("weber_fraction", self.weber_fraction, "write for example 0.1")
        for name in ("weber_fraction", "spread", "lapse", "bias_spread"):
            _checks.number(name, getattr(self, name), "write for example 0.03")
            _checks.non_negative(name, getattr(self, name), "write for example 0.03")
        if self.lapse >= 0.5:
            raise ValueError(f"lapse must be below 0.5, got {self.lapse:g}; write 0.03, say.")

    def draw(self, number: int, seed: np.random.SeedSequence | int) -> pd.DataFrame:
        """So many of them, a row each: the truth that `simulate_responses` takes."""
        drawn = draw_animals(
            number, weber_fraction=self.weber_fraction, spread=self.spread, lapse_low=self.lapse,
            lapse_high=self.lapse, bias_spread=self.bias_spread, seed=seed,
        )  # fmt: skip
        if not self.lapses_vary:
            drawn[["lapse_low", "lapse_high"]] = self.lapse
        return drawn


@dataclass(frozen=True)
class Goal:
    """What the experiment is to reach, and in what share of repetitions.

    Parameters
    ----------
    bayes_factor : float, optional
        For the true hypothesis against every other.
    half_width : float, optional
        Of the 95 % interval of the Weber fraction, over its estimate: 0.2 for ±20 %.
    share : float

    Raises
    ------
    ValueError
        Unless there is exactly one of both.

    Examples
    --------
    >>> print(Goal(bayes_factor=10))
    a Bayes factor above 10 for the true hypothesis in 80 % of experiments
    """

    bayes_factor: float | None = None
    half_width: float | None = None
    share: float = 0.8

    def __post_init__(self) -> None:
        if (self.bayes_factor is None) == (self.half_width is None):
            raise ValueError(
                "A goal is a Bayes factor or the width of an interval, got "
                f"{'both' if self.bayes_factor else 'neither'}; write Goal(bayes_factor=10), say."
            )
        for name in ("bayes_factor", "half_width", "share"):
            if getattr(self, name) is not None or name == "share":
                _checks.number(name, getattr(self, name), "write one such as 0.2")
        if self.bayes_factor is not None and not self.bayes_factor > 1:
            raise ValueError(
                f"bayes_factor must be above 1, got {self.bayes_factor:g}; write 10, say."
            )
        if self.half_width is not None and not 0 < self.half_width < 1:
            raise ValueError(
                f"half_width must lie between 0 and 1, got {self.half_width:g}; write 0.2."
            )
        if not 0 < self.share < 1:
            raise ValueError(f"share must lie between 0 and 1, got {self.share:g}; write 0.8, say.")

    def __str__(self) -> str:
        often = f"in {100 * self.share:.3g} % of experiments"
        if self.bayes_factor is not None:
            return f"a Bayes factor above {self.bayes_factor:g} for the true hypothesis {often}"
        return f"a 95 % interval of k narrower than ±{100 * (self.half_width or 0):.3g} % {often}"
