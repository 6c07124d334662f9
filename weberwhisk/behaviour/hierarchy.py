"""How the parameters of animals differ: each is normal between animals, on a scale of its own.

ln k is normal, and so are the logits of lapses, a bias in sds of the difference, and each effect
(the logarithm of one that cannot be negative). A population is the mean and the sd of each; what is
believed of them are the *hyperpriors*: the median of a parameter has the prior that it has in a fit
of one animal, its sd between animals a half-normal one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logit
from scipy.stats import halfnorm

from .._util.values import Array, Index
from ..inference.coordinates import in_words
from .likelihood import WeberModel
from .posteriors import joint_lapses
from .priors import REACH, SPREAD, Priors, quantiles

__all__ = ["Animal", "Hierarchy", "Normals", "Scale", "scale_of", "spread_name"]

#: Parameters between 0 and 1.
PROPORTIONS = ("lapse_low", "lapse_high", "overdispersion")
LAPSES = ("lapse_low", "lapse_high")
#: Sd of the spread's half-normal prior over the sd of an animal's own prior, on the scale.
OF_PRIOR = 0.5


class Scale(NamedTuple):
    """Where a parameter is normal between animals: its name, the way there, and the way back."""

    name: str
    of: Callable[[Any], Array]
    back: Callable[[Any], Array]


SCALES = {
    "log": Scale("log", np.log, np.exp),
    "logit": Scale("logit", logit, expit),
    "identity": Scale("identity", np.asarray, np.asarray),
}


def scale_of(name: str, prior: Any) -> Scale:
    """The scale of a parameter with that prior."""
    if name in PROPORTIONS:
        return SCALES["logit"]
    positive = name == "weber_fraction" or float(prior.support()[0]) >= 0
    return SCALES["log" if positive else "identity"]


def spread_name(parameter: str) -> str:
    """What the sd of a parameter between animals is called.

    Examples
    --------
    >>> spread_name("weber_fraction"), spread_name("lapse_low"), spread_name("bias[2]")
    ('spread', 'lapse_spread', 'bias_spread')
    """
    if parameter == "weber_fraction":
        return "spread"
    return f"{'lapse' if parameter in LAPSES else parameter.partition('[')[0]}_spread"


class Normals(NamedTuple):
    """Normal distributions of animals in M populations: means and sds (M, D), coordinates being
    independent."""

    mean: Array
    sd: Array

    def of(self, which: slice) -> Normals:
        """Some of the populations."""
        return Normals(self.mean[which], self.sd[which])


@dataclass(frozen=True)
class Hierarchy:
    """The parameters of animals that are a population's, and what is believed of the population.

    A population is a vector of normal scores of the hyperpriors, (D + S,): the medians of the
    parameters `names` (D,), then the sds `spread_names` (S,), of which `spread_of` (D,) says which
    a parameter has: both lapses have one, and so have the biases of all standards. Two lapses of an
    animal differ from the population's alike, with the correlation of their prior; turned by 45°
    they are independent coordinates. No population is narrower than `blur` in these: where it is
    far below what any animal informs of, narrower ones are alike.
    """

    names: tuple[str, ...]
    priors: Priors
    spread_names: tuple[str, ...]
    spread_priors: tuple[Any, ...]
    spread_of: Index
    blur: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, models: Iterable[WeberModel], priors: Priors, spreads: Mapping[str, Any]
    ) -> Hierarchy:
        """Of animals with these models, and `spreads`: priors of sds by name, where stated."""
        names = tuple(dict.fromkeys(name for model in models for name in model.names))
        of = [spread_name(name) for name in names]
        spread_names = tuple(dict.fromkeys(of))
        first = {spread: name for name, spread in reversed([*zip(names, of, strict=True)])}
        chosen = [spreads.get(s) or _spread_prior(priors, first[s]) for s in spread_names]
        at = np.array([spread_names.index(spread) for spread in of], dtype=np.intp)
        return cls(names, priors, spread_names, tuple(chosen), at)

    @property
    def parameters(self) -> tuple[str, ...]:
        """All that is inferred of a population: each parameter's median, and its sd."""
        out: list[str] = []
        for name, at in zip(self.names, self.spread_of, strict=True):
            is_last = name == [n for n, s in zip(self.names, self.spread_of, strict=True)
                               if s == at][-1]  # fmt: skip
            out += [name, self.spread_names[at]] if is_last else [name]
        return tuple(out)

    @cached_property
    def scales(self) -> tuple[Scale, ...]:
        """The scale of each parameter."""
        return tuple(scale_of(name, self.priors.of(name)) for name in self.names)

    @property
    def size(self) -> int:
        """Entries of a population's vector."""
        return len(self.names) + len(self.spread_names)

    @cached_property
    def lapses(self) -> tuple[int, int] | None:
        """Where both lapses are, if both are inferred."""
        if set(LAPSES) <= set(self.names):
            return self.names.index(LAPSES[0]), self.names.index(LAPSES[1])
        return None

    @property
    def correlation(self) -> float:
        """Of the two lapses of an animal."""
        return self.priors.lapse_correlation if self.lapses else 0.0

    def turned(self, x: Array) -> Array:
        """Values on the scales (..., D) as coordinates that are independent between animals, or
        back: it is its own inverse."""
        if self.lapses is None:
            return x
        (low, high), out = self.lapses, np.array(x, dtype=float)
        out[..., low] = (x[..., low] + x[..., high]) / np.sqrt(2)
        out[..., high] = (x[..., low] - x[..., high]) / np.sqrt(2)
        return out

    def of_animal(self, coordinates: Array, at: Index) -> dict[str, Array]:
        """Parameters by name, each (N,), of an animal with those `at`, by coordinates (N, E)."""
        whole = np.zeros((len(coordinates), len(self.names)))
        whole[:, at] = coordinates
        turned = self.turned(whole)
        return {self.names[i]: self.scales[i].back(turned[:, i]) for i in at}

    def values(self, scores: Array) -> dict[str, Array]:
        """Medians and sds of populations (M, D + S), each (M,), by name."""
        clipped = np.clip(scores, -REACH, REACH)
        out = {name: self.priors.value(name, clipped[:, i]) for i, name in enumerate(self.names)}
        for i, (name, prior) in enumerate(zip(self.spread_names, self.spread_priors, strict=True)):
            out[name] = quantiles(prior)(clipped[:, len(self.names) + i])
        return {name: out[name] for name in self.parameters}

    def normals(self, scores: Array) -> Normals:
        """The coordinates of animals in populations (M, D + S)."""
        values = self.values(scores)
        means = [s.of(values[n]) for n, s in zip(self.names, self.scales, strict=True)]
        sds = [values[self.spread_names[at]] for at in self.spread_of]
        sd = np.stack(sds, axis=-1)
        if self.lapses:
            rho = self.correlation
            sd[:, self.lapses[0]] *= np.sqrt(1 + rho)
            sd[:, self.lapses[1]] *= np.sqrt(1 - rho)
        sd = np.maximum(sd, np.array(self.blur or 0.0))
        return Normals(self.turned(np.stack(means, axis=-1)), sd)

    @cached_property
    def score_precision(self) -> Array:
        """Precision of the scores under the hyperpriors."""
        covariance = np.eye(self.size)
        if self.lapses:
            low, high = self.lapses
            covariance[low, high] = covariance[high, low] = self.correlation
        return np.asarray(np.linalg.inv(covariance))

    def log_prior(self, scores: Array) -> Array:
        """Log density of the scores, (M,)."""
        precision = self.score_precision
        norm = 0.5 * np.linalg.slogdet(precision)[1] - 0.5 * self.size * np.log(2 * np.pi)
        return np.asarray(norm - 0.5 * np.einsum("mi,ij,mj->m", scores, precision, scores))

    def drawn(self, count: int, rng: np.random.Generator) -> Array:
        """Populations from the hyperpriors, (count, D + S)."""
        root = np.linalg.cholesky(np.linalg.inv(self.score_precision))
        return np.asarray(rng.standard_normal((count, self.size)) @ root.T)

    def log_densities(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Log hyperprior density of each parameter at values by name, (M,); that of two lapses is
        joint, "lapses"."""
        spreads = dict(zip(self.spread_names, self.spread_priors, strict=True))
        out: dict[str, Array] = {}
        for name, at in values.items():
            if name in spreads:
                out[name] = spreads[name].logpdf(at)
            elif self.lapses and name in LAPSES:
                out["lapses"] = joint_lapses(self.priors, *(values[n] for n in LAPSES))
            else:
                out[name] = self.priors.log_density(name, at)
        return out

    def prior_in_words(self, name: str) -> str:
        """The hyperprior of a parameter."""
        if name in self.spread_names:
            return in_words(self.spread_priors[self.spread_names.index(name)])
        return self.priors.words(name)

    @property
    def in_words(self) -> str:
        """What is normal between animals, in a clause."""
        said = {"log": "ln {}", "logit": "the logit of {}", "identity": "{}"}
        each = [
            said[scale.name].format("k" if name == "weber_fraction" else name)
            for name, scale in zip(self.names, self.scales, strict=True)
        ]
        if len(each) == 1:
            return f"{each[0]} is normal between animals"
        return f"{', '.join(each[:-1])} and {each[-1]} are normal between animals"

    def blurred(self, blur: Array) -> Hierarchy:
        """The same with populations that are no narrower than that in any coordinate (D,)."""
        return replace(self, blur=tuple(blur.tolist()))

    @cached_property
    def vague(self) -> Normals:
        """The coordinates of an animal of which nothing is known, as one normal (D,)."""
        mean, sd = [], []
        for name, scale, at in zip(self.names, self.scales, self.spread_of, strict=True):
            centre, width = _on_scale(self.priors.of(name), scale)
            mean.append(centre)
            between = self.spread_priors[at].ppf(np.linspace(0.05, 0.95, 19))
            sd.append(np.hypot(width, np.sqrt(np.mean(np.square(between)))))
        return Normals(self.turned(np.array(mean)), np.array(sd))


def _on_scale(prior: Any, scale: Scale) -> tuple[float, float]:
    """Median and sd of a prior on a scale, by its middle two thirds."""
    low, middle, high = scale.of(np.asarray(prior.ppf([1 / 6, 0.5, 5 / 6])))
    return float(middle), float(high - low) / 1.935


def _spread_prior(priors: Priors, parameter: str) -> Any:
    """The default prior of the sd of a parameter between animals."""
    if parameter == "weber_fraction":
        return SPREAD
    prior = priors.of(parameter)
    width = _on_scale(prior, scale_of(parameter, prior))[1]
    return halfnorm(scale=float(f"{OF_PRIOR * width:.2g}"))


@dataclass(frozen=True)
class Animal:
    """The likelihood of one animal by the coordinates of a hierarchy: those at `at`, as one whose
    trials have not all standards lacks the biases of others."""

    model: WeberModel
    hierarchy: Hierarchy
    at: Index

    @classmethod
    def of(cls, model: WeberModel, hierarchy: Hierarchy) -> Animal:
        """An animal by its model."""
        at = np.array([hierarchy.names.index(name) for name in model.names], dtype=np.intp)
        return cls(model, hierarchy, at)

    def log_likelihood(self, coordinates: Array) -> Array:
        """Log-probability of the animal's answers, (N,)."""
        model, values = self.model, self.hierarchy.of_animal(coordinates, self.at)
        count = len(coordinates)

        def of(names: Sequence[str]) -> Array:
            columns = [
                values[n] if n in values else np.full(count, model.fixed_value(n)) for n in names
            ]
            return np.stack(columns, axis=-1) if columns else np.zeros((count, 0))

        lead = of(model.lead)
        k, effects, low, high = lead[:, 0], lead[:, 1:-2], lead[:, -2], lead[:, -1]
        bias = of(model.group_names) if model.free_bias else np.full(
            (count, model.n_groups), model.fixed_bias())  # fmt: skip
        with np.errstate(invalid="ignore", over="ignore"):
            out = model.log_likelihood(k, low, high, bias, effects)
        possible = sum(model.lapses(low, high)) < 1
        return np.where(possible & np.isfinite(out), out, -np.inf)
