"""What a design should show of an expected animal, before there are data: curves and intervals.

The predicted intervals are those of a fit to the *expected* answers, n·P of every level in place of
a count (an "Asimov" data set: Cowan, Cranmer, Gross & Vitells 2011, Eur. Phys. J. C 71:1554, §3.2).
One fit stands for the typical experiment; `weberwhisk rehearse` shows how far they scatter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import binom

from ..behaviour.fit import fit_weber
from ..behaviour.psychometric import response_probability
from ..behaviour.result import WeberFit
from ..behaviour.trials import Trials
from ..jnd import criterion_factor
from .hypotheses import Hypothesis
from .scheme import Scheme, difference_sd

Array = NDArray[np.float64]

CURVE = 81  # points of a curve


def expected_trials(
    scheme: Scheme, truth: Hypothesis, weber_fraction: float, lapse: float
) -> Trials:
    """The answers that one animal gives on average, n·P of every level.

    Parameters
    ----------
    scheme : Scheme
    truth : Hypothesis
        What the animal is: its encoding, noise and task.
    weber_fraction, lapse : float
        Of the animal; lapses on either side.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> trials = expected_trials(Scheme([1.0], [-0.2, 0.2], 50), weber, 0.1, 0.02)
    >>> trials.frame["count"].round(1).tolist()
    [3.8, 44.2]
    """
    cells = scheme.cells()
    share = response_probability(
        truth.asked, truth.encoding, cells.stimulus_1, cells.stimulus_2, noise=truth.noise,
        weber_fraction=weber_fraction, lapse_low=lapse, lapse_high=lapse,
    )  # fmt: skip
    frame = pd.DataFrame(
        {
            "standard": cells.standard,
            "stimulus_1": cells.stimulus_1,
            "stimulus_2": cells.stimulus_2,
            "n": cells.n.astype(np.int64),
            "count": cells.n * share,
        }
    )
    return Trials(frame, truth.asked, source="expected answers")


def fitted(trials: Trials, hypothesis: Hypothesis) -> WeberFit:
    """A hypothesis fitted to a table, as the plan's analysis fits it to each animal."""
    return fit_weber(
        trials, encoding=hypothesis.encoding, priors=hypothesis.priors, bias=hypothesis.bias,
        noise=hypothesis.noise, method="quadrature",
    )  # fmt: skip


def expected_levels(trials: Trials) -> pd.DataFrame:
    """Shares of answers at every level, with the interval that 95 % of animals alike fall in.

    Columns `standard`, `comparison`, `n`, `expected`, `lower`, `upper`: binomial quantiles.
    """
    frame = trials.frame
    n, share = frame["n"].to_numpy(), (frame["count"] / frame["n"]).to_numpy()
    low, high = (binom.ppf(q, n, share) / n for q in (0.025, 0.975))
    return pd.DataFrame(
        {
            "standard": frame["standard"],
            "comparison": frame["stimulus_2"],
            "n": n,
            "expected": share,
            "lower": low,
            "upper": high,
        }
    )


def expected_curves(fits: Sequence[tuple[str, WeberFit]]) -> pd.DataFrame:
    """Psychometric functions of every hypothesis as fitted to the expected answers.

    Columns `hypothesis`, `standard`, `comparison`, `median`, `lower`, `upper`.
    """
    parts = []
    for name, fit in fits:
        for standard in fit.trials.standards:
            own = fit.trials.frame.query("standard == @standard")["stimulus_2"]
            low, high = own.min(), own.max()
            margin = 0.1 * (high - low) or 0.05 * standard
            edge = fit.encoding.domain
            at = np.linspace(
                max(low - margin, edge[0] + 0.02 * (low - edge[0])),
                min(high + margin, edge[1] - 0.02 * (edge[1] - high)),
                CURVE,
            )
            curve = fit.psychometric(at, float(standard))
            curve.insert(0, "standard", float(standard))
            curve.insert(0, "hypothesis", name)
            parts.append(curve)
    return pd.concat(parts, ignore_index=True)


def expected_jnds(
    fits: Sequence[tuple[str, WeberFit]],
    nearest: float,
    farthest: float,
    *,
    criterion: str = "75% 2AFC",
) -> pd.DataFrame:
    """The JND against the stimulus under every hypothesis, with the predicted 95 % interval.

    Small offsets: a JND is k σ(s)/|μ′(s)| times the factor of the criterion, k r (1 − r/A) for a
    tapered whisker's compliance and k r for a cylinder's, (3.5) and (3.6).

    Columns `hypothesis`, `stimulus`, `jnd`, `lower`, `upper`, `criterion`.
    """
    parts = []
    for name, fit in fits:
        at = np.linspace(nearest, farthest, CURVE)
        unit = jnd_of_one(fit, at, criterion)
        low, high = fit.interval(0.95)
        parts.append(
            pd.DataFrame(
                {
                    "hypothesis": name,
                    "stimulus": at,
                    "jnd": fit.weber_fraction * unit,
                    "lower": low * unit,
                    "upper": high * unit,
                    "criterion": criterion,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def expected_jnds_by_standard(
    trials: Trials, hypothesis: Hypothesis, *, criterion: str = "75% 2AFC"
) -> pd.DataFrame:
    """The JND at each standard as its own trials will tell it, with the predicted 95 % interval.

    What the points of the measured JND curve will look like: every standard fitted by itself.

    Columns `standard`, `jnd`, `lower`, `upper`, `criterion`, `status`.
    """
    rows = []
    for standard in trials.standards:
        fit = fitted(trials.select(standard=float(standard)), hypothesis)
        unit = float(jnd_of_one(fit, np.array([standard]), criterion)[0])
        low, high = fit.interval(0.95)
        rows.append(
            {
                "standard": float(standard),
                "jnd": fit.weber_fraction * unit,
                "lower": low * unit,
                "upper": high * unit,
                "criterion": criterion,
                "status": fit.status.name,
            }
        )
    return pd.DataFrame(rows)


def jnd_of_one(fit: WeberFit, stimulus: Array, criterion: str) -> Array:
    """The JND for a Weber fraction of 1, in the stimulus's unit."""
    return criterion_factor(criterion) * difference_sd(fit.encoding, stimulus) / np.sqrt(2.0)
