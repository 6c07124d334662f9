"""Weber's law itself put to the test: one Weber fraction for all standards, or one for each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import logsumexp

from ..threads import one_blas_thread
from .criticism import check_fit
from .likelihood import WeberModel
from .posteriors import GridPosterior
from .quadrature import Grid, adapt, evaluate, integrate, lapse_prior

if TYPE_CHECKING:
    from .result import WeberFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WeberLawTest:
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

    def report(self) -> str:
        """The verdict in words."""
        strength = abs(self.log_bayes_factor)
        words = ("no evidence either way", "some evidence", "strong evidence", "decisive evidence")
        size = words[int(np.searchsorted([np.log(3), np.log(10), np.log(100)], strength))]
        side = "for Weber's law" if self.log_bayes_factor > 0 else "against Weber's law"
        tail = "" if size == words[0] else f" {side}"
        return (
            f"One Weber fraction for all standards against one for each: log Bayes factor "
            f"{self.log_bayes_factor:+.2f}, {size}{tail}. The alternative gives every standard the "
            "wide prior of the fit, which favours the law when data are few."
        )


@one_blas_thread
def weber_law_test(fit: WeberFit) -> WeberLawTest:
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
            "; fit without them, or compare fits with and without NearMiss() or Floor()."
        )
    if fit.trials.standards.size < 2:
        raise ValueError(
            "Weber's law needs two standards or more, got 1; collect another standard."
        )
    if "weber_fraction" not in model.names:
        raise ValueError("the Weber fraction is fixed; give it a prior to test Weber's law.")
    rows = []
    for standard, part in model.by_standard():
        own = GridPosterior(part.merged(), integrate(part.merged()), 0)
        low, median, high = own.quantile("weber_fraction", [0.025, 0.5, 0.975])
        rows.append(
            {
                "standard": standard,
                "n": int(part.cells.n.sum()),
                "weber_fraction": median,
                "lower": low,
                "upper": high,
            }
        )
    grid = integrate(model.merged())
    return WeberLawTest(grid.log_evidence - _separate_evidence(fit, grid), pd.DataFrame(rows))


def _separate_evidence(fit: WeberFit, grid: Grid) -> float:
    """Log evidence of one k per standard, with the lapses (and a shared bias) in common."""
    model = fit.model
    if fit.bias != "shared" or not model.free_bias:
        return _over_lapses(model, grid)
    # A shared bias ties the standards together: fix it, and integrate over it last.
    own = GridPosterior(model, grid, 0)
    middle, sd = own.mean("bias"), own.sd("bias")
    nodes = middle + sd * np.linspace(-8, 8, 25)
    table = [
        _over_lapses(replace(model, priors=replace(model.priors, bias=float(b))), grid)
        for b in nodes
    ]
    return float(
        logsumexp(np.array(table) + model.priors.bias.logpdf(nodes)) + np.log(nodes[1] - nodes[0])
    )


def _over_lapses(model: WeberModel, grid: Grid) -> float:
    """Given the lapses the standards are independent: each is integrated alone, at each lapse."""
    parts = [
        (part.merged(), _wide(integrate(part.merged()).axes[0])) for _, part in model.by_standard()
    ]
    low, high = (_wide(axis) for axis in grid.axes[1:])
    offsets = np.linspace(-8, 8, 17) if model.free_bias else np.zeros(1)
    reference = grid.reference
    for _ in range(8):
        prior = lapse_prior(model, low, high)
        total = prior.copy()
        for part, k_axis in parts:
            # The same lapses, in the coordinate that suits the part's number of trials.
            own = [
                theirs.coordinate(ours.score(t)) if t.size > 1 else t
                for theirs, ours, t in zip(
                    part.stretches[-2:], model.stretches[-2:], (low, high), strict=True
                )
            ]
            # Impossible lapses give -inf from -inf, and the axes may end in equal coordinates.
            with np.errstate(invalid="ignore", divide="ignore"):
                joint = evaluate(part, (k_axis, *own), offsets, reference, True).joint
                inner = logsumexp(joint, axis=0) + np.log(k_axis[1] - k_axis[0])
                inner -= lapse_prior(part, *own)
            total += np.where(np.isfinite(prior), inner, -np.inf)
        ends = [s.ends for s in model.stretches[-2:]]
        wider = adapt(total[None], 1, low, ends[0]), adapt(total[None], 2, high, ends[1])
        if wider[0] is low and wider[1] is high:
            break
        low, high = wider
    return float(logsumexp(total) + sum(np.log(a[1] - a[0]) for a in (low, high) if a.size > 1))


def _wide(axis: Array) -> Array:
    """The same axis, half as far again on either side."""
    if axis.size == 1:
        return axis
    step, more = axis[1] - axis[0], axis.size // 4
    return axis[0] + step * np.arange(-more, axis.size + more)
