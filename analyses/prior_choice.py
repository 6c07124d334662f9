"""Beliefs about bias, criterion, lapses and k, chosen by expected loss over a range of observers.

    python analyses/prior_choice.py [folder] [--short] [--sets N]

Writes `prior_choice.md` into this folder, or the one named. The posterior of k is summed on plain
nodes about the truth, which share no code with the package, under every belief at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
from command import ANALYSES, markdown_table, options
from plain_grid import Array, estimates
from scipy import stats
from scipy.special import ndtr, ndtri

#: Beliefs by what they are of, the shipped one first, then that before where it was another.
BIASES = {
    "2AFC": ("cauchy(0, 0.7)", "norm(0, 1)", "norm(0, 3)", "norm(0, 5)", "cauchy(0, 0.4)",
             "cauchy(0, 1.5)", "t(2, 0, 1)", "t(3, 0, 1)", "t(3, 0, 3)"),
    "same-different": ("fisk(1.5, scale=1.6)", "lognorm(0.7, scale=1.3)", "fisk(1, scale=1.3)",
                       "fisk(1.5, scale=1.3)", "fisk(2, scale=1.3)", "fisk(2.5, scale=1.3)"),
}  # fmt: skip
BIASES["go/no-go"] = BIASES["2AFC"]
LAPSE_BELIEFS = ("beta(0.7, 20)", "beta(0.5, 9.5)", "beta(0.5, 14)", "beta(0.4, 8)", "beta(1, 9)",
                 "loguniform(0.001, 0.5)")  # fmt: skip
FACTORS = (3.0, 2.0, 5.0)  # one sd of k about 0.1
TRIALS = (10, 40, 200, 1000, 10_000)
LAPSES = (0.0, 0.02, 0.08, 0.2)


@dataclass(frozen=True)
class Observer:
    """One kind of observer, and the design shown to it.

    `place` is where its answers turn: equality, as a share of the standard, or a criterion in sds.
    Levels lie about that place, as an experimenter finds it who looks at the answers; a go/no-go
    task shows the no-go stimulus in half of its trials, a same-different task equal pairs in 0.4.
    """

    task: str
    trials: int
    k: float
    place: float
    lapse: float

    @property
    def edge(self) -> float:
        """The comparison at which either answer is as likely, lapses aside; the standard is 1."""
        if self.task == "2AFC":
            return 1 + self.place
        return 1 + self.place * self.k * (np.sqrt(2.0) if self.task == "same-different" else 1.0)

    @cached_property
    def levels(self) -> Array:
        if self.task == "2AFC":
            return np.asarray(self.edge * np.exp(self.k * np.sqrt(2) * np.linspace(-3, 3, 9)))
        if self.task == "go/no-go":
            beyond = self.edge * (1 + self.k * np.linspace(-1.5, 3.5, 5))
        else:
            beyond = self.edge + self.k * np.array([-1.2, 0, 1.2, 2.5, 4.5])
        return np.r_[1.0, np.maximum(beyond, 1 + 0.01 * np.arange(1, 6))]

    @cached_property
    def shown(self) -> Array:
        """Trials of each level."""
        share = {"2AFC": np.full(9, 1 / 9), "go/no-go": np.r_[0.5, np.full(5, 0.1)]}.get(
            self.task, np.r_[0.4, np.full(5, 0.12)]
        )
        return np.diff(np.r_[0, np.floor(np.cumsum(share) * self.trials + 0.5)])

    def bias(self, k: Any) -> Any:
        """The bias or criterion that has either answer as likely at the edge."""
        if self.task == "2AFC":
            return (1 - self.edge) / (k * np.hypot(1, self.edge))
        return (self.edge - 1) / (k * (np.sqrt(2) if self.task == "same-different" else 1))

    def chance(self, k: Array, bias: Array) -> tuple[Array, Array]:
        """Of the answer and the other without lapses, (..., C)."""
        x, k, bias = self.levels, k[..., None], bias[..., None]
        if self.task == "same-different":
            sd, criterion = k * np.hypot(1, x), np.sqrt(2) * k * np.maximum(bias, 0.0)
            up = ndtr((x - 1 - criterion) / sd) + ndtr((1 - x - criterion) / sd)
            return up, ndtr((criterion - x + 1) / sd) - ndtr((1 - x - criterion) / sd)
        if self.task == "2AFC":
            z = (x - 1) / (k * np.hypot(1, x)) + bias
        else:
            z = ((x - 1) / k - bias) / x
        return ndtr(z), ndtr(-z)

    def answers(self, sets: int, seed: int = 0) -> Array:
        """Counts of the answer (N, C) of so many such observers."""
        up, _ = self.chance(np.array(self.k), np.array(self.bias(self.k)))
        p = self.lapse + (1 - 2 * self.lapse) * up
        kind = [sum(map(ord, self.task)), self.trials, *(int(1e4 * v) for v in
                (self.k, self.place, self.lapse))]  # fmt: skip
        rng = np.random.default_rng([2026, seed, *kind])
        return rng.binomial(self.shown.astype(int), p, (sets, p.size)).astype(float)


def observers(task: str) -> Iterator[Observer]:
    """The stated range."""
    places = {"2AFC": (0.0, 0.1, 0.2, 0.4), "go/no-go": (0.0, 1.0, 2.5, 5.0, 8.0),
              "same-different": (0.5, 1.3, 3.0, 5.0, 8.0)}[task]  # fmt: skip
    for trials, k, place, lapse in product(TRIALS, (0.03, 0.1), places, LAPSES):
        yield Observer(task, trials, k, place, lapse)


class Nodes:
    """Nodes of k, of a bias given k, and of both lapses, with the likelihoods of many data sets."""

    def __init__(self, observer: Observer, count: Array) -> None:
        self.observer, self.count = observer, count
        n = observer.trials
        self.ln_k = self._fractions(n)
        k = np.exp(self.ln_k)
        up, down = observer.chance(np.array(observer.k), np.array(observer.bias(observer.k)))
        nudged = observer.chance(np.array(observer.k), np.array(observer.bias(observer.k) + 1e-3))
        information = (observer.shown * (1e3 * (nudged[0] - up)) ** 2
                       / np.maximum(up * down, 1e-9)).sum()  # fmt: skip
        sd = 1 / np.sqrt(information + 0.1)
        reach = (10 * sd + 4 * (n < 100)) * np.maximum(1.0, observer.k / k)
        shape = np.sinh(np.linspace(-2.4, 2.4, 45)) / np.sinh(2.4)
        self.bias = observer.bias(k)[:, None] + reach[:, None] * shape  # (K, B)
        self.width = np.gradient(self.bias, axis=1)
        if observer.task == "same-different":  # none is below zero
            self.width = np.where(self.bias > 0, self.width, 0.0)
        middle, spread = np.arcsin(np.sqrt(observer.lapse)), 0.5 / np.sqrt(max(0.2 * n, 1.0))
        first = max(middle - 8 * spread, 0.0) if n > 2000 else 0.0
        last = min(middle + (8 if n > 2000 else 5) * spread, 0.95)
        arc = np.linspace(first, last, int(np.clip(np.ceil((last - first) / spread) + 1, 13, 21)))
        half = 0.5 * (arc[1] - arc[0])
        self.lapse = np.sin(arc) ** 2
        ends = np.r_[arc - half, arc[-1] + half]
        self.edges = np.sin(np.clip(ends, 0.0, np.pi / 2)) ** 2

    def _fractions(self, n: int) -> Array:
        if n <= 40:
            return np.log(0.1) + np.log(3) * np.linspace(-3.6, 3.6, 57)
        reach = max(12 / np.sqrt(n), 0.4)
        # Lapses and a large k explain the same errors.
        far = self.observer.lapse > 0.05 and n < 2000
        above = max(1.3 * reach, 1.5 * far)
        below = max((1.6 if n > 200 else 3.2) * reach, 1.2 * far)
        return np.log(self.observer.k) + np.linspace(-below, above, 75)

    def lapse_weights(self, prior: Any, correlation: float = 0.7, power: float = 1.0) -> Array:
        """Prior mass of both lapses, (L·L,), the density of their normal scores to a power."""
        ends = np.clip(ndtri(prior.cdf(self.edges)) * np.sqrt(power), -9.0, 9.0)
        z = np.linspace(-9, 9, 6001)
        given = ndtr((ends - correlation * z[:, None]) / np.sqrt(1 - correlation**2))
        mass = np.zeros((self.lapse.size, self.lapse.size))
        at = np.searchsorted(ends, z, side="right") - 1
        inside = (at >= 0) & (at < self.lapse.size)
        np.add.at(mass, at[inside], stats.norm.pdf(z)[inside, None] * np.diff(given[inside]))
        possible = self.lapse[:, None] + self.lapse < 1
        return np.asarray((mass * possible / mass.sum()).ravel())

    def summed(self, lapses: Array, biases: list[Any]) -> Array:
        """Likelihoods of ln k, (L beliefs, B beliefs, K, N), for weights (L·L, L beliefs)."""
        low, high = self.lapse[:, None, None, None], self.lapse[:, None, None]
        n, count = self.observer.shown, self.count
        both = np.hstack([count, n - count]).T.astype(np.float32)
        out = np.empty((lapses.shape[1], len(biases), self.ln_k.size, len(count)))
        top = np.empty((self.ln_k.size, len(count)))
        lapses = lapses.astype(np.float32)
        for i, (k, bias) in enumerate(zip(np.exp(self.ln_k), self.bias, strict=True)):
            up, down = self.observer.chance(np.full(bias.shape, k), bias)
            p, q = low * down + (1 - high) * up, (1 - low) * down + high * up
            logs = np.log(np.maximum(np.concatenate([p, q], axis=-1), 1e-30)).astype(np.float32)
            like = logs.reshape(-1, both.shape[0]) @ both
            top[i] = like.max(axis=0)
            like = np.exp(like - top[i].astype(np.float32)).reshape(len(lapses), -1)
            by_bias = (lapses.T @ like).reshape(lapses.shape[1], bias.size, -1)
            prior = np.array([belief(bias) * self.width[i] for belief in biases])
            out[:, :, i] = np.einsum("lbn,sb->lsn", by_bias, prior)
        return out * np.exp(top - top.max(axis=0))


def power_scaled(prior: Any, power: float) -> Any:
    """The density whose normal scores have that of the prior's to a power; not normalised."""

    def pdf(value: Array) -> Array:
        below, above = ndtri(prior.cdf(value)), -ndtri(prior.sf(value))
        score = np.where(below < 0, below, above)
        return np.asarray(prior.pdf(value) * np.exp(-0.5 * (power - 1) * np.minimum(score**2, 1e3)))

    return pdf


def fraction(factor: float, power: float = 1.0) -> Any:
    """The belief about ln k."""
    return stats.norm(np.log(0.1), np.log(factor) / np.sqrt(power))


Named = tuple[str, str, float]  # beliefs about bias, lapses and k


@dataclass(frozen=True)
class Outcome:
    """Errors of ln k of one kind of observer, (3, N) by beliefs: median, ends of the interval.

    `moves` (3, 2, N) are the greatest of median and ends when the shipped belief about bias, lapses
    or k counts twice and half, in posterior sds; `open_end` (N,) is where the likelihood leaves an
    end open.
    """

    observer: Observer
    errors: Mapping[Named, Array]
    moves: Array
    open_end: Array

    def flagged(self, sds: float, of_lapses: float) -> Array:
        """Where a status other than DETERMINED stands on the fit, (N,)."""
        least = np.array([sds, of_lapses, sds])[:, None, None]
        return np.asarray(self.open_end | (self.moves > least).any(axis=(0, 1)))

    def held(self, beliefs: Named) -> Array:
        """Where the 95 % interval holds k, (N,)."""
        _, lower, upper = self.errors[beliefs]
        return np.asarray((lower < 0) & (upper > 0))


def believed(text: str) -> Any:
    return eval(text, vars(stats))


def outcome(observer: Observer, sets: int) -> Outcome:
    """So many observers of a kind under every belief."""
    nodes = Nodes(observer, observer.answers(sets))
    named, powers = BIASES[observer.task], (2.0, 0.5)
    own = believed(named[0])
    biases = [believed(name).pdf for name in named] + [power_scaled(own, p) for p in powers]
    weights = [nodes.lapse_weights(believed(name)) for name in LAPSE_BELIEFS]
    shipped = believed(LAPSE_BELIEFS[0])
    weights += [nodes.lapse_weights(shipped, power=power) for power in powers]
    like = nodes.summed(np.array(weights).T, biases)  # (L, B, K, N)
    shift = np.log(observer.k)

    def found(at: tuple[int, int], prior: Any = None) -> Array:
        of = estimates(nodes.ln_k, like[at], prior or fraction(FACTORS[0]))
        return np.array([of["median"], of["lower"], of["upper"]]) - shift

    errors = {(name, LAPSE_BELIEFS[0], FACTORS[0]): found((0, i)) for i, name in enumerate(named)}
    errors |= {(named[0], name, FACTORS[0]): found((i, 0)) for i, name in enumerate(LAPSE_BELIEFS)}
    errors |= {(named[0], LAPSE_BELIEFS[0], f): found((0, 0), fraction(f)) for f in FACTORS}
    fitted = errors[named[0], LAPSE_BELIEFS[0], FACTORS[0]]
    moved = [[found((0, len(named) + i)) for i in (0, 1)],
             [found((len(weights) - 2 + i, 0)) for i in (0, 1)],
             [found((0, 0), fraction(FACTORS[0], power)) for power in powers]]  # fmt: skip
    moves = np.abs(np.array(moved) - fitted).max(axis=2) / ((fitted[2] - fitted[1]) / 3.92)
    return Outcome(observer, errors, moves, open_ends(nodes.ln_k, like[0, 0]))


def open_ends(ln_k: Array, like: Array, far: float = 3.0, likely: float = 0.1) -> Array:
    """Where the likelihood three prior sds from 0.1 is above a tenth of the best, (N,)."""
    score = (ln_k - np.log(0.1)) / np.log(3)
    best = np.where(np.abs(score[:, None]) < far + 0.5, like, 0.0).max(axis=0)
    ends = [np.array([np.interp(end, score, one, left=0.0, right=0.0) for one in like.T])
            for end in (-far, far)]  # fmt: skip
    return np.asarray((ends[0] > likely * best) | (ends[1] > likely * best))


# -- tables ----------------------------------------------------------------------------------------

#: Posterior sds by which a belief that decides moves k, and that about lapses: `prior_sensitivity`.
DECIDES = 3 / 4, 1 / 2


def shipped(task: str) -> Named:
    return BIASES[task][0], LAPSE_BELIEFS[0], FACTORS[0]


def before(task: str) -> Named:
    """The beliefs of version 0.2."""
    return BIASES[task][1], LAPSE_BELIEFS[0], FACTORS[0]


def rms(outcomes: list[Outcome], beliefs: Named) -> float:
    return float(np.sqrt(np.mean([np.square(o.errors[beliefs][0]).mean() for o in outcomes])))


def covers(outcomes: list[Outcome], beliefs: Named) -> float:
    return float(100 * np.mean([o.held(beliefs).mean() for o in outcomes]))


def bias_rows(task: str, outcomes: list[Outcome]) -> str:
    """Beliefs about the bias: loss, loss where the belief of 0.2 covers, coverage by place."""
    places = sorted({o.observer.place for o in outcomes})
    few = [o for o in outcomes if o.observer.lapse < 0.2]
    fine = [o for o in few if o.held(before(task)).mean() >= 0.92]
    heads = ["belief", "RMSE of ln k", "from 40 trials", "where 0.2 covers, over that of 0.2",
             *(f"covers at {place:g}, %" for place in places)]  # fmt: skip
    lines = []
    for name in BIASES[task]:
        one = name, LAPSE_BELIEFS[0], FACTORS[0]
        at = [[o for o in few if o.observer.place == place] for place in places]
        lines.append([
            name, f"{rms(few, one):.3f}",
            f"{rms([o for o in few if o.observer.trials >= 40], one):.3f}",
            f"{rms(fine, one) / rms(fine, before(task)):.3f}",
            *(f"{covers(of_place, one):.0f}" for of_place in at),
        ])  # fmt: skip
    return markdown_table(heads, lines)


def other_rows(outcomes: list[Outcome], which: str) -> str:
    """Beliefs about lapses, or k: loss and coverage by lapses, of all tasks together."""
    heads = ["belief"]
    heads += [f"lapses {lapse:g}: RMSE of ln k, covers" for lapse in LAPSES]
    lines = []
    for name in LAPSE_BELIEFS if which == "lapses" else FACTORS:
        values = [str(name) if which == "lapses" else f"0.1, a factor of {name:g}"]
        for lapse in LAPSES:
            kind = [o for o in outcomes if o.observer.lapse == lapse]
            if not kind:
                values.append("")
                continue
            named = [
                (BIASES[o.observer.task][0], name, FACTORS[0]) if which == "lapses"
                else (BIASES[o.observer.task][0], LAPSE_BELIEFS[0], name) for o in kind
            ]  # fmt: skip
            loss = np.sqrt(np.mean([np.square(o.errors[n][0]).mean()
                                    for o, n in zip(kind, named, strict=True)]))  # fmt: skip
            share = np.mean([o.held(n).mean() for o, n in zip(kind, named, strict=True)])
            values.append(f"{loss:.3f}, {100 * share:.0f} %")
        lines.append(values)
    return markdown_table(heads, lines)


def flag_rows(outcomes: list[Outcome]) -> str:
    """Held, flagged, and either, by task, lapses and trials."""
    heads = ["task", "lapses", *(f"{n} trials: covers / flagged / either, %" for n in TRIALS)]
    lines = []
    for task in dict.fromkeys(o.observer.task for o in outcomes):
        for lapse in LAPSES:
            values = [task, f"{lapse:g}"]
            for n in TRIALS:
                kind = [o for o in outcomes if (o.observer.task, o.observer.lapse,
                        o.observer.trials) == (task, lapse, n)]  # fmt: skip
                if not kind:
                    values.append("")
                    continue
                held = np.concatenate([o.held(shipped(task)) for o in kind])
                flagged = np.concatenate([o.flagged(*DECIDES) for o in kind])
                values.append(" / ".join(f"{100 * one.mean():.0f}"
                                         for one in (held, flagged, held | flagged)))  # fmt: skip
            lines.append(values)
    return markdown_table(heads, lines)


def threshold_rows(outcomes: list[Outcome]) -> str:
    """What is flagged, by how far a belief must move k."""
    lines = []
    for sds in ((1 / 4, 1 / 4), (1 / 2, 1 / 3), (1 / 2, 1 / 2), DECIDES, (1, 1 / 2), (1, 1)):
        either = [(o.held(shipped(o.observer.task)) | o.flagged(*sds)).mean() for o in outcomes]
        covered = [o for o in outcomes if o.held(shipped(o.observer.task)).mean() >= 0.92]
        flags = 100 * np.mean([o.flagged(*sds).mean() for o in covered])
        short = sum(share < 0.92 for share in either)
        lines.append([" and ".join(f"{one:.2g}" for one in sds),
                      f"{100 * np.mean(either):.1f}", f"{short} of {len(either)}",
                      f"{100 * min(either):.0f}", f"{flags:.0f}"])  # fmt: skip
    heads = ["sds, and of lapses", "held or flagged, %", "kinds below 92 %", "the least, %",
             "flagged where 92 % are held, %"]  # fmt: skip
    return markdown_table(heads, lines)


def report(sets: int, kept: Any = None) -> str:
    """The page of text; of observers that `kept` takes."""
    kinds = [o for task in BIASES for o in observers(task) if kept is None or kept(o)]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(partial(outcome, sets=sets), kinds, chunksize=4))
    outcomes = {task: [o for o in found if o.observer.task == task] for task in BIASES}
    every = [o for of_task in outcomes.values() for o in of_task]
    return TEXT.format(
        sets=sets, kinds=len(every), lapses=other_rows(every, "lapses"),
        fractions=other_rows(every, "k"), flags=flag_rows(every), thresholds=threshold_rows(every),
        biases="\n\n".join(f"*{task}*\n\n{bias_rows(task, of_task)}"
                           for task, of_task in outcomes.items()),
    )  # fmt: skip


TEXT = """# Beliefs about bias, lapses and k over a stated range

Made by `prior_choice.py`: {kinds} kinds of observers with {sets} data sets each. Three tasks; 10 to
10 000 trials; k of 0.03 and 0.1; equality up to 40 % off (2AFC), criteria up to 8 sds
(go/no-go, same-different); lapses of 0, 2, 8 and 20 % at either end. Levels lie about the place
where answers turn, wherever that is: 9 over 3 sds either way (2AFC), or the no-go stimulus in half
of the trials and five about the criterion. The posterior of k is summed on plain nodes
(`tests/analyses/test_prior_choice.py` holds them to `fit_weber`).

## The bias

Where k is small a bias is many sds: one whose tails fall as a normal's pulls k up, and nothing in
the interval says so. RMSE and coverage are of observers with lapses up to 8 %, all trials together;
the third column is of the kinds in which 95 % intervals under the belief of version 0.2 (the second
row) hold k in 92 % or more.

{biases}

The Cauchy belief has the middle half of a standard normal, 0.67 sds either way, and tails of which
a twentieth lies beyond 9 sds. From 40 trials on no other belief loses less than it does by more
than an eighth, and it holds k at the far end of the range; where the normal belief was right it
costs what the third column says, 0 to 3 %. Wide normal beliefs hold k as often, and there cost 7 to
30 %. For the same-different task, whose criterion is above 0, the log-logistic does the same.

## Lapses

{lapses}

Over this range, whose levels reach 3 sds, beliefs that expect more lapses lose less, and hold k
more often where a fifth of the answers are lost. The default stays all the same: over the animals
of `lapse_prior.md`, to whom levels were shown that may reach barely beyond the thresholds, these
beliefs lose up to 6 % more (Beta(0.5, 9.5)) or 29 % (Beta(1, 10)) where they were held out. Where
lapses are as many as that, the status says that the belief about them decides (the last section).

## k

{fractions}

A factor of 2 loses less here only because k was laid out about 0.1.

## Which belief decides

A fit is PRIOR_DEPENDENT where a belief counted twice, or half, moves the median of ln k, or an end
of its 95 % interval, by more than ¾ of a posterior sd, that about lapses by more than half
(`WeberFit.prior_sensitivity`), and flagged, too, where the likelihood leaves an end open
(UPPER_BOUND and the like). The median alone says too little: where a fifth of the answers are lost
and 200 trials are few, the belief that lapses are few holds it, and lets go of the lower end. Of 30
data sets whose intervals hold k in 95 %, one kind in five has fewer than 92 % by chance.

{thresholds}

With ¾ of an sd, half of one of lapses:

{flags}
"""


def main() -> None:
    given = options(
        __file__, __doc__, folder=ANALYSES, short="few observers and data sets", sets=30
    )
    kept = (lambda o: o.k == 0.1 and o.trials in (40, 1000)) if given.short else None
    text = report(6 if given.short else given.sets, kept)
    given.folder.mkdir(parents=True, exist_ok=True)
    (given.folder / "prior_choice.md").write_text(text, "utf-8")


if __name__ == "__main__":
    main()
