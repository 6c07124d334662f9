"""The best standards and offsets that rig and animal allow.

A scheme is judged by what it is expected to find: the log Bayes factor of the *expected* answers of
an animal, n·P of every level (Cowan et al. 2011, Eur. Phys. J. C 71:1554, §3.2), integrated as data
are; or the interval of k that the goal's share of animals will have (`Precision`). Every position
is tabulated once, so that thousands of schemes can be tried: one position is exchanged at a time,
for the best there is, until no exchange helps (Meyer & Nachtsheim 1995, Technometrics 37:60), from
a few starts. The search sees answers that do not scatter, on a coarse grid or by normal
posteriors; the last word is that of simulated experiments, integrated as data are: of the schemes
found, and of a plain one of even standards and offsets of all sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from .._util import checks
from .._util.threads import one_blas_thread
from .._util.values import Array, Fields, Flags, Index
from ..behaviour.axes import lapse_prior, score_prior
from ..behaviour.encodings import gives_signal
from ..behaviour.integrate.batch import log_sum
from ..behaviour.psychometric import difference_sd
from ..behaviour.trials import Cells
from .experiments import compare, fit, simulate
from .hypotheses import Goal, Hypothesis, SubjectPopulation, check_goal
from .scheme import Constraints, Scheme, easy_share

__all__ = ["Best", "Precision", "best_scheme"]


@dataclass(frozen=True, repr=False)
class Best(Fields):
    """The best scheme found, and how it was.

    `table` has a row for every scheme that may be the best: `value`, what the goal's share of
    simulated experiments reach, the log Bayes factor in nats of the truth that is hardest to tell,
    or minus the half-width of the interval of k; its `standards` and `offsets`.
    """

    scheme: Scheme
    value: float
    table: pd.DataFrame = field(repr=False)


@one_blas_thread
def best_scheme(
    hypotheses: Sequence[Hypothesis],
    *,
    goal: Goal | None = None,
    constraints: Constraints | None = None,
    expected: SubjectPopulation | None = None,
    standards: int = 3,
    pairs: int = 3,
    trials: int = 360,
    animals: int = 1,
    seed: int = 1,
) -> Best:
    """Choose standards and offsets for a number of trials.

    Parameters
    ----------
    hypotheses : sequence of Hypothesis
        The first is the expected one.
    goal : Goal, optional
        Whether to go for the Bayes factor (by default with two hypotheses) or the interval of k.
    constraints : Constraints, optional
    expected : SubjectPopulation, optional
        The animal whose answers are expected.
    standards, pairs : int
        How many standards, and how many offsets on either side of each.
    trials : int
        Of one animal, all levels together: they are spread evenly.
    animals : int
        Written into the scheme.
    seed : int
        Of the starts.

    Raises
    ------
    ValueError
        For constraints that nothing satisfies, saying which and by how much.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Constraints, taper
    >>> found = best_scheme(taper(Whisker(50e-3, 100e-6, 5e-6)), standards=2, pairs=1,
    ...                     constraints=Constraints(nearest=5e-3, farthest=45e-3))
    >>> near, far = found.scheme.standards
    >>> near < 15e-3 and far > 35e-3
    True
    """
    given, aim = check_goal(hypotheses, goal)
    limits, likely = constraints or Constraints(), expected or SubjectPopulation()
    for name, number in (("standards", standards), ("pairs", pairs), ("trials", trials)):
        checks.whole(name, number, "write 3")
    each = trials // (2 * pairs * standards)
    if each < 1:
        raise ValueError(
            f"{trials} trials are fewer than the {2 * pairs * standards} levels of {standards} "
            f"standards with {pairs} pairs, {2 * pairs * standards - trials} short; give more."
        )
    sites = _sites(given, limits, likely, pairs)
    if len(sites) < standards:
        raise ValueError(
            f"the constraints leave {len(sites)} standards that have {pairs} pairs of offsets, "
            f"{standards - len(sites)} fewer than standards={standards}; widen the range of "
            f"{limits.nearest:g} to {limits.farthest:g}, take finer steps or fewer pairs."
        )
    _refuse_too_hard(sites, limits, standards, pairs)
    search = _Search(given, sites, likely, aim, limits, pairs, each)
    rng = np.random.default_rng(seed)
    found = [search.climb(search.start(standards, rng if i else None)) for i in range(3)]
    choices = {choice for _, choice in found} | {search.spread(standards)}
    allowed = sorted(choice for choice in choices if np.isfinite(search.value(choice)))
    found = [(search.simulated(choice, given, seed), choice) for choice in allowed]
    value, choice = max(found, key=lambda pair: pair[0])
    schemes = [search.scheme(c, animals) for _, c in found]
    table = pd.DataFrame(
        {
            "value": [v for v, _ in found],
            "standards": [list(s.standards) for s in schemes],
            "offsets": [[list(row) for row in s.offsets] for s in schemes],
        }
    )
    return Best(search.scheme(choice, animals), value, table)


@dataclass(frozen=True)
class _Site:
    """A standard and the sizes of offset that it may have, the easy ones among them."""

    standard: float
    sizes: Array
    easy: Flags


def _positions(sites: list[_Site]) -> tuple[Array, Array, Index]:
    """Standards and comparisons of all sites, nearer ones first, and where each site begins."""
    s1 = np.concatenate([np.full(2 * s.sizes.size, s.standard) for s in sites])
    s2 = s1 + np.concatenate([np.concatenate([-s.sizes, s.sizes]) for s in sites])
    return s1, s2, np.cumsum([0, *(2 * s.sizes.size for s in sites)])


Choice = tuple[tuple[int, tuple[int, ...]], ...]  # sites, and the sizes chosen at each


class _Search:
    def __init__(
        self,
        hypotheses: Sequence[Hypothesis],
        sites: list[_Site],
        animals: SubjectPopulation,
        goal: Goal,
        limits: Constraints,
        pairs: int,
        each: int,
    ) -> None:
        self.sites, self.goal, self.limits = sites, goal, limits
        self.pairs, self.each, self.animals = pairs, each, animals
        s1, s2, self.first = _positions(sites)
        self.models: list[_Sketch] = []
        if goal.bayes_factor is None:
            self.precision = Precision(hypotheses[0], s1, s2, animals)
        else:
            self.models = [_Sketch(h, sites, animals) for h in hypotheses]
        self.values: dict[Choice, float] = {}

    def start(self, standards: int, rng: np.random.Generator | None) -> Choice:
        """Spread evenly, or anywhere; the widest offsets are easy."""
        if rng is None:
            at = np.linspace(0, len(self.sites) - 1, standards).round().astype(int)
        else:
            at = np.sort(rng.choice(len(self.sites), standards, replace=False))
        last = [(int(i), self.sites[i].sizes.size) for i in at]
        return tuple((i, tuple(range(size - self.pairs, size))) for i, size in last)

    def spread(self, standards: int) -> Choice:
        """Evenly spread standards, with offsets of all sizes."""
        choice = []
        for i, widest in self.start(standards, None):
            last = self.sites[i].sizes.size - 1
            sizes = np.unique(np.round(np.geomspace(0.2, 0.9, self.pairs) * last).astype(int))
            choice.append((i, tuple(sizes.tolist()) if sizes.size == self.pairs else widest))
        return tuple(choice)

    def simulated(
        self, choice: Choice, hypotheses: Sequence[Hypothesis], seed: int, runs: int = 512
    ) -> float:
        """What the goal's share of simulated experiments reach, where it is hardest; so many, all
        truths together."""
        scheme, rng = self.scheme(choice, 1), np.random.default_rng(seed)
        truths = hypotheses if self.goal.half_width is None else hypotheses[:1]
        worst = np.inf
        for truth in truths:
            counts, _ = simulate(truth, scheme, self.animals, runs // len(truths), rng)
            if self.goal.half_width is None:
                reached, _ = compare(hypotheses, truth.name, scheme, counts)
            else:
                reached = -fit(truth, scheme, counts).half_width
            worst = min(worst, float(np.quantile(reached, 1 - self.goal.share)))
        return worst

    def climb(self, choice: Choice) -> tuple[float, Choice]:
        """Exchange one thing at a time for the best there is, until nothing helps."""
        value = self.value(choice)
        while True:
            tried = [(self.value(c), c) for c in self._neighbours(choice)]
            best, other = max(tried, key=lambda pair: pair[0], default=(-np.inf, choice))
            if best <= value + 1e-9:
                return value, choice
            value, choice = best, other

    def _neighbours(self, choice: Choice) -> list[Choice]:
        out = []
        taken = {i for i, _ in choice}
        for at, (site, sizes) in enumerate(choice):
            count = self.sites[site].sizes.size
            changed = [
                (site, tuple(sorted({*sizes[:j], new, *sizes[j + 1 :]})))
                for j in range(len(sizes))
                for new in range(count)
                if new not in sizes
            ]
            for other in range(len(self.sites)):
                if other not in taken:  # as wide there as here
                    share = (self.sites[other].sizes.size - 1) / max(count - 1, 1)
                    moved = {round(j * share) for j in sizes}
                    if len(moved) == len(sizes):
                        changed.append((other, tuple(sorted(moved))))
            out += [tuple(sorted((*choice[:at], new, *choice[at + 1 :]))) for new in changed]
        return out

    def value(self, choice: Choice) -> float:
        """What is expected of a choice; minus infinity where too few trials are easy."""
        if choice not in self.values:
            easy = np.mean([self.sites[i].easy[list(sizes)].mean() for i, sizes in choice])
            self.values[choice] = (
                self._expected(choice) if easy >= self.limits.easy_share else -np.inf
            )
        return self.values[choice]

    def _expected(self, choice: Choice) -> float:
        if self.goal.bayes_factor is None:
            at = [
                self.first[site] + place
                for site, sizes in choice
                for s in sizes
                for place in (s, self.sites[site].sizes.size + s)
            ]
            widths = self.precision.half_widths(at, self.each)
            # A quarter of the animals that may miss the goal: real ones' answers scatter.
            return -float(np.quantile(widths, 1 - (1 - self.goal.share) / 4.0))
        factors = []
        for truth in self.models:
            found = {m: m.log_evidence(truth, choice, self.each) for m in self.models}
            own = found.pop(truth)
            factors.append(own - max(found.values()))
        return min(factors)

    def scheme(self, choice: Choice, animals: int) -> Scheme:
        rows = []
        for site, sizes in choice:
            size = self.sites[site].sizes[list(sizes)]
            rows.append([float(f"{o:.12g}") for o in np.concatenate([-size[::-1], size])])
        return Scheme([self.sites[i].standard for i, _ in choice], rows, self.each, animals)


class _Sketch:
    """One hypothesis on a fixed grid: log-probabilities of all positions, tabulated once."""

    def __init__(
        self,
        hypothesis: Hypothesis,
        sites: list[_Site],
        animals: SubjectPopulation,
        nodes: tuple[int, int, int] = (41, 5, 21),  # of k, either lapse and the bias
    ) -> None:
        s1, s2, self.first = _positions(sites)
        self.count = [s.sizes.size for s in sites]
        model = hypothesis.model(Cells(s1, s2, s1, np.ones(s1.size), np.zeros(s1.size)))
        self.scores = np.linspace(-3.3, 3.3, nodes[0]) if model.free[0] else np.zeros(1)
        self.k = model.value("weber_fraction", self.scores)
        axes = [
            s.coordinate(np.linspace(-1.2, 2.2, nodes[1])) if free else np.zeros(1)
            for s, free in zip(model.transforms[-2:], model.free[-2:], strict=True)
        ]
        low, high = (model.at(n, a) for n, a in zip(model.lead[-2:], axes, strict=True))
        lo, hi = (a.ravel() for a in np.meshgrid(low, high, indexing="ij"))
        bias = np.array([model.fixed_bias()])
        if model.free_bias:
            mean, sd = model.priors.moments("bias")
            bias = mean + sd * np.linspace(-2.5, 2.5, nodes[2])
        self.bias = model.log_bias_prior(bias)[:, None]
        self.prior = score_prior(self.scores)[:, None] + lapse_prior(model, *axes).ravel()
        self.yes = np.empty((s1.size, bias.size, self.k.size * lo.size), dtype=np.float32)
        self.no = np.empty_like(self.yes)
        for b, value in enumerate(bias):
            p, q = model.probability(
                self.k[:, None], lo, hi, np.full((1, 1, model.n_groups), value)
            )
            self.yes[:, b] = np.log(p).reshape(-1, s1.size).T
            self.no[:, b] = np.log(q).reshape(-1, s1.size).T
        k, lapse = np.array([animals.weber_fraction]), np.array([animals.lapse])
        middle = np.full((1, model.n_groups), float(model.priors.value("bias", 0.0)))
        self.expected = model.probability(k, lapse, lapse, middle)[0][0]

    def log_evidence(self, truth: _Sketch, choice: Choice, each: int) -> float:
        """Of the answers that a truth expects."""
        total = self.prior.copy()
        for site, sizes in choice:
            at = self.first[site] + np.array([*sizes, *(self.count[site] + s for s in sizes)])
            x = (each * truth.expected[at]).astype(np.float32)
            by_bias = np.tensordot(x, self.yes[at], 1) + np.tensordot(each - x, self.no[at], 1)
            total += log_sum(by_bias + self.bias, 0).reshape(total.shape)
        return float(log_sum(total.reshape(1, -1), 1)[0])


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


def _sites(
    hypotheses: Sequence[Hypothesis],
    limits: Constraints,
    animals: SubjectPopulation,
    pairs: int,
    places: int = 19,
) -> list[_Site]:
    """The standards and offsets that every hypothesis and constraint allows: of so many standards,
    and of offsets up to 3.9 sds of the difference in steps of 0.3."""
    encoded = hypotheses[0].encoding
    low = max(limits.nearest, max(h.encoding.domain[0] for h in hypotheses))
    high = min(limits.farthest, min(h.encoding.domain[1] for h in hypotheses))
    if not (np.isfinite(high) and low < high):
        raise ValueError(
            f"the range of {limits.nearest:g} to {limits.farthest:g} leaves nothing that can be "
            f"encoded, which ends at {high:g}, {low - high:.3g} before it begins; give "
            "ww.design.Constraints(nearest=..., farthest=...)."
        )
    at = np.unique(limits.positions(np.linspace(low, high, places + 2)[1:-1]))
    out = []
    for s in at[(at > low) & (at < high)]:
        if not all(gives_signal(h.encoding, s) for h in hypotheses):
            continue
        one = animals.weber_fraction * float(difference_sd(encoded, s))
        sizes = np.unique(limits.positions(np.arange(0.3, 4.01, 0.3) * one))
        sizes = sizes[sizes > 0]
        inside = (s - sizes > low) & (s + sizes < high)
        sizes = sizes[inside & (s - sizes >= limits.nearest) & (s + sizes <= limits.farthest)]
        for h in hypotheses:
            for sign in (-1, 1):
                sizes = sizes[gives_signal(h.encoding, s + sign * sizes)]
        if sizes.size < pairs:
            continue
        k, how = animals.weber_fraction, (hypotheses[0].task, hypotheses[0].noise)
        pairs_of = (Scheme([s], [-d, d], 1) for d in sizes)
        easy = [easy_share(p, encoded, k, limits.easy_proportion, *how) for p in pairs_of]
        out.append(_Site(float(s), sizes, np.asarray(easy) == 1.0))
    return out


def _refuse_too_hard(sites: list[_Site], limits: Constraints, standards: int, pairs: int) -> None:
    most = np.sort([min(int(s.easy.sum()), pairs) / pairs for s in sites])[::-1]
    share = float(most[:standards].mean())
    if share < limits.easy_share:
        raise ValueError(
            f"at most {100 * share:.3g} % of the trials can be easy here (right in "
            f"{100 * limits.easy_proportion:g} %), {100 * (limits.easy_share - share):.3g} % fewer "
            f"than easy_share={limits.easy_share:g} asks for; lower it, or widen the range."
        )
