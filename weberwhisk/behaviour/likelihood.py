"""The model of one observer's choices: Weber fraction, effects, lapses, biases by group."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln

from .._util import checks
from .._util.refusals import Refusal, argument, call, named
from .._util.values import Array, Fields, Index
from .effects import Effect, Overdispersion, SessionBias, check_effects
from .encodings import (
    Encoding,
    Signals,
    UnitEncodings,
    chosen_encoding,
    condensed,
    encoding_for,
    refuse_unencoded,
    unit_encodings,
    with_noise,
)
from .formula import expanded
from .located import over_places
from .priors import (
    PLAIN,
    TINY,
    Priors,
    ScoreTransform,
    bias_transform,
    lapse_transform,
    priors_for,
)
from .session_bias import BiasedSessions, chunks
from .tasks import Task
from .trials import Cells, Trials, check_trials, needs_standards

__all__ = [
    "BIASES", "Draws", "WeberModel", "build_model", "encoding_of", "gather", "names_by_standard",
    "observer_model", "pairs_shown",
]  # fmt: skip

BIASES = ("none", "shared", "per standard")
RHO_TINY = 1e-7  # below this a beta-binomial is a binomial, and log-gammas lose their digits


@dataclass(frozen=True)
class Draws:
    """Joint draws of every parameter, whether inferred or fixed.

    `weber_fraction`, `lapse_low`, `lapse_high` have shape (N,); `bias` (N, G), a column per group;
    `effects` (N, E), a column per effect.
    """

    weber_fraction: Array
    lapse_low: Array
    lapse_high: Array
    bias: Array
    effects: Array = field(default_factory=lambda: np.zeros((1, 0)))

    def __len__(self) -> int:
        return len(self.weber_fraction)

    @property
    def values(self) -> tuple[Array, Array, Array, Array, Array]:
        """All, in the order of the arguments of a likelihood."""
        return self.weber_fraction, self.lapse_low, self.lapse_high, self.bias, self.effects

    def at(self, place: Any) -> Draws:
        """Some of them."""
        return Draws(*(values[place] for values in self.values))

    def thinned(self, most: int) -> Draws:
        """Every so many of them, about `most` or fewer than twice that."""
        return self.at(slice(None, None, max(len(self) // most, 1)))

    def named(self, model: WeberModel) -> dict[str, Array]:
        """The inferred parameters by name, each (N,)."""
        columns = {n: getattr(self, n) for n in ("weber_fraction", "lapse_low", "lapse_high")}
        columns |= {e.name: self.effects[:, i] for i, e in enumerate(model.effects)}
        columns |= {name: self.bias[:, i] for i, name in enumerate(model.group_names)}
        return {name: columns[name] for name in model.names}


@dataclass(frozen=True, repr=False)
class WeberModel(Fields):
    """One observer: k, effects and two lapses for all cells, one bias per group of cells.

    Given everything else, the biases of the groups are independent, which is what makes a bias per
    standard as cheap as one bias: each is integrated by itself. `encodings` and `cells` have arrays
    (C,); `group` (C,) says which bias a cell has, `group_names` is empty where there is none;
    `effects` are bound to the table, and `columns` (E, C) what each goes with.
    """

    task: Task
    encodings: UnitEncodings
    cells: Cells
    priors: Priors
    group: Index
    group_names: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    columns: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def n_states(self) -> int:
        """States of the animal."""
        return 1

    @property
    def n_groups(self) -> int:
        """Groups of cells, one where there is no bias."""
        return max(len(self.group_names), 1)

    @property
    def lead(self) -> tuple[str, ...]:
        """All parameters but the biases: Weber fraction, effects, and the two lapses last."""
        return ("weber_fraction", *(e.name for e in self.effects), "lapse_low", "lapse_high")

    @cached_property
    def free(self) -> tuple[bool, ...]:
        """Which of the lead are inferred."""
        absent = {"lapse_low", "lapse_high"} - {*self.task.lapses}
        return tuple(n not in absent and not self.priors.is_fixed(n) for n in self.lead)

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters that are not fixed."""
        lead = [n for n, free in zip(self.lead, self.free, strict=True) if free]
        return (*lead, *(self.group_names if self.free_bias else ()))

    @property
    def free_bias(self) -> bool:
        """Whether there is any bias to infer."""
        return bool(self.group_names) and not self.priors.is_fixed("bias")

    def value(self, name: str, scores: ArrayLike) -> Array:
        """A lead parameter at a normal score of its prior; zero where the task has none such."""
        if name.startswith("lapse_") and name not in self.task.lapses:
            return np.zeros(np.shape(scores))
        return self.priors.value(name, scores)

    def at_scores(self, scores: Array) -> tuple[Array, Array, Array, Array]:
        """k, effects, and both lapses at scores (..., lead)."""
        values = [self.value(name, scores[..., i]) for i, name in enumerate(self.lead)]
        none = np.zeros((*values[0].shape, 0))
        effects = np.stack(values[1:-2], axis=-1) if self.effects else none
        return values[0], effects, values[-2], values[-1]

    def draws_at(self, scores: Array, bias: Array) -> Draws:
        """Every parameter at scores (N, lead) and biases (N, G)."""
        k, effects, low, high = self.at_scores(scores)
        return Draws(k, low, high, bias, effects)

    def completed(self, draws: Draws, rng: np.random.Generator) -> Draws:
        """Draws from the prior with those of parameters that a kind of model has beside."""
        return draws

    @cached_property
    def transforms(self) -> tuple[ScoreTransform, ...]:
        """The coordinate of each lead parameter for a grid: its score, but for lapses."""
        doublings = round(np.log2(max(float(self.cells.n.sum()) / 3, 1.0)))
        return tuple(
            lapse_transform(self.priors.of(name), doublings)
            if free and name in self.task.lapses
            else PLAIN
            for name, free in zip(self.lead, self.free, strict=True)
        )

    @cached_property
    def bias_transform(self) -> ScoreTransform:
        """The coordinate of every bias for a grid."""
        return bias_transform(self.priors.of("bias")) if self.free_bias else PLAIN

    def at(self, name: str, coordinate: ArrayLike) -> Array:
        """A lead parameter at a coordinate of the grid."""
        return self.value(name, self.transforms[self.lead.index(name)].score(coordinate))

    @cached_property
    def score_precision(self) -> Array:
        """Precision of the free lead scores under their prior, where two lapses are correlated."""
        free = np.array(self.free)
        covariance = np.eye(free.size)
        if free[-2:].all():
            covariance[-1, -2] = covariance[-2, -1] = self.priors.lapse_correlation
        return np.linalg.inv(covariance[np.ix_(free, free)])

    @cached_property
    def membership(self) -> Array:
        """(C, G): 1 where a cell belongs to a group."""
        return np.equal.outer(self.group, np.arange(self.n_groups)).astype(float)

    def encoded(self, k: Array, effects: Array | None = None) -> Signals:
        """Both signals of every cell, (..., C), with Weber fraction (...) and effects (..., E)."""
        encoded = self.encodings.encoded(k)
        if self.effects and effects is None:
            raise Refusal(
                f"the model has effects ({', '.join(e.name for e in self.effects)}) and got no "
                "values of them",
                remedy="give effects=draws.effects",
            )
        for i, (effect, column) in enumerate(zip(self.effects, self.columns, strict=True)):
            assert effects is not None
            encoded = effect.apply(encoded, effects[..., i, None], column)
        return encoded

    def decide(self, k: Array, effects: Array | None = None) -> tuple[Array, Array | float]:
        """Decision variable (..., C) and what a bias of 1 adds to it, places integrated over.

        A place known with an error moves the difference between the signals by a normal number of
        variance v, and E Φ(d + e/σ + b) = Φ((d + b)/√(1 + v/σ²)): v is not the animal's, and does
        not grow with k; a bias, which is in sds of the animal's noise, shrinks with d.
        """
        encoded = self.encoded(k, effects)
        d, weight = self.task.decide(encoded)
        if not self.encodings.has_spread:
            return d, weight
        sd = self.task.decision_sd(encoded)
        share = sd / np.sqrt(sd**2 + np.asarray(self.encodings.spread, dtype=float))
        return d * share, weight * share

    def lapses(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Asymptotes as the task sees them; `low` is ignored where the task has none."""
        return self.task.asymptotes(low, high)

    def fixed_bias(self) -> float:
        """The bias of every group where it is not inferred."""
        if self.group_names and self.priors.is_fixed("bias"):
            return float(self.priors.bias)
        return 0.0

    def fixed_value(self, name: str) -> float:
        """The value of a parameter that is not inferred."""
        if name in self.lead:
            return float(self.value(name, 0.0))
        return self.fixed_bias()

    def probability(
        self,
        k: Array,
        low: Array,
        high: Array,
        bias: Array,
        effects: Array | None = None,
        deviation: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """P and 1 − P of every cell, (..., C), for k and lapses (...), biases (..., G), effects
        (..., E), and what is added to the bias of a cell (..., C).

        Both are computed without subtraction from 1, so neither loses its tail.
        """
        d, weight = self.decide(k, effects)
        return self.with_lapses(d, weight * (bias[..., self.group] + deviation), low, high)

    def with_lapses(
        self, d: Array, bias: Array | float, low: Array, high: Array
    ) -> tuple[Array, Array]:
        """P and 1 − P at decision variables (..., C) moved by biases, for lapses (...)."""
        low, high = (a[..., None] for a in self.lapses(low, high))
        up, down = self.task.chance(d, bias)
        return (
            np.maximum(low * down + (1 - high) * up, TINY),
            np.maximum((1 - low) * down + high * up, TINY),
        )

    @cached_property
    def dispersed(self) -> int | None:
        """Which effect is the overdispersion, if there is one."""
        return self._place_of(Overdispersion)

    @cached_property
    def by_session(self) -> int | None:
        """Which effect is the bias that differs by session, if there is one."""
        return self._place_of(SessionBias)

    def _place_of(self, kind: type[Effect]) -> int | None:
        return next((i for i, e in enumerate(self.effects) if isinstance(e, kind)), None)

    def log_likelihood(
        self, k: Array, low: Array, high: Array, bias: Array, effects: Array | None = None
    ) -> Array:
        """Log-probability of the sequence of answers, (...); binomial coefficients left out."""
        if self.by_session is None:
            return self.cell_log_likelihood(k, low, high, bias, effects).sum(axis=-1)
        assert effects is not None
        shape = np.shape(k)
        flat = Draws(
            *(np.reshape(np.broadcast_to(a, shape), -1) for a in (k, low, high)),
            *(np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1])
              for a in (bias, effects)),
        )  # fmt: skip
        of_parts = [self._sessions(flat.at(part)).log_marginal()
                    for part in chunks(len(flat), self.cells.n.size)]  # fmt: skip
        return np.concatenate([np.zeros(0), *of_parts]).reshape(shape)

    def cell_log_likelihood(
        self,
        k: Array,
        low: Array,
        high: Array,
        bias: Array,
        effects: Array | None = None,
        deviation: Array | float = 0.0,
    ) -> Array:
        """The same by cell, (..., C), given what is added to the bias of each."""
        p, q = self.probability(k, low, high, bias, effects, deviation)
        return self.log_of_cells(p, q, effects)

    def log_of_cells(self, p: Array, q: Array, effects: Array | None) -> Array:
        """Log-probability of the answers to each cell, of P and 1 − P (..., C)."""
        if self.dispersed is None:
            return self.cells.count * np.log(p) + (self.cells.n - self.cells.count) * np.log(q)
        assert effects is not None
        return self.beta_binomial(p, q, effects[..., self.dispersed, None])

    # -- biases by session -------------------------------------------------------------------------

    @cached_property
    def _session(self) -> Index:
        """The session of each cell, numbered from 0 among those with answers."""
        assert self.by_session is not None
        labels = self.columns[self.by_session]
        return np.unique(labels, return_inverse=True)[1].reshape(-1)

    @cached_property
    def _sorted(self) -> tuple[Index, Index]:
        """Cells by session, and where those of each begin."""
        order = np.argsort(self._session, kind="stable")
        return order, np.flatnonzero(np.diff(self._session[order], prepend=-1))

    def _sessions(self, draws: Draws) -> BiasedSessions:
        """The sessions, given draws of the rest."""
        assert self.by_session is not None
        return BiasedSessions(
            self._answers(draws), draws.effects[:, self.by_session, None], self._start(draws)
        )

    def _answers(self, draws: Draws) -> SessionAnswers:
        d, weight = self.decide(draws.weber_fraction, draws.effects)
        return SessionAnswers(self, draws, d, weight, self._session, *self._sorted)

    def _start(self, draws: Draws) -> Array:
        """About where the bias of each session is, less the shared one, (N, S).

        It is searched for one draw in the middle of all; what is perceived as equal is then the
        same for all of them, so that biases go as one over the Weber fraction.
        """
        assert self.by_session is not None
        k = np.exp(np.log(draws.weber_fraction).mean())
        means = [values.mean(axis=0, keepdims=True) for values in draws.values]
        middle = Draws(np.array([k]), *means[1:])
        start = np.zeros((1, self._sorted[1].size))
        for _ in range(3):
            start = BiasedSessions(self._answers(middle), np.full((1, 1), 2.0), start).modes
        total = middle.bias.mean() + start
        return total * (k / draws.weber_fraction)[:, None] - draws.bias.mean(axis=1, keepdims=True)

    def session_deviations(self, draws: Draws, seed: int = 0) -> Array:
        """How far the bias of each session is from the shared one, drawn given the rest and all
        answers, (N, S); the same whenever they are drawn."""
        sessions = int(self._session.max(initial=-1)) + 1
        uniform = np.random.default_rng(seed).random((len(draws), sessions))
        return np.concatenate([
            np.zeros((0, sessions)),
            *(self._sessions(draws.at(part)).drawn(uniform[part])
              for part in chunks(len(draws), 4 * self.cells.n.size)),
        ])  # fmt: skip

    def deviation(self, draws: Draws) -> Array | float:
        """What the sessions add to the bias of each cell, drawn given the rest, (N, C)."""
        if self.by_session is None:
            return 0.0
        return self.session_deviations(draws)[:, self._session]

    def beta_binomial(self, p: Array, q: Array, rho: Array) -> Array:
        """Log-probability of the answers of a cell whose P has a beta distribution, (..., C)."""
        size = (1 - rho) / np.maximum(rho, RHO_TINY)
        a, b = np.maximum(p * size, TINY), np.maximum(q * size, TINY)
        x, n = self.cells.count, self.cells.n
        rising = gammaln(a + x) - gammaln(a) + gammaln(b + (n - x)) - gammaln(b)
        return np.asarray(rising - (gammaln(size + n) - gammaln(size)))

    def simulate(self, draws: Draws, rng: np.random.Generator) -> Array:
        """Counts that observers with these parameters would give to the same trials, (N, C)."""
        p, q = self.expected(draws)
        if self.dispersed is not None:
            rho = np.maximum(draws.effects[:, self.dispersed, None], RHO_TINY)
            p = rng.beta(*(np.maximum(side * (1 - rho) / rho, TINY) for side in (p, q)))
        n = self.cells.n.astype(np.int64)
        return rng.binomial(n, np.clip(p, 0.0, 1.0)).astype(float)

    def expected(self, draws: Draws) -> tuple[Array, Array]:
        """P of either answer to each cell, (N, C)."""
        return self.probability(*draws.values, deviation=self.deviation(draws))

    def log_said(self, draws: Draws) -> Array:
        """Log-probability of the answers to each cell, (N, C)."""
        return self.cell_log_likelihood(*draws.values, deviation=self.deviation(draws))

    def by_row(self, draws: Draws, cell: Index) -> tuple[Array, Array]:
        """The same of rows with these cells, (N, R)."""
        p, q = self.expected(draws)
        return p[:, cell], q[:, cell]

    def log_bias_prior(self, bias: Array) -> Array:
        """Log-density of the bias prior, elementwise; 0 where the bias is fixed."""
        if not self.free_bias:
            return np.zeros(np.shape(bias))
        return self.priors.log_density("bias", bias)

    def plain(self) -> WeberModel:
        """The same observer without effects."""
        return replace(self, effects=(), columns=np.zeros((0, 0))) if self.effects else self

    def merged(self) -> WeberModel:
        """The same likelihood with fewer cells: those that only differ in scale are one.

        Under Weber's law every standard repeats the same few ratios. Floors, and effects that are
        not scale-free, know the scale and leave the cells as they are. More than 200 are condensed
        to nodes, where the decision variable is D/k for a number D of each cell; of measured places
        more than 1000.
        """
        pairs, n, count = self.encodings, self.cells.n, self.cells.count
        if pairs.has_floor or not all(effect.is_scale_free for effect in self.effects):
            return self
        if self.effects and pairs.has_spread:
            return self
        labels = np.column_stack([self.group, *self.columns])
        labels, kind = np.unique(labels, axis=0, return_inverse=True)
        kind = kind.reshape(-1)
        if not pairs.has_spread:
            key = np.column_stack([(pairs.mean_2 - pairs.mean_1) / pairs.sd_1,
                                   pairs.sd_2 / pairs.sd_1])  # fmt: skip
            rounded = np.column_stack([np.round(key, 11), kind])
            _, first, same = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
            same = same.reshape(-1)
            n, count = (np.bincount(same, a, first.size).astype(float) for a in (n, count))
            gap, ratio = key[first].T
            pairs = UnitEncodings(np.zeros(first.size), np.ones(first.size), gap, ratio)
            kind = kind[first]
        if n.size > (1000 if pairs.has_spread else 200) and (
            pairs.has_spread or self.task.is_difference
        ):
            pairs, n, count, kind = condensed(self.task.decision_sd, pairs, n, count, kind)
        unknown = np.full(n.size, np.nan)  # the stimuli of a node
        cells = Cells(unknown, unknown, unknown, n, count)
        group, columns = labels[kind, 0].astype(np.intp), labels[kind, 1:].T
        if not self.effects:
            columns = self.columns
        return replace(self, encodings=pairs, cells=cells, group=group, columns=columns)

    def subset(self, standard: float) -> WeberModel:
        """The same observer seen at one standard alone."""
        keep = self.cells.standard == standard
        groups = np.unique(self.group[keep])
        return replace(
            self,
            encodings=self.encodings.of(keep),
            cells=self.cells.of(standard),
            group=np.searchsorted(groups, self.group[keep]),
            group_names=tuple(self.group_names[g] for g in groups) if self.group_names else (),
            columns=self.columns[:, keep] if self.effects else self.columns,
        )

    def by_standard(self) -> Iterator[tuple[float, WeberModel]]:
        """Every standard with its part of the model."""
        for standard in np.unique(self.cells.standard):
            yield float(standard), self.subset(float(standard))


@dataclass(frozen=True)
class SessionAnswers:
    """The answers of a model by session, given draws of all but the deviations of the bias.

    `d` and `weight` are those of `WeberModel.decide`, `session` (C,) that of each cell; `order`
    sorts cells by it, and those of a session begin at `starts` (S,).
    """

    model: WeberModel
    draws: Draws
    d: Array
    weight: Array | float
    session: Index
    order: Index
    starts: Index

    @property
    def sessions(self) -> int:
        return self.starts.size

    def log_likelihood(self, deviation: Array) -> Array:
        """Of each session, for deviations (N, S)."""
        draws = self.draws
        bias = self.weight * (draws.bias[:, self.model.group] + deviation[:, self.session])
        p, q = self.model.with_lapses(self.d, bias, draws.lapse_low, draws.lapse_high)
        log = self.model.log_of_cells(p, q, draws.effects)
        return np.asarray(np.add.reduceat(log[:, self.order], self.starts, axis=1))


def gather(
    trials: Trials, effects: tuple[Effect, ...], encoding: Encoding
) -> tuple[Cells, Array, Index]:
    """Trials in cells, those apart that differ in what an effect goes with; columns (E, C); and the
    cell of each row with an answer."""
    named = [e.column(trials, encoding) for e in effects]
    zeros = np.zeros(len(trials.frame))
    return trials.gathered(*(zeros if c is None else c for c in named))


def build_model(
    trials: Trials,
    encoding: Encoding | None,
    observer: Any,
    bias: str | None,
    noise: str,
    priors: Any,
    effects: Sequence[Effect | str] = (),
    further: Mapping[str, Any] | None = None,
) -> tuple[WeberModel, Encoding, str]:
    """The model of a fit, its encoding, and the bias chosen; `further` parameters have priors."""
    check_trials(trials)
    check_effects(effects)
    if len(trials.subjects) > 1:
        raise Refusal(
            f"{trials.source}: there are {len(trials.subjects)} subjects "
            f"({checks.listed(trials.subjects)}) and one observer is fitted at a time",
            remedy="choose one with "
            + call("trials.select", argument("subject", trials.subjects[0])),
        )
    encoded = encoding_of(trials, encoding, observer, noise)
    task = trials.task
    by_itself = "shared" if task.has_bias else "none"
    chosen = by_itself if bias is None else bias
    checks.one_of("bias", chosen, BIASES)
    if chosen != "none" and not task.has_bias:
        raise Refusal(
            f"{task.name} has no response bias to fit", argument("bias", bias), "leave it out"
        )
    if chosen == "per standard":
        needs_standards(trials, argument("bias", bias))
    effects = expanded(effects, trials)
    cells, columns, _ = gather(trials, effects, encoded)
    both = pairs_shown(cells, encoded, noise)
    if cells.sd_1 is not None:
        both = over_places(task, encoded, cells, both, noise)
    if cells.n.size and not (both.sd_1.any() or both.sd_2.any()):
        raise Refusal(
            "no noise of these signals goes with a Weber fraction, so there is none to fit",
            getattr(getattr(encoded, "observer", None), "noise", None),
            "give receptors with a weber_fraction, ww.receptors.Weber(0.1), say",
        )
    bound = tuple(effect.bound(both, cells.n) for effect in effects)
    by_name = {effect.name: effect.prior for effect in bound} | dict(further or {})
    if len({effect.name for effect in bound}) < len(bound):
        raise Refusal(
            named("effects") + " must differ", ", ".join(e.name for e in bound), "name each once"
        )
    believed = priors_for(priors, cells, trials.unit_known, task, by_name, [both])
    model = observer_model(task, both, cells, believed, chosen, bound, columns)
    return model, encoded, chosen


def observer_model(
    task: Task,
    encodings: UnitEncodings,
    cells: Cells,
    priors: Priors,
    bias: str,
    effects: tuple[Effect, ...] = (),
    columns: Array | None = None,
) -> WeberModel:
    """The model of an observer with no bias, a "shared" one, or one "per standard"."""
    names: tuple[str, ...] = ()
    group = np.zeros(cells.n.size, dtype=np.intp)
    label = task.bias_name or "bias"
    if bias == "shared":
        names = (label,)
    elif bias == "per standard":
        levels, group = np.unique(cells.standard, return_inverse=True)
        names = names_by_standard(label, levels)
    none = np.zeros((0, 0)) if columns is None else columns
    return WeberModel(task, encodings, cells, priors, group, names, effects, none)


def names_by_standard(label: str, standards: Array) -> tuple[str, ...]:
    """A name for the bias of each standard, in full where six digits would name two alike."""
    short = tuple(f"{label}[{s:g}]" for s in standards)
    if len(set(short)) == len(short):
        return short
    return tuple(f"{label}[{float(s)!r}]" for s in standards)


def encoding_of(trials: Trials, encoding: Encoding | None, observer: Any, noise: str) -> Encoding:
    """The encoding of a fit: the one given, or that of a whisker, or what the table calls for."""
    given = chosen_encoding(encoding, observer)
    chosen = encoding_for(trials.scale, trials.log_unit, noise) if given is None else given
    if noise != "constant":
        return chosen
    cells = trials.cells()
    return with_noise(chosen, noise, (cells.stimulus_1, cells.stimulus_2))


def pairs_shown(cells: Cells, encoding: Encoding, noise: str) -> UnitEncodings:
    """Both encoded stimuli of every cell, refused where one gives no signal."""
    stimuli = cells.stimulus_1, cells.stimulus_2, cells.standard
    refuse_unencoded(encoding, np.concatenate(stimuli))
    return unit_encodings(encoding, *stimuli, noise)
