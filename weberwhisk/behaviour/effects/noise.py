"""Effects on the noise: what is left at nothing, the near miss, memory, scatter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..percepts import Percept, Signals, UnitPercepts
from ..trials import Trials
from .effect import NORMAL, Plain, needs_order
from .learning import sessions_of

Array = NDArray[np.float64]
_EXPONENT, _RHO = stats.norm(1.0, 0.15), stats.beta(1.0, 15.0)


@dataclass(frozen=True, eq=False)
class Floor(Plain):
    """Noise that is left where the signal vanishes: sd² = (kI)² + floor² (generalised Weber).

    `floor` is in the unit of the signal. Its prior is log-normal: median 3 % of the table's typical
    signal (geometric mean), a factor of 4 either way as one sd.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=1)
    >>> fit_weber(trials, effects=[Floor()]).parameters
    ('weber_fraction', 'floor', 'lapse_low', 'lapse_high', 'bias')
    """

    prior: Any = None
    name: str = "floor"

    def bound(self, percepts: UnitPercepts, n: Array) -> Floor:
        typical = _typical(percepts, "A floor")
        if self.prior is not None:
            return self
        return replace(self, prior=stats.lognorm(np.log(4.0), scale=0.03 * typical))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(sd_1=np.hypot(felt.sd_1, value), sd_2=np.hypot(felt.sd_2, value))


@dataclass(frozen=True, eq=False)
class NearMiss(Plain):
    """The near miss to Weber's law: sd = k I₀ (I/I₀)^exponent, I₀ the table's typical signal.

    The exponent is 1 under Weber's law and about 0.9 for the loudness of pure tones (McGill &
    Goldberg 1968); the Weber fraction is that at I₀, the geometric mean of the signals.
    """

    prior: Any = _EXPONENT
    name: str = "exponent"
    neutral: float = 1.0
    typical: float = 1.0

    def bound(self, percepts: UnitPercepts, n: Array) -> NearMiss:
        return replace(self, typical=_typical(percepts, "A near-miss exponent"))

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        one, two = ((np.abs(m) / self.typical) ** (value - 1) for m in (felt.mean_1, felt.mean_2))
        return felt._replace(sd_1=felt.sd_1 * one, sd_2=felt.sd_2 * two)


def _typical(percepts: UnitPercepts, what: str) -> float:
    """Geometric mean of the signals; refused where all are equally noisy."""
    sds = np.concatenate([percepts.sd_1, percepts.sd_2])
    means = np.abs(np.concatenate([percepts.mean_1, percepts.mean_2]))
    if not sds.size:
        return 1.0
    if np.ptp(sds) <= 1e-9 * sds.max() or np.any(means == 0):
        raise ValueError(
            f"{what} shows only where noise grows with the stimulus, got stimuli that are all "
            "equally noisy; leave it out, or give more standards."
        )
    return float(np.exp(np.mean(np.log(means))))


@dataclass(frozen=True, eq=False)
class FirstIntervalNoise(Plain):
    """The order of the intervals matters: the first signal's sd times exp(memory).

    It shows only as far as the noise of the two stimuli of a trial differs: thousands of trials
    with large differences tell it. The order effect that is easily seen is the `bias`.
    """

    prior: Any = NORMAL[0.4]
    name: str = "memory"

    def column(self, trials: Trials, percept: Percept) -> None:
        needs_order(trials, "FirstIntervalNoise")

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt._replace(sd_1=felt.sd_1 * np.exp(value))


@dataclass(frozen=True, eq=False)
class Overdispersion(Plain):
    """Answers that scatter more than a coin's: beta-binomial, with intraclass correlation ρ.

    The probability of each pair of stimuli in each session is itself drawn from a beta distribution
    of mean P and variance ρ P (1 − P) (Fründ, Haenel & Wichmann 2011; Schütt et al. 2016). It
    touches the likelihood, not the signals.
    """

    prior: Any = _RHO
    name: str = "overdispersion"

    def column(self, trials: Trials, percept: Percept) -> Array | None:
        return None if not trials.sessions else sessions_of(trials, "")[1].astype(float)

    def apply(self, felt: Signals, value: Array, column: Array | float) -> Signals:
        return felt
