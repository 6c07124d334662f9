"""The posterior of a population of animals by weighted draws.

The draws of an animal's parameters, weighted by its likelihood over their own density, give its
likelihood in any population as a sum of normal densities: a matrix product, for many populations at
once. Draws are made for an animal of which nothing is known, and then, as empirical Bayes has it,
for the animal in populations that have turned out to be likely. Populations are weighted draws too.
What the number of draws of animals leaves as error is measured by halves of them, each of its own
Sobol points; animals that leave much get more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._util.importance import (
    Component,
    SobolPoints,
    WeightedDraws,
    adapted_draws,
    fitted_components,
    tempered_components,
    weighted_draws,
)
from .._util.values import Array, Index, weighted_quantiles
from .hierarchy import Animal, Hierarchy, Normals

__all__ = ["AnimalDraws", "Population", "integrate_population"]

FIRST = 400  # draws of an animal of which nothing is known
ALIKE = 16  # such animals from which others are begun
#: Draws of all animals in populations that are roughly known, at the most and at the least, and of
#: one: at the least, over the square of its number of parameters at the most, once more are needed,
#: and for what is read off.
DRAWS, ALL = 64_000, 8192
FEWEST, BY_DIMENSION, MOST_OF_ONE, OWN = 256, 32, 8192.0, 1024
LIKELY = 16  # populations for which an animal is drawn at once
#: Rounds, in each of which animals whose draws are too few get more, and how many of them also
#: where halves of the draws agree in means, but not in likelihood.
ROUNDS, LATE = 6, 2
NOISE = 0.8  # sd in log-likelihood of all animals that halves of their draws may differ by
BLUR = 0.25  # of what animals leave open: populations that are narrower are not distinguished
FAR = 1.0  # nats that want of draws is made up for at the most
#: Independent populations that the weighted ones are to be worth with 40 000 draws of animals, with
#: many and with few.
EFFECTIVE, LEAST, MOST = 1000.0, 300.0, 4000.0
PASS = 2000  # populations of a pass
BLOCK = 100_000  # numbers of a table, which the cache holds
TOLERANCE, TROUBLE = 0.1, 0.2  # error of a mean in posterior sds: strived for, and too large


@dataclass(frozen=True)
class Site:
    """A normal stand-in G for the likelihood of an animal: its precision (E, E), and that times its
    mean (E,); ln G = −½ xᵀ precision x + shiftᵀ x."""

    precision: Array
    shift: Array

    @classmethod
    def of(cls, coordinates: Array, weights: Array, mean: Array, sd: Array) -> Site:
        """By the moments of draws of the posterior in a population (E,)."""
        x = (coordinates - mean) / sd
        middle = weights @ x
        off = x - middle
        whole = np.linalg.inv((off.T * weights) @ off + 1e-9 * np.eye(middle.size))
        value, vector = np.linalg.eigh(whole)
        # Where a posterior is as wide as its prior, the animal says nothing.
        precision = (vector * np.maximum(value - 1, 1e-3)) @ vector.T
        shift = (precision + np.eye(middle.size)) @ middle
        return cls(precision / np.outer(sd, sd), shift / sd + precision @ (mean / sd) / sd)

    def given(self, mean: Array, sd: Array) -> Component:
        """Centre and covariance of the animal in a population (E,)."""
        covariance = np.linalg.inv(self.precision + np.diag(sd**-2.0))
        covariance = 0.5 * (covariance + covariance.T)
        return Component(covariance @ (self.shift + mean / sd**2), covariance)

    def log_density(self, x: Array) -> Array:
        """ln G at coordinates (N, E)."""
        return np.asarray(x @ self.shift - 0.5 * ((x @ self.precision) * x).sum(axis=1))

    def log_integral(self, mean: Array, sd: Array) -> Array:
        """ln of the integral of G times the normal density of each population (M, E), (M,)."""
        slope = (self.shift - mean @ self.precision) * sd
        out = mean @ self.shift - 0.5 * ((mean @ self.precision) * mean).sum(axis=1)
        # Cholesky's rows of 1 + sd·precision·sd and its solution, for all populations at once.
        size = self.shift.size
        root: list[list[Array]] = []
        solved: list[Array] = []
        for i in range(size):
            row: list[Array] = []
            for j in range(i):
                entry = self.precision[i, j] * (sd[:, i] * sd[:, j])
                for k in range(j):
                    entry -= row[k] * root[j][k]
                row.append(entry / root[j][j])
            square = 1 + self.precision[i, i] * sd[:, i] ** 2
            rest = slope[:, i].copy()
            for k in range(i):
                square -= row[k] ** 2
                rest -= row[k] * solved[k]
            row.append(np.sqrt(square))
            root.append(row)
            solved.append(rest / row[i])
            out += 0.5 * solved[i] ** 2 - np.log(row[i])
        return np.asarray(out)


@dataclass(frozen=True)
class AnimalDraws:
    """Coordinates (N, E) of an animal, `at` (E,) of those of its hierarchy, ln of its likelihood
    and of their own density (N,), even and odd ones being of separate points; and a `site`.

    The likelihood in a population is the average of L/q times its density. The average of G/q, of
    the site in place of the likelihood, errs much alike, by draws that are few where a population
    is narrow, and its integral is known: their ratio times that integral is right to the little in
    which the site and the likelihood differ there.
    """

    at: Index
    coordinates: Array
    log_like: Array
    log_proposal: Array
    site: Site
    #: Those drawn from, each with the number of its draws; none where draws are not kept.
    mixtures: tuple[tuple[int, tuple[Component, ...]], ...] = ()

    @classmethod
    def of_mixture(
        cls,
        animal: Animal,
        mixture: Sequence[Component],
        count: int,
        site: Site,
        seed: Sequence[int],
    ) -> AnimalDraws:
        """About so many draws of a mixture of Student's t."""
        each = [
            weighted_draws(
                animal.log_likelihood, mixture, count // 2,
                SobolPoints(animal.at.size + 1, np.random.default_rng([*seed, half])),
            )
            for half in (0, 1)
        ]  # fmt: skip
        x = np.stack([one.values for one in each], axis=1).reshape(-1, animal.at.size)
        weight, proposal = (
            np.stack([getattr(one, name) for one in each], axis=1).reshape(-1)
            for name in ("log_weight", "log_proposal")
        )
        return cls(animal.at, x, weight + proposal, proposal, site, ((len(x), tuple(mixture)),))

    def joined(self, later: AnimalDraws) -> AnimalDraws:
        """These draws and later ones."""
        both = self._weighted.joined(later._weighted)
        return replace(
            later, coordinates=both.values, log_like=both.log_weight + both.log_proposal,
            log_proposal=both.log_proposal, mixtures=both.mixtures,
        )  # fmt: skip

    @property
    def _weighted(self) -> WeightedDraws:
        """Weighted by the likelihood."""
        log_weight = self.log_like - self.log_proposal
        return WeightedDraws(self.coordinates, log_weight, self.log_proposal, self.mixtures)

    def posterior(self, mean: Array, sd: Array) -> WeightedDraws:
        """The animal in one population (E,)."""
        log_prior = -0.5 * (((self.coordinates - mean) / sd) ** 2).sum(axis=1)
        log_weight = self.log_like + log_prior - self.log_proposal
        return WeightedDraws(self.coordinates, log_weight, self.log_proposal)

    def weights(self, mean: Array, sd: Array) -> Array:
        """Weights (N,) of sum 1 of the draws in one population (E,)."""
        return self.posterior(mean, sd).weights

    @cached_property
    def _site_scale(self) -> float:
        """By which ln G is to be raised for both to have the same highest value."""
        return float(self.log_like.max() - self.site.log_density(self.coordinates).max())

    @cached_property
    def _weighed(self) -> _Weighed:
        log_site = self.site.log_density(self.coordinates) + self._site_scale
        greater = np.maximum(self.log_like, log_site)
        x, rest = self.coordinates, np.ones((len(self.coordinates), 2))
        rest[:, 0] = greater - self.log_proposal
        most = float(rest[:, 0].max())
        rest[:, 0] -= most
        features = np.hstack([x**2, x, rest]).astype(np.float32)
        shares = np.exp(np.stack([self.log_like, log_site]) - greater).astype(np.float32)
        return _Weighed(features, shares[0], shares[1], most)

    def _densities(self, normals: Normals) -> NDArray[np.float32]:
        """Weight of each draw in each population, (N, M), but for a factor of each population."""
        mean, precision = normals.mean[:, self.at], normals.sd[:, self.at] ** -2.0
        rest = np.ones((len(mean), 2))
        rest[:, 1] = -0.5 * (precision * mean**2).sum(axis=1)
        weights = np.hstack([-0.5 * precision, precision * mean, rest]).astype(np.float32)
        table = self._weighed.features @ weights.T
        return np.asarray(np.exp(table, out=table))

    def by_population(self, normals: Normals) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Weights of the draws in each of some populations (N, m), a part of them at a time."""
        count, size = len(normals.mean), max(BLOCK // len(self.log_like), 1)
        for part in (slice(i, i + size) for i in range(0, count, size)):
            table = self._densities(normals.of(part))
            yield part, table * self._weighed.of_likelihood[:, None]

    def log_likelihood(self, normals: Normals) -> Array:
        """Of the animal in each population, by even and by odd draws, (2, M)."""
        count, size = len(normals.mean), max(BLOCK // len(self.log_like), 1)
        weighed = self._weighed
        shares = np.zeros((4, len(self.log_like)), dtype=np.float32)
        for half in (0, 1):
            shares[half, half::2] = weighed.of_likelihood[half::2]
            shares[2 + half, half::2] = weighed.of_site[half::2]
        sums = np.empty((4, count))
        for part in (slice(i, i + size) for i in range(0, count, size)):
            sums[:, part] = shares @ self._densities(normals.of(part))
        mean, sd = normals.mean[:, self.at], normals.sd[:, self.at]
        norm = 0.5 * self.at.size * np.log(2 * np.pi) + np.log(len(self.log_like) / 2)
        factors = weighed.most - norm - np.log(sd).sum(axis=1)
        log = np.log(np.maximum(sums, 1e-37)) + factors
        log_site = self.site.log_integral(mean, sd) + self._site_scale
        # Far from all draws neither average is right, and the site may be far too high.
        return np.asarray(log[:2] + np.minimum(log_site - log[2:], FAR))


class _Weighed(NamedTuple):
    """What sums over draws are made of.

    `features` (N, 2 E + 2) have ln of a weight, the greater of likelihood and site over the density
    of the draw and over its highest value, whose ln is `most`; `of_likelihood` and `of_site` (N,)
    are the shares of either in the greater.
    """

    features: NDArray[np.float32]
    of_likelihood: NDArray[np.float32]
    of_site: NDArray[np.float32]
    most: float


@dataclass(frozen=True)
class _Roughly:
    """The likelihood of an animal by its site alone, but for a factor."""

    animal: AnimalDraws

    def log_likelihood(self, normals: Normals) -> Array:
        """In each population, (1, M)."""
        at, site = self.animal.at, self.animal.site
        return site.log_integral(normals.mean[:, at], normals.sd[:, at])[None]


@dataclass(frozen=True)
class Population:
    """The posterior of a population and of its animals.

    `draws` are weighted populations, as vectors of scores of the `hierarchy`; `error` is that of a
    mean of theirs that the draws of animals leave, in posterior sds.
    """

    hierarchy: Hierarchy
    animals: tuple[AnimalDraws, ...]
    draws: WeightedDraws
    error: float

    @property
    def trouble(self) -> str:
        """Why the numbers are not to be relied on; empty where they are."""
        if self.error > TROUBLE:
            return f"the draws of animals leave an error of {self.error:.2g} posterior sds"
        if self.draws.effective < EFFECTIVE / 10:
            return f"its draws are worth only {self.draws.effective:.0f} independent ones"
        return ""

    @property
    def log_evidence(self) -> float:
        """ln of the probability of all answers."""
        return self.draws.log_evidence

    @cached_property
    def values(self) -> dict[str, Array]:
        """Every parameter of the population at the draws, by name."""
        return self.hierarchy.values(self.draws.values)

    def quantile(self, parameter: str, probability: ArrayLike) -> Array:
        """Posterior quantiles of a parameter of the population."""
        return weighted_quantiles(self.values[parameter], self.draws.weights, probability)

    def mean(self, parameter: str) -> float:
        """Posterior mean of a parameter of the population."""
        return float(self.draws.weights @ self.values[parameter])

    def sd(self, parameter: str) -> float:
        """Posterior standard deviation of a parameter of the population."""
        off = self.values[parameter] - self.mean(parameter)
        return float(np.sqrt(self.draws.weights @ off**2))

    @cached_property
    def typical(self) -> Normals:
        """The animals of populations of equal weight, drawn once and for all."""
        count = int(np.clip(DRAWS / len(self.animals), 500, 4000))
        return self.hierarchy.normals(self.draws.resampled(count, np.random.default_rng(0)))

    def animal_weights(self, number: int) -> Array:
        """Weights (N,) of sum 1 of the draws of an animal given the answers of all."""
        one = self.animals[number]
        total = np.zeros(len(one.log_like))
        for _, table in one.by_population(self.typical):
            total += table @ (1 / np.maximum(table.sum(axis=0), 1e-37))
        return total / total.sum()

    def animal_values(self, number: int) -> dict[str, Array]:
        """Parameters of an animal at its draws, each (N,), by name."""
        one = self.animals[number]
        return self.hierarchy.of_animal(one.coordinates, one.at)

    def given(self, scores: Array, rng: np.random.Generator) -> tuple[Array, dict[str, Array]]:
        """Of each animal in populations (M, D + S): log-likelihood of its answers, and a draw of
        its parameters by name, each (A, M); NaN where it lacks one."""
        normals, shape = self.hierarchy.normals(scores), (len(self.animals), len(scores))
        likelihood = np.empty(shape)
        drawn = {name: np.full(shape, np.nan) for name in self.hierarchy.names}
        for number, one in enumerate(self.animals):
            likelihood[number] = _average(one.log_likelihood(normals))
            named = self.animal_values(number)
            for part, table in one.by_population(normals):
                rise = np.cumsum(table, axis=0, dtype=np.float64)
                places = (rise < rng.random(rise.shape[1]) * rise[-1]).sum(axis=0)
                places = np.minimum(places, len(rise) - 1)
                for name, values in named.items():
                    drawn[name][number, part] = values[places]
        return likelihood, drawn


def integrate_population(
    animals: Sequence[Animal], hierarchy: Hierarchy, quick: bool = False
) -> Population:
    """The posterior of the population of some animals; a quick one is for evidence and medians."""
    points = SobolPoints(hierarchy.size + 1, 0)
    drawn = _unacquainted(animals, hierarchy.vague)
    hierarchy = hierarchy.blurred(_blur(drawn, hierarchy))
    draws = _populations(hierarchy, [_Roughly(one) for one in drawn], points, (), PASS / 4)
    most = BY_DIMENSION * np.array([animal.at.size for animal in animals]) ** 2
    least = max(FEWEST, ALL / len(animals))
    count = np.clip(np.minimum(most, DRAWS / len(animals)), least, MOST_OF_ONE)
    again = np.ones(len(animals), dtype=bool)
    for number in range(1 if quick else ROUNDS):
        likely = _likely(hierarchy, draws, number)
        for i in np.flatnonzero(again):
            drawn[i] = _redrawn(animals[i], drawn[i], likely, int(count[i]), (number, int(i)))
        if not number:  # sites are of likely populations now, and as good as free
            by_sites, mixture = [_Roughly(one) for one in drawn], fitted_components(draws)
            draws = _populations(hierarchy, by_sites, points, mixture, PASS / 4)
        draws = _populations(hierarchy, drawn, points, fitted_components(draws), PASS / 10)
        error, of_means, of_evidence = _errors(hierarchy, drawn, draws)
        # As shares of what each of so many animals may add.
        of_means *= np.sqrt(len(animals)) / TOLERANCE
        of_evidence *= np.sqrt(len(animals)) / NOISE
        # Where means are right, their evidence is not worth ten times the draws.
        if error < TOLERANCE and (number >= LATE or np.mean(of_evidence**2) < 1):
            break
        share = of_means if number >= LATE else np.maximum(of_means, of_evidence)
        again = share >= min(1.0, float(np.quantile(share, 0.8)))
        count[again] *= np.clip(share[again] ** 2, 2, 8)
        count = np.minimum(count, MOST_OF_ONE)
    if quick:
        return Population(hierarchy, tuple(drawn), draws, error)
    given = sum(len(one.log_like) for one in drawn)
    effective = float(np.clip(EFFECTIVE * 40_000 / given, LEAST, MOST))
    if draws.effective < effective:
        draws = _populations(hierarchy, drawn, points, fitted_components(draws), effective)
    likely = _likely(hierarchy, draws, ROUNDS)
    for i, one in enumerate(drawn):
        if len(one.log_like) < OWN:
            lacking = max(OWN - len(one.log_like), FEWEST)
            drawn[i] = _redrawn(animals[i], one, likely, lacking, (ROUNDS, i))
    return Population(hierarchy, tuple(drawn), draws, error)


def _blur(drawn: Sequence[AnimalDraws], hierarchy: Hierarchy) -> Array:
    """Sds between animals below which populations are not distinguished, (D,)."""
    width = np.full((len(drawn), len(hierarchy.names)), np.nan)
    for row, one in zip(width, drawn, strict=True):
        none = np.zeros(one.at.size)
        row[one.at] = np.sqrt(np.diag(one.site.given(none, hierarchy.vague.sd[one.at]).scale))
    return np.asarray(BLUR * np.nanmedian(width, axis=0))


def _likely(hierarchy: Hierarchy, draws: WeightedDraws, seed: int) -> Normals:
    """Some populations, with means in the middle and sds as if means were not known."""
    every = hierarchy.normals(draws.resampled(500, np.random.default_rng(seed)))
    middle, sd = every.mean.mean(axis=0), every.sd[:LIKELY]
    return Normals(np.broadcast_to(middle, sd.shape), np.hypot(sd, every.mean.std(axis=0)))


def _redrawn(
    animal: Animal, before: AnimalDraws, likely: Normals, count: int, seed: Sequence[int]
) -> AnimalDraws:
    """Draws of an animal in likely populations, with a site that fits there.

    Those of the posterior in a typical population, by the draws before, are among them: it may have
    modes that no site has.
    """
    means, sds = likely.mean[:, animal.at], likely.sd[:, animal.at]
    mean, sd = means.mean(axis=0), np.sqrt((sds**2).mean(axis=0))
    posterior = before.posterior(mean, sd)
    if posterior.effective < FIRST / 4:  # too few of what is known elsewhere count here
        posterior = _adapted(animal, mean, sd, seed, tempered_components(posterior, FIRST / 4))
    site = Site.of(posterior.values, posterior.weights, mean, sd)
    mixture = [site.given(*one) for one in zip(means, sds, strict=True)]
    mixture += fitted_components(posterior)
    drawn = AnimalDraws.of_mixture(animal, mixture, count, site, seed)
    if before.mixtures:
        drawn = before.joined(drawn)
    site = Site.of(drawn.coordinates, drawn.weights(mean, sd), mean, sd)
    return replace(drawn, site=site)


def _adapted(
    animal: Animal, mean: Array, sd: Array, seed: int | Sequence[int], mixture: Sequence[Component]
) -> WeightedDraws:
    """Draws of an animal in one population (E,), begun from a mixture or from the population."""

    def log_density(x: Array) -> Array:
        return np.asarray(animal.log_likelihood(x) - 0.5 * (((x - mean) / sd) ** 2).sum(axis=1))

    points = SobolPoints(sd.size + 1, np.random.default_rng(seed))
    return adapted_draws(
        log_density, mean, sd, points, effective=FIRST / 2, most=4 * FIRST, size=FIRST,
        mixture=mixture,
    )  # fmt: skip


def _unacquainted(animals: Sequence[Animal], vague: Normals) -> list[AnimalDraws]:
    """Draws of animals of a population of which nothing is known."""
    out: list[AnimalDraws] = []
    start: dict[bytes, Component] = {}
    for number, animal in enumerate(animals):
        mean, sd = vague.mean[animal.at], vague.sd[animal.at]
        parameters = animal.at.tobytes()
        begun = [start[parameters]] if parameters in start else []
        drawn = _adapted(animal, mean, sd, number, begun)
        site = Site.of(drawn.values, drawn.weights, mean, sd)
        log_like = animal.log_likelihood(drawn.values)
        out.append(AnimalDraws(animal.at, drawn.values, log_like, drawn.log_proposal, site))
        same = [one for one in out if np.array_equal(one.at, animal.at)]
        if len(same) == ALIKE:  # others will be much as these
            start[parameters] = _pooled([o.site.given(mean, sd) for o in same])
    return out


def _pooled(components: Sequence[Component]) -> Component:
    """One with the moments of all together."""
    centres = np.array([one.centre for one in components])
    between = np.cov(centres.T).reshape(centres.shape[1], -1)
    return Component(centres.mean(axis=0), np.mean([o.scale for o in components], axis=0) + between)


def _populations(
    hierarchy: Hierarchy,
    animals: Sequence[AnimalDraws | _Roughly],
    points: SobolPoints,
    mixture: Sequence[Component],
    effective: float,
) -> WeightedDraws:
    """Weighted populations, drawn first from the mixture or, without one, from the hyperpriors."""

    def log_density(scores: Array) -> Array:
        normals, total = hierarchy.normals(scores), hierarchy.log_prior(scores)
        for animal in animals:
            total = total + _average(animal.log_likelihood(normals))
        return total

    zero, one = np.zeros(hierarchy.size), np.ones(hierarchy.size)
    return adapted_draws(
        log_density, zero, one, points, effective=effective, size=PASS,
        most=4 * int(max(effective, PASS / 2)), mixture=mixture,
    )  # fmt: skip


def _average(halves: Array) -> Array:
    """ln of the mean of likelihoods by halves of the draws (n, M), as if draws were endless: the
    logarithm of a mean is too low by as much again as it is above the mean logarithm of halves."""
    whole = np.logaddexp.reduce(halves, axis=0) - np.log(len(halves))
    return np.asarray(whole + np.minimum(whole - halves.mean(axis=0), 0.3))


def _errors(
    hierarchy: Hierarchy, animals: Sequence[AnimalDraws], draws: WeightedDraws
) -> tuple[float, Array, Array]:
    """What halves of the animals' draws differ by: half of how far the means of populations are
    apart, in posterior sds, in the root mean square of all parameters; what each animal adds to
    that, about, and the sd of the difference in its log-likelihood, (A,) both."""
    scores = draws.resampled(1000, np.random.default_rng(0))
    normals, sd = hierarchy.normals(scores), scores.std(axis=0)
    halves = np.stack([animal.log_likelihood(normals) for animal in animals])
    log_weight = halves.sum(axis=0)
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    means = (weight @ scores) / weight.sum(axis=1, keepdims=True)
    error = float(np.sqrt(np.mean(((means[0] - means[1]) / sd) ** 2))) / 2
    differ = halves[:, 0] - halves[:, 1]
    differ -= differ.mean(axis=1, keepdims=True)
    pull = differ @ ((scores - scores.mean(axis=0)) / sd) / len(scores)
    return error, np.sqrt(np.mean(pull**2, axis=1)) / 2, differ.std(axis=1)
