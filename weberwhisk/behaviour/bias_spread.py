"""How the biases of many animals spread, beside what was believed of them.

Biases are not pooled: each has the prior of a single fit. They count in sds of the difference
between percepts, which grow with k, so PSEs that lie closer together than the prior expects speak
for a small k: a little in one animal, and with every animal more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from .result import WeberFit

Array = NDArray[np.float64]

TYPICAL = 0.4, 0.8  # median of the spread, and its sd in ln: few biases do not tell it
PLAIN = 3.0  # nats by which another spread explains the biases better, before it is told


def spread_note(fits: Sequence[WeberFit]) -> str | None:
    """What to say where the biases are not spread as their prior has it; None where they are.

    Examples
    --------
    >>> from weberwhisk.behaviour import fit_weber, simulate_trials
    >>> spread_note([fit_weber(simulate_trials(seed=1))]) is None
    True
    """
    found = [(fit, fit.posterior.draws().bias) for fit in fits if fit.model.free_bias]
    if not found:
        return None
    prior_mean, prior_sd = found[0][0].model.priors.moments("bias")
    mean = np.concatenate([bias.mean(axis=0) for _, bias in found]) - prior_mean
    # A posterior no narrower than the prior says nothing.
    variance = np.concatenate([bias.var(axis=0) for _, bias in found])
    precision = np.maximum(1 / variance - prior_sd**-2, 1e-6 * prior_sd**-2)
    own, noise = mean / variance / precision, 1 / precision

    def log_likelihood(log_sd: float) -> float:
        """Of normal biases with that sd, each seen with noise of its own."""
        total = np.exp(2 * log_sd) + noise
        return float(-0.5 * np.sum(own**2 / total + np.log(total)))

    def loss(log_sd: float) -> float:
        return 0.5 * ((log_sd - np.log(TYPICAL[0])) / TYPICAL[1]) ** 2 - log_likelihood(log_sd)

    best = minimize_scalar(loss, bounds=np.log(prior_sd) + np.log([0.02, 20.0]), method="bounded").x
    if log_likelihood(best) < log_likelihood(np.log(prior_sd)) + PLAIN:
        return None
    sd = float(np.exp(best))
    pulls = "down" if sd < prior_sd else "up"
    return (
        f"The biases spread with an sd of {sd:.2g}, and their prior with {prior_sd:.2g}: many "
        f"animals together pull k {pulls}. Give a prior as wide as they are, "
        f"priors={{'bias': scipy.stats.norm({prior_mean:.2g}, {sd:.2g})}}."
    )
