"""Weber's law tested: one Weber fraction for all standards, against one for each."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from scipy.special import logsumexp

from .._util.campaign import one_blas_thread
from .._util.values import Array, Line
from .axes import lapse_prior, score_prior
from .estimates import Estimates, check_fit
from .integrate import PosteriorGrid, integrate
from .integrate.batch import over_fractions
from .posteriors import QuadraturePosterior
from .verdict import strength

__all__ = ["WeberLawTest", "weber_law_test"]


@dataclass(frozen=True, repr=False)
class WeberLawTest(Line):
    """The comparison of two observers with the same lapses and biases.

    `log_bayes_factor` is the natural log of the evidence for one shared Weber fraction over that
    for one per standard, each with the prior of the fit. `by_standard` has the Weber fraction
    fitted at each standard alone.

    Examples
    --------
    >>> from weberwhisk import fit_weber, simulate_trials
    >>> trials = simulate_trials(standards=[1.0, 4.0], weber_fraction=0.15, seed=1)
    >>> test = weber_law_test(fit_weber(trials))
    >>> test.by_standard["standard"].tolist()
    [1.0, 4.0]
    >>> "against one for each" in test.report()
    True
    """

    log_bayes_factor: float
    by_standard: pd.DataFrame = field(repr=False)

    def _table(self) -> pd.DataFrame:
        return self.by_standard

    def _line(self) -> str:
        size = strength(abs(self.log_bayes_factor))
        side = " for Weber's law" if self.log_bayes_factor > 0 else " against Weber's law"
        side = "" if size.startswith("no") else side
        return f"log Bayes factor {self.log_bayes_factor:+.2f}, {size}{side}"

    def report(self) -> str:
        """The verdict in words."""
        return (
            f"One Weber fraction for all standards against one for each: {self._line()}. "
            "The alternative gives every standard the wide prior of the fit, which favours "
            "the law when data are few."
        )


@one_blas_thread
def weber_law_test(fit: Estimates) -> WeberLawTest:
    """Shared k against k per standard by exact evidence.

    Raises
    ------
    ValueError
        With fewer than two standards, a fixed Weber fraction, or effects.
    """
    check_fit(fit)
    model = fit.model
    if model.effects:
        raise ValueError(
            f"Weber's law is tested without effects, got {', '.join(e.name for e in model.effects)}"
            "; fit without them, or compare fits with and without Floor()."
        )
    if model.n_states > 1:
        raise ValueError(
            f"Weber's law is tested of one state, got states={model.n_states}; fit the trials of "
            "each standard, trials.select(standard=...), with states."
        )
    if fit.standards.size < 2:
        raise ValueError(
            "Weber's law needs two standards or more, got 1; collect another standard."
        )
    if "weber_fraction" not in model.names:
        raise ValueError("the Weber fraction is fixed; give it a prior to test Weber's law.")
    rows = []
    for standard, part in model.by_standard():
        own = QuadraturePosterior(part.merged(), integrate(part.merged()), 0)
        k = own.quantile("weber_fraction", [0.5, 0.025, 0.975])
        rows.append((standard, int(part.cells.n.sum()), *k))
    table = pd.DataFrame(rows, columns=["standard", "n", "weber_fraction", "lower", "upper"])
    grid = integrate(model.merged())
    return WeberLawTest(grid.log_evidence - _separate_evidence(fit, grid), table)


def _separate_evidence(fit: Estimates, grid: PosteriorGrid) -> float:
    """Log evidence of one k per standard, with the lapses (and a shared bias) in common: given
    these the standards are independent, and each is integrated alone."""
    model, bias = fit.model, None
    axes = [_wider(axis) for axis in grid.axes[1:]]
    if fit.bias == "shared" and model.free_bias:
        scores, mass = (
            np.concatenate([a.ravel() for a in part]) for part in zip(*grid.biases[0], strict=True)
        )
        middle = float(scores @ mass)
        sd = float(np.sqrt(mass @ (scores - middle) ** 2))
        bias = middle + sd * np.linspace(-8.0, 8.0, 25)
    transforms = model.transforms[-2:]
    for _ in range(8):
        prior = lapse_prior(model, *axes)
        total = prior[None] if bias is None else prior + score_prior(bias)[:, None, None]
        for _, part in model.by_standard():
            part = part.merged()
            # The same lapses, in the coordinate that suits the part's number of trials.
            low, high = (
                theirs.coordinate(ours.score(t)) if t.size > 1 else t
                for theirs, ours, t in zip(part.transforms[-2:], transforms, axes, strict=True)
            )
            total = total + over_fractions(part, (low, high), bias)
        density = np.exp(total - total.max()).sum(axis=0)
        open_ends = [
            _is_open(density.sum(axis=1 - i), axis, transform.ends[1])
            for i, (axis, transform) in enumerate(zip(axes, transforms, strict=True))
        ]
        if not any(open_ends):
            break
        axes = [_wider(a) if is_open else a for a, is_open in zip(axes, open_ends, strict=True)]
    step = [a[1] - a[0] for a in (*axes, np.zeros(1) if bias is None else bias) if a.size > 1]
    return float(logsumexp(total) + np.log(step).sum())


def _is_open(density: Array, axis: Array, end: float, edge: float = 5e-4) -> bool:
    """Whether the density hangs over the last node, and there is more beyond."""
    return axis.size > 1 and axis[-1] < end and bool(density[-1] > edge * density.max())


def _wider(axis: Array) -> Array:
    """The same axis, carried on by a quarter of its nodes."""
    if axis.size == 1:
        return axis
    return axis[0] + (axis[1] - axis[0]) * np.arange(axis.size + max(axis.size // 4, 2))
