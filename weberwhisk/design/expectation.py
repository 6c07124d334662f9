"""What a design should show of expected animals, before there are data: curves and intervals.

The predicted intervals are those of a fit to the *expected* answers, n·P of every level in place of
a count (an "Asimov" data set: Cowan, Cranmer, Gross & Vitells 2011, Eur. Phys. J. C 71:1554, §3.2).
One fit stands for the typical experiment; `weberwhisk rehearse` shows how far they scatter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binom

from ..behaviour.fit import fit_weber
from ..behaviour.psychometric import difference_sd, response_probability
from ..behaviour.result import WeberFit
from ..behaviour.trials import Cells, Trials
from ..jnd import criterion_factor
from .hypotheses import Hypothesis, SubjectPopulation
from .scheme import Scheme

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


ANIMALS = 64  # drawn to stand for all
SEED = 20
STEP = 1e-3  # of central differences
LEAST_LAPSE = 3e-3  # an animal that never lapses does not tell so


class Precision:
    """Expected intervals of k from any choice of positions.

    Parameters
    ----------
    hypothesis : Hypothesis
        True, and fitted.
    standards, comparisons : array_like, shape (C,)
        All positions there are to choose from, m.
    animals : SubjectPopulation
        So many are drawn from them, the same for every choice.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> told = Precision(weber, [1.0, 1.0, 1.0], [0.8, 1.0, 1.2], SubjectPopulation())
    >>> middle, sides = (np.median(told.half_widths(at, 50)) for at in ([1], [0, 2]))
    >>> bool(sides < middle)
    True
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        standards: ArrayLike,
        comparisons: ArrayLike,
        animals: SubjectPopulation,
    ) -> None:
        s1, s2 = (np.asarray(a, dtype=float) for a in (standards, comparisons))
        model = hypothesis.model(Cells(s1, s2, s1, np.ones(s1.size), np.zeros(s1.size)))
        drawn = animals.draw(ANIMALS, SEED)
        middle = model.fixed_bias()
        if model.free_bias and model.task.bias_name == "criterion":
            middle = float(hypothesis.priors.value("bias", 0.0))
        lapses = (
            np.maximum(drawn[name].to_numpy(), LEAST_LAPSE) for name in ("lapse_low", "lapse_high")
        )
        # ln k, either lapse and the bias of every animal, (4, A)
        at = np.stack([np.log(drawn["weber_fraction"]), *lapses, middle + drawn["bias"]])

        def chance(there: Array) -> Array:
            k, low, high, bias = there
            biases = np.repeat(bias[:, None], model.n_groups, axis=1)
            return model.probability(np.exp(k), low, high, biases)[0]

        p = chance(at)
        slopes = [
            (chance(at + d) - chance(at - d)) / (2 * STEP) for d in STEP * np.eye(4)[..., None]
        ]
        self._free = [*model.free[:1], *model.free[-2:], model.free_bias]
        slope = np.stack(slopes, axis=-1) * self._free  # (A, C, 4)
        self._information = slope[..., :, None] * (slope / (p * (1 - p))[..., None])[..., None, :]
        self._group = model.group
        low, high = np.log(model.value("weber_fraction", np.array([-0.5, 0.5])))
        sds = [
            high - low if name == "weber_fraction" else model.priors.moments(name)[1]
            for name in ("weber_fraction", "lapse_low", "lapse_high", "bias")
        ]
        # What is known has no slope, and any precision will do.
        pairs = zip(sds, self._free, strict=True)
        self._prior = np.diag([sd**-2.0 if free else 1.0 for sd, free in pairs])

    def half_widths(self, chosen: ArrayLike, each: float) -> Array:
        """1.96 sds of ln k of every animal, (A,), from so many trials of each chosen position."""
        at = np.asarray(chosen)
        total = np.broadcast_to(self._prior[:3, :3], (ANIMALS, 3, 3)).copy()
        for group in np.unique(self._group[at]):
            own = each * self._information[:, at[self._group[at] == group]].sum(axis=1)
            # The bias integrated out: the Schur complement of its information.
            mixed, bias = own[:, :3, 3], own[:, 3, 3] + self._prior[3, 3]
            total += own[:, :3, :3] - mixed[:, :, None] * mixed[:, None, :] / bias[:, None, None]
        if not self._free[0]:
            return np.zeros(ANIMALS)
        return np.asarray(1.96 * np.sqrt(np.linalg.inv(total)[:, 0, 0]))
