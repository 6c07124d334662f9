"""What one more trial is expected to tell, as a function of its standard and offset, in bits.

The mutual information of an answer and what is asked: the Weber fraction, the JND at a distance, or
which hypothesis is right (Lindley 1956, Ann. Math. Stat. 27:986), everything else integrated out:
a lapse or a bias that must be learnt as well costs information, and is not counted as any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import entr

from .. import _checks
from ..behaviour.encodings import UnitEncodings, unit_encodings
from ..behaviour.integrate.batch import batch_steps, zoomed
from ..behaviour.integrate.windows import bias_at
from ..behaviour.lapses import lapse_prior, score_prior
from ..behaviour.likelihood import WeberModel
from ..behaviour.psychometric import difference_sd, refuse_out_of_reach
from ..behaviour.trials import Cells
from ..threads import one_blas_thread
from .hypotheses import Hypothesis, SubjectPopulation, check_distinct
from .scheme import Scheme

Array = NDArray[np.float64]

NODES = 41, 21, 25  # of k, either lapse and the bias
REACH = 4.0  # prior sds
THRESHOLDS = 161  # bins of the log of a JND


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
    truths: Sequence[Hypothesis | None] = given if after is not None else [None]
    parts = []
    for truth in truths:
        beliefs = [believed(h, after, truth, likely) for h in given]
        parts.append(
            np.stack(
                [_of_standard(beliefs, s, s + row, place) for s, row in zip(at, rows, strict=True)]
            )
        )
    bits = np.mean(parts, axis=0)  # (S, 3, J)
    return pd.DataFrame(
        {
            "standard_mm": 1e3 * np.repeat(at, rows.shape[1]),
            "offset_mm": 1e3 * rows.ravel(),
            "weber_fraction_bits": bits[:, 0].ravel(),
            "jnd_bits": bits[:, 1].ravel(),
            "hypothesis_bits": bits[:, 2].ravel(),
        }
    )


@dataclass(frozen=True)
class HypothesisTable:
    """What is known of an observer: nodes and their probabilities.

    `k` (K,); for each standard run before, and under None for all others, `bias` (B,), `mass`
    (K, B), and the means of either lapse there, (K, B).
    """

    hypothesis: Hypothesis
    k: Array
    known: dict[float | None, tuple[Array, Array, Array, Array]]

    def answers(self, standard: float, comparisons: Array) -> tuple[Array, Array]:
        """Probability of each k (K,), and of the answer given it (K, J)."""
        shared = self.hypothesis.bias != "per standard"
        own = next(iter(self.known)) if shared else standard
        bias, mass, low, high = self.known.get(own, self.known[None])
        model = self.hypothesis.asked
        encoded = unit_encodings(
            self.hypothesis.encoding, np.full(comparisons.shape, standard), comparisons,
            np.full(comparisons.shape, standard), self.hypothesis.noise,
        )  # fmt: skip
        d, weight = model.decide(encoded.encoded(self.k))
        weight = np.broadcast_to(weight, d.shape)
        up, down = model.chance(d[:, None], weight[:, None] * bias[:, None])  # (K, B, J)
        p = low[..., None] * down + (1 - high)[..., None] * up
        of_k = mass.sum(axis=1)
        given_k = np.einsum("kb,kbj->kj", mass, p) / np.maximum(of_k, 1e-300)[:, None]
        return of_k, given_k


def believed(
    hypothesis: Hypothesis,
    after: Scheme | None,
    truth: Hypothesis | None,
    animals: SubjectPopulation,
) -> HypothesisTable:
    """What is known of an observer after the answers that the truth is expected to give."""
    before = after if after is not None else Scheme([1.0], [0.0], 1)
    if after is None:
        model = _silent(hypothesis)
        counts = np.zeros(1)
        ends = [(-REACH, REACH)] + [
            tuple(transform.coordinate([-REACH, REACH])) for transform in model.transforms[-2:]
        ]
        biases = [(-REACH, REACH)]
    else:
        model = hypothesis.model(before)
        assert truth is not None
        counts = expected_counts(truth, before, animals)[0, 0]
        ends = _range(model, counts)
        ends, biases = ends[:3], ends[3:]
    k_axis, low_axis, high_axis = (
        np.linspace(float(end[0]), float(end[1]), n) if free else np.zeros(1)
        for end, n, free in zip(
            ends, (NODES[0], NODES[1], NODES[1]), (model.free[0], *model.free[-2:]), strict=True
        )
    )
    k = model.value("weber_fraction", k_axis)
    low, high = (
        model.at(n, a) for n, a in zip(model.lead[-2:], (low_axis, high_axis), strict=True)
    )
    lo, hi = (a.ravel() for a in np.meshgrid(low, high, indexing="ij"))
    log_prior = score_prior(k_axis)[:, None] + lapse_prior(model, low_axis, high_axis).ravel()
    known: dict[float | None, tuple[Array, Array, Array, Array]] = {}
    groups = []
    for group, end in enumerate(biases):
        bias, log_bias = _bias_nodes(model, end)
        cells = np.flatnonzero(model.group == group)
        part = model.subset(model.cells.standard[cells[0]]) if model.n_groups > 1 else model
        p, q = part.probability(k[:, None], lo, hi, bias[:, None, None, None])  # (B, K, L, C)
        x, n = counts[cells], model.cells.n[cells]
        log_like = np.log(p) @ x + np.log(q) @ (n - x)
        log_like += log_bias[:, None, None]
        groups.append((bias, log_like))
    alone = [np.logaddexp.reduce(log_like, axis=0) for _, log_like in groups]
    joint = log_prior + sum(alone)
    lost = model.lapses(lo, hi)
    for group, (bias, log_like) in enumerate(groups):
        known[_standard(model, group)] = (bias, *_by_bias(log_like - alone[group] + joint, lost))
    if None not in known:
        bias, log_bias = _bias_nodes(model, (-REACH, REACH))
        known[None] = (bias, *_by_bias(log_bias[:, None, None] + joint, lost))
    return HypothesisTable(hypothesis, k, known)


def expected_counts(truth: Hypothesis, scheme: Scheme, animals: SubjectPopulation) -> Array:
    """Answers of an expected animal on average, (1, 1, C): without bias, and not whole."""
    model = truth.model(scheme)
    k, lapse = np.array([animals.weber_fraction]), np.array([animals.lapse])
    bias = float(truth.priors.value("bias", 0.0)) if truth.asked.bias_name == "criterion" else 0.0
    p, _ = model.probability(k, lapse, lapse, np.full((1, model.n_groups), bias))
    return np.asarray(p * model.cells.n)[None]


def entropy(p: Array) -> Array:
    """Of an answer with probability p, bits."""
    return np.asarray((entr(p) + entr(1 - p)) / np.log(2))


def _of_standard(
    beliefs: list[HypothesisTable], standard: float, comparisons: Array, place: float
) -> Array:
    """The three informations at the comparisons of a standard, (3, J) bits."""
    out = np.full((3, comparisons.size), np.nan)
    encoded = np.ones(comparisons.size, dtype=bool)
    for b in beliefs:
        low, high = b.hypothesis.encoding.domain
        inside = (comparisons > low) & (comparisons < high)
        safe = np.where(inside, comparisons, standard)
        encoded &= inside & np.isfinite(b.hypothesis.encoding.sd_per_weber_fraction(safe))
    if not encoded.any():
        return out
    answers = [b.answers(standard, comparisons[encoded]) for b in beliefs]
    mean = np.stack([mass @ p for mass, p in answers])  # (M, J)
    about_k = np.mean(
        [entropy(m) - mass @ entropy(p) for m, (mass, p) in zip(mean, answers, strict=True)], axis=0
    )
    about_hypothesis = entropy(mean.mean(axis=0)) - entropy(mean).mean(axis=0)
    log_jnd = [np.log(b.k * float(difference_sd(b.hypothesis.encoding, place))) for b in beliefs]
    about_jnd = _shared(log_jnd, answers)
    out[:, encoded] = about_k, about_jnd, about_hypothesis
    return np.maximum(out, 0.0)


def _shared(log_jnd: list[Array], answers: list[tuple[Array, Array]]) -> Array:
    """Information about a quantity that every hypothesis has a belief of, (J,) bits."""
    if len(log_jnd) == 1 or log_jnd[0].size == 1:
        mass, p = answers[0]
        return np.asarray(entropy(mass @ p) - mass @ entropy(p))
    low, high = min(a.min() for a in log_jnd), max(a.max() for a in log_jnd)
    bins = np.linspace(low, high + 1e-9, THRESHOLDS)
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


def _by_bias(log_mass: Array, lost: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """Mass (K, B) of nodes (B, K, L), and the mean lapses there."""
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    of_bias = mass.sum(axis=2)
    low, high = (mass @ part / np.maximum(of_bias, 1e-300) for part in lost)
    return of_bias.T, low.T, high.T


def _bias_nodes(model: WeberModel, ends: tuple[float, float]) -> tuple[Array, Array]:
    """A bias at even scores of its prior, and the log prior density of these."""
    score = np.linspace(*ends, NODES[2]) if model.free_bias else np.zeros(1)
    return bias_at(model, score), score_prior(score)


def _standard(model: WeberModel, group: int) -> float | None:
    """The standard of a group; None for what is not of any standard."""
    own = np.unique(model.cells.standard[model.group == group])
    return float(own[0]) if own.size == 1 and model.cells.n.sum() > 0 else None


def _silent(hypothesis: Hypothesis) -> WeberModel:
    """The model of no trials: its priors alone."""
    one, none = np.ones(1), np.zeros(1)
    names = () if hypothesis.bias == "none" else ("bias",)
    encoded = UnitEncodings(one, one, one, one)
    cells = Cells(one, one, one, none, none)
    group = np.zeros(1, dtype=np.intp)
    return WeberModel(hypothesis.asked, encoded, cells, hypothesis.priors, group, names)


def _range(model: WeberModel, counts: Array) -> list[tuple[float, float]]:
    """Where the posterior lies: ends of the axes of k and the lapses, and of each bias's score."""
    windows = zoomed(model, counts[None], batch_steps(model), 7.5)
    low, high = windows.low[:, :, 0].min(axis=1), windows.high[:, :, 0].max(axis=1)
    of_k = float(windows.ends[0, 0, 0]), float(windows.ends[0, 1, 0])
    return [of_k, *((float(a), float(b)) for a, b in zip(low, high, strict=True))]
