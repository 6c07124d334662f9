"""What one more trial is expected to tell, as a function of its standard and offset, in bits.

The mutual information of an answer and what is asked: the Weber fraction, the JND at a distance, or
which hypothesis is right (Lindley 1956, Ann. Math. Stat. 27:986), everything else integrated out:
a lapse or a bias that must be learnt as well costs information, and is not counted as any.
`Precision` is the quick look at a whole scheme: intervals of k by Fisher's information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from .. import _checks
from ..behaviour.encodings import gives_signal, refuse_out_of_reach
from ..behaviour.integrate.batch import batch_steps, zoomed
from ..behaviour.psychometric import difference_sd
from ..behaviour.trials import Cells
from ..threads import one_blas_thread
from .belief import Belief, BeliefGrid, entropy, even_axes, wide_ends
from .hypotheses import Hypothesis, SubjectPopulation, check_distinct, check_metres
from .scheme import Scheme, millimetres

Array = NDArray[np.float64]


@one_blas_thread
def information(
    hypotheses: Sequence[Hypothesis],
    standards: ArrayLike,
    offsets: ArrayLike,
    *,
    after: Scheme | None = None,
    expected: SubjectPopulation | None = None,
    jnd_at: float | None = None,
) -> pd.DataFrame:
    """Expected information of one trial at every standard and offset.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        With any cue, whisker, noise and priors; equally probable.
    standards : array_like, shape (S,)
        m.
    offsets : array_like, shape (J,) or (S, J)
        Comparison − standard, m; one row for all, or one each. Comparisons that cannot be encoded
        have no information: NaN.
    after : Scheme, optional
        What has been run before: the parameters are then known as well as they are expected to be
        after it, averaged over each hypothesis being the truth. By default nothing has, and beliefs
        are the priors.
    expected : SubjectPopulation, optional
        The animal whose answers are expected before; its Weber fraction and lapses.
    jnd_at : float, optional
        Distance of the JND asked for, m; by default the middle standard.

    Returns
    -------
    DataFrame
        One row a standard and offset: `standard_mm`, `offset_mm`, `weber_fraction_bits`,
        `jnd_bits`, `hypothesis_bits`.

    Notes
    -----
    Good to about 1 %. An answer has one bit at most; 1 bit is ln 2 nats. These are the gains of the
    very next trial: they shrink as the experiment goes on, and what is best to know first need not
    be best to know in the end. A whole scheme is judged by `best_scheme` and `power`.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> table = information([weber], [1.0], [0.0, 0.1, 0.2, 0.4])
    >>> int(table["weber_fraction_bits"].argmax())
    2
    """
    given = check_distinct(hypotheses)
    check_metres(given)
    at = np.atleast_1d(_checks.finite("standards", standards, "give distances in m")).ravel()
    rows = np.atleast_2d(_checks.finite("offsets", offsets, "give m, such as [-2e-3, 2e-3]"))
    if len(rows) not in (1, at.size):
        raise ValueError(
            f"offsets has {len(rows)} rows for {at.size} standards; give one for all, or one each."
        )
    rows = np.broadcast_to(rows, (at.size, rows.shape[1]))
    for h in given:
        refuse_out_of_reach(h.encoding, at, "standard")
    place = float(np.sort(at)[at.size // 2]) if jnd_at is None else float(jnd_at)
    likely = expected or SubjectPopulation()
    s1, s2 = np.repeat(at, rows.shape[1]), (at[:, None] + rows).ravel()
    encoded = np.ones(s2.size, dtype=bool)
    for h in given:
        low, high = h.encoding.domain
        encoded &= (s2 > low) & (s2 < high)
        encoded &= gives_signal(h.encoding, np.where(encoded, s2, s1))
    bits = np.full((3, s1.size), np.nan)
    if encoded.any():
        parts = []
        for truth in given if after is not None else given[:1]:
            before = None
            if after is not None:  # the answers that an animal is expected to give
                count = truth.expected_counts(after, likely.weber_fraction, likely.lapse)
                before = replace(after.cells(), count=count)
            beliefs = [believed(h, s1[encoded], s2[encoded], before) for h in given]
            parts.append(_of_answers(beliefs, int(encoded.sum()), place))
        bits[:, encoded] = np.mean(parts, axis=0) / np.log(2)
    named = zip(("weber_fraction_bits", "jnd_bits", "hypothesis_bits"), bits, strict=True)
    mm = {"standard_mm": millimetres(s1), "offset_mm": millimetres(rows.ravel())}
    return pd.DataFrame({**mm, **dict(named)})


def believed(
    hypothesis: Hypothesis,
    standards: Array,
    comparisons: Array,
    before: Cells | None,
    nodes: tuple[int, int, int] = (41, 21, 25),
    reach: float = 4.0,
) -> Belief:
    """What is known of an observer after a table, with pairs that may be shown next at its end.

    `nodes` are of k, either lapse and every bias, over `reach` sds of the prior or, after trials,
    what the posterior leaves of it.
    """
    none = np.zeros(standards.size)
    cells = Cells(standards, comparisons, standards, none, none)
    if before is not None:
        names = "stimulus_1", "stimulus_2", "standard", "n", "count"
        cells = Cells(*(np.r_[getattr(before, name), getattr(cells, name)] for name in names))
    model = hypothesis.model(cells)
    if before is None:
        ends = wide_ends(model, reach)
    else:
        windows = zoomed(model, cells.count[None], batch_steps(model), 7.5)
        low, high = windows.low[:, :, 0].min(axis=1), windows.high[:, :, 0].max(axis=1)
        ends = [tuple(windows.ends[0, :, 0]), *zip(low, high, strict=True)]
    grid = BeliefGrid(model, even_axes(model, ends, nodes))
    for i, (n, count, group) in enumerate(zip(cells.n, cells.count, model.group, strict=True)):
        grid.put(model.encodings.of(np.array([i])), group, [n - count, count])
    for _ in grid.bias:
        grid.see_candidates()
        grid.close()
    return Belief(hypothesis, cells, grid)


def _of_answers(beliefs: list[Belief], last: int, place: float) -> Array:
    """The three informations of the last so many pairs, (3, J) nats."""
    answers = [(b.mass_k, b.predicted()[0][:, -last:]) for b in beliefs]
    mean = np.stack([mass @ p for mass, p in answers])  # (M, J)
    about_k = np.mean(
        [entropy(m) - mass @ entropy(p) for m, (mass, p) in zip(mean, answers, strict=True)], axis=0
    )
    about_hypothesis = entropy(mean.mean(axis=0)) - entropy(mean).mean(axis=0)
    log_jnd = [np.log(b.k * float(difference_sd(b.hypothesis.encoding, place))) for b in beliefs]
    return np.maximum([about_k, _shared(log_jnd, answers), about_hypothesis], 0.0)


def _shared(
    log_jnd: list[Array], answers: list[tuple[Array, Array]], thresholds: int = 161
) -> Array:
    """Information about a quantity that every hypothesis has a belief of, (J,) nats, by so many
    bins of its logarithm."""
    if len(log_jnd) == 1 or log_jnd[0].size == 1:
        mass, p = answers[0]
        return np.asarray(entropy(mass @ p) - mass @ entropy(p))
    low, high = min(a.min() for a in log_jnd), max(a.max() for a in log_jnd)
    bins = np.linspace(low, high + 1e-9, thresholds)
    total, up = np.zeros(bins.size), np.zeros((bins.size, answers[0][1].shape[1]))
    for value, (mass, p) in zip(log_jnd, answers, strict=True):
        # Belief is a density: spread evenly between nodes before it meets that of another.
        fine = np.linspace(value[0], value[-1], 64 * (value.size - 1) + 1)
        density = np.interp(fine, value, mass)
        density /= density.sum() * len(answers)
        given = np.stack([np.interp(fine, value, column) for column in p.T], axis=1)
        at = np.clip(np.searchsorted(bins, fine) - 1, 0, bins.size - 1)
        np.add.at(total, at, density)
        np.add.at(up, at, density[:, None] * given)
    share = up / np.maximum(total, 1e-300)[:, None]
    return np.asarray(entropy(up.sum(axis=0)) - total @ entropy(np.clip(share, 0.0, 1.0)))


class Precision:
    """Expected intervals of k from any choice of the positions (C,), m, that there are.

    One hypothesis is true, and fitted; `drawn` of the animals stand for all, the same for every
    choice.
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        standards: ArrayLike,
        comparisons: ArrayLike,
        animals: SubjectPopulation,
        drawn: int = 64,
    ) -> None:
        s1, s2 = (np.asarray(a, dtype=float) for a in (standards, comparisons))
        model = hypothesis.model(Cells(s1, s2, s1, np.ones(s1.size), np.zeros(s1.size)))
        likely = animals.draw(drawn, seed=20)
        middle = model.fixed_bias()
        if model.free_bias and model.task.bias_name == "criterion":
            middle = float(hypothesis.priors.value("bias", 0.0))
        # ln k, either lapse and the bias of every animal, (4, A); one that never lapses does not
        # tell so.
        lapses = np.maximum(likely[["lapse_low", "lapse_high"]].to_numpy().T, 3e-3)
        at = np.stack([np.log(likely["weber_fraction"]), *lapses, middle + likely["bias"]])

        def chance(there: Array) -> Array:
            k, low, high, bias = there
            biases = np.repeat(bias[:, None], model.n_groups, axis=1)
            return model.probability(np.exp(k), low, high, biases)[0]

        p = chance(at)
        step = 1e-3  # of central differences
        slopes = [
            (chance(at + d) - chance(at - d)) / (2 * step) for d in step * np.eye(4)[..., None]
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
        total = np.broadcast_to(self._prior[:3, :3], (len(self._information), 3, 3)).copy()
        for group in np.unique(self._group[at]):
            own = each * self._information[:, at[self._group[at] == group]].sum(axis=1)
            # The bias integrated out: the Schur complement of its information.
            mixed, bias = own[:, :3, 3], own[:, 3, 3] + self._prior[3, 3]
            total += own[:, :3, :3] - mixed[:, :, None] * mixed[:, None, :] / bias[:, None, None]
        return np.asarray(1.96 * np.sqrt(np.linalg.inv(total)[:, 0, 0]))
