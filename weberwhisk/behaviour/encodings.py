"""How a stimulus is encoded: the mean of its signal, and its noise per unit Weber fraction.

An encoding is the only thing a fit knows about a stimulus. Anything with the four members of
`Encoding` will do; the whisker enters through `CueEncoding` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .._util import checks
from .._util.refusals import Refusal, argument, named
from .._util.values import Array, Fields, Flags, Index
from ..mechanics import flick_past
from .cue_encoding import CueEncoding, PooledEncoding

__all__ = [
    "NOISES", "ConstantNoise", "Encoding", "IdentityEncoding", "LogAxisEncoding", "LogEncoding",
    "ReplacedNoise", "Signals", "UnitEncodings", "checked_encoding", "chosen_encoding",
    "condensed", "described",
    "encoding_for", "gives_signal", "in_words", "nodes_of", "refuse_out_of_reach",
    "refuse_outside", "refuse_unencoded", "unit_encodings", "with_noise",
]  # fmt: skip


NOISES = ("weber", "equal-variance", "constant")


class Encoding(Protocol):
    """How a stimulus is encoded: what every observer model asks of it.

    One whose noise does not all scale with the Weber fraction also has `floor_sd(stimulus)`, the
    sd of the rest.
    """

    @property
    def direction(self) -> int:
        """+1 where a greater stimulus gives a greater signal, −1 where it gives a smaller one."""

    @property
    def domain(self) -> tuple[float, float]:
        """The stimuli that give a signal, (lowest, highest), in the stimulus's own unit."""

    def mean(self, stimulus: ArrayLike) -> Array:
        """Mean signal at each stimulus."""

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        """Noise sd of the signal at each stimulus, for a Weber fraction of 1."""


@dataclass(frozen=True, repr=False)
class IdentityEncoding(Fields):
    """The magnitude itself, with sd = k × magnitude (Weber noise); any unit, all above zero.

    Examples
    --------
    >>> IdentityEncoding().sd_per_weber_fraction([1.0, 2.0])
    array([1., 2.])
    """

    direction: int = 1
    domain: tuple[float, float] = (0.0, np.inf)

    def mean(self, stimulus: ArrayLike) -> Array:
        return np.asarray(stimulus, dtype=float)

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        return np.asarray(stimulus, dtype=float)


@dataclass(frozen=True, repr=False)
class LogEncoding(Fields):
    """A stimulus given by its logarithm: the signal is its magnitude, exp(log_unit × column).

    Its sd is k × magnitude; `LogAxisEncoding` has the logarithm itself for a signal, with one sd.
    An additive constant in the column cancels: ratios of magnitudes alone matter to either.

    Parameters
    ----------
    log_unit : float
        Natural-log units in one unit of the column: 1 for natural logs, ln 10 for decades,
        ln(10)/20 for the amplitude of a level in decibels.

    Examples
    --------
    >>> LogEncoding().mean([0.0, 0.0])
    array([1., 1.])
    """

    log_unit: float = 1.0
    direction: int = 1
    domain: tuple[float, float] = (-np.inf, np.inf)

    def __post_init__(self) -> None:
        checks.positive("log_unit", self.log_unit, "give natural-log units per unit of the column")

    def mean(self, stimulus: ArrayLike) -> Array:
        return np.exp(self.log_unit * np.asarray(stimulus, dtype=float))

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        return self.mean(stimulus)


@dataclass(frozen=True, repr=False)
class LogAxisEncoding(LogEncoding, Fields):
    """The logarithm itself, with one sd everywhere: the textbook equal-variance form.

    With `log_unit = 1` the Weber fraction is counted *per unit of the column*: the choice left when
    that unit is unknown, and the limit of `LogEncoding` for steps small against a natural-log unit.

    Examples
    --------
    >>> LogAxisEncoding().sd_per_weber_fraction([-1.0, 1.0])
    array([1., 1.])
    """

    def mean(self, stimulus: ArrayLike) -> Array:
        return self.log_unit * np.asarray(stimulus, dtype=float)

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        return np.ones_like(np.asarray(stimulus, dtype=float))


@dataclass(frozen=True)
class ReplacedNoise:
    """An encoding with the signals of `base`, and another noise."""

    base: Encoding

    @property
    def direction(self) -> int:
        return self.base.direction

    @property
    def domain(self) -> tuple[float, float]:
        return self.base.domain

    def mean(self, stimulus: ArrayLike) -> Array:
        return self.base.mean(stimulus)


@dataclass(frozen=True)
class ConstantNoise(ReplacedNoise):
    """An encoding whose noise is the same at every stimulus: sd = k × typical, against Weber's law.

    `typical` is a signal of middling strength, so that k remains a fraction.

    Examples
    --------
    >>> ConstantNoise(IdentityEncoding(), 2.0).sd_per_weber_fraction([1.0, 4.0])
    array([2., 2.])
    """

    typical: float

    def sd_per_weber_fraction(self, stimulus: ArrayLike) -> Array:
        return np.full(np.shape(stimulus), self.typical)

    @property
    def described(self) -> str:
        return f"{described(self.base)}, with the same noise at every stimulus"


#: Encodings of a distance in metres, or in units of so many.
OF_DISTANCE = (CueEncoding, PooledEncoding)


def described(encoding: Encoding) -> str:
    """What an encoding is, in words."""
    return str(getattr(encoding, "described", type(encoding).__name__))


def chosen_encoding(encoding: Encoding | None, observer: Any) -> Encoding | None:
    """The encoding given, directly or as an observer; None where there is neither."""
    if encoding is not None and observer is not None:
        raise Refusal("encoding and observer were both given", remedy="give one of them")
    if observer is not None:
        return CueEncoding(observer)
    if encoding is not None:
        checked_encoding(encoding)
    return encoding


def checked_encoding(encoding: Any) -> None:
    """Refuse what is no `Encoding`."""
    hint = "write ww.behaviour.IdentityEncoding(), say"
    checks.kind("encoding", encoding, "an Encoding", "sd_per_weber_fraction", hint)


def gives_signal(encoding: Encoding, stimulus: ArrayLike) -> Flags:
    """Whether each stimulus has a signal, and noise."""
    sd = encoding.sd_per_weber_fraction(stimulus)
    return np.asarray(np.isfinite(encoding.mean(stimulus)) & np.isfinite(sd))


def refuse_outside(encoding: Encoding, stimulus: ArrayLike) -> None:
    """Refuse stimuli that no observer can encode, such as negative magnitudes."""
    stimuli, (low, high) = np.ravel(np.asarray(stimulus, dtype=float)), encoding.domain
    outside = ~((stimuli > low) & (stimuli < high))
    if outside.any():
        raise Refusal(
            f"stimulus {stimuli[outside][0]:g} lies outside what can be encoded, {low:g} to "
            f"{high:g}",
            remedy="choose other standards or comparisons",
        )


def refuse_unencoded(encoding: Encoding, stimulus: ArrayLike) -> None:
    """Refuse stimuli that give no signal: the first, how many there are, and why."""
    levels = np.unique(np.asarray(stimulus, dtype=float))
    encoded = gives_signal(encoding, levels)
    if encoded.all():
        return
    first = float(levels[~encoded][0])
    why = f" ({encoding.outcome(first)})" if isinstance(encoding, OF_DISTANCE) else ""
    raise Refusal(
        f"{int((~encoded).sum())} of {levels.size} stimuli give no signal, the first being "
        f"{first:g}{why}",
        remedy="leave those trials out, or change the whisker or the cue",
    )


def refuse_out_of_reach(encoding: Encoding, stimulus: ArrayLike, name: str = "stimulus") -> None:
    """Refuse what the whisker cannot reach, past its tip, past its base, or flicked past: the
    farthest offender, and by how much it is off."""
    at = np.atleast_1d(checks.numbers(name, stimulus, "give one, or several"))
    if not at.size:
        raise Refusal(f"a {name} is needed", "none", "give one, or several")
    if not isinstance(getattr(encoding, "base", encoding), OF_DISTANCE):
        refuse_outside(encoding, at)
    low, high = encoding.domain

    def said(value: float) -> str:
        return in_words(encoding, value)

    if at.max() >= high:
        raise Refusal(
            f"{name} {said(at.max())} is off the whisker, by {said(at.max() - high)} past its "
            f"tip at {said(high)}",
            remedy="stay well inside",
        )
    if at.min() <= low:
        raise Refusal(
            f"{name} {said(at.min())} is off the whisker, by {said(low - at.min())} before its "
            f"base at {said(low)}",
            remedy="stay well inside",
        )
    encoded = gives_signal(encoding, at)
    if encoded.all():
        return
    worst, limit, angle = float(at[~encoded].max()), np.nan, np.nan
    why = encoding.outcome(worst) if isinstance(encoding, OF_DISTANCE) else "it gives no signal"
    if isinstance(encoding, CueEncoding) and encoding.deflection_angle is not None:
        whisker, unit = encoding.observer.whisker, encoding.unit
        angle = np.degrees(encoding.deflection_angle)
        limit = np.degrees(float(flick_past(whisker, worst * unit).deflection_angle))
    if not limit < angle:  # NaN also beyond a curved whisker's reach
        raise Refusal(
            f"{name} {said(worst)} cannot be encoded: {why}", remedy="choose another distance"
        )
    grid = np.linspace(0.01, 0.999, 400) * high
    inside = grid[np.degrees(flick_past(whisker, grid * unit).deflection_angle) > angle]
    farthest = f"stay within {said(float(inside.max()))}, or " if inside.size else ""
    raise Refusal(
        f"{name} {said(worst)} is flicked past: the whisker holds {limit:.3g}° there and "
        f"contacts are at {angle:.3g}°, {angle - limit:.2g}° too much",
        remedy=f"{farthest}press less",
    )


def in_words(encoding: Encoding, length: float) -> str:
    """A stimulus with its unit: millimetres where it is a distance along a whisker."""
    if not isinstance(encoding, OF_DISTANCE):
        return f"{length:.4g}"
    return f"{1e3 * encoding.unit * length:.4g} mm"


class UnitEncodings(NamedTuple):
    """The two encoded stimuli of each cell, a greater stimulus giving a greater mean; arrays (C,).

    The sds are for a Weber fraction of 1; floors do not go with it, and add in variance. `spread`
    is the variance that an error of the measured places leaves in the difference of the means: the
    experimenter's ignorance, which is no noise of the animal.
    """

    mean_1: Array
    sd_1: Array
    mean_2: Array
    sd_2: Array
    floor_1: ArrayLike = 0.0
    floor_2: ArrayLike = 0.0
    spread: ArrayLike = 0.0

    def encoded(self, weber_fraction: ArrayLike) -> Signals:
        """Both signals with the noise of an observer, (..., C) for a Weber fraction (...)."""
        k = np.asarray(weber_fraction, dtype=float)[..., None]
        sd_1, sd_2 = k * self.sd_1, k * self.sd_2
        if self.has_floor:
            sd_1, sd_2 = np.hypot(sd_1, self.floor_1), np.hypot(sd_2, self.floor_2)
        shown = {"shown_1": self.mean_1, "shown_2": self.mean_2}
        return Signals(self.mean_1, sd_1, self.mean_2, sd_2, **shown)

    @property
    def has_floor(self) -> bool:
        """Whether any noise is left at a Weber fraction of nothing."""
        return bool(np.any(self.floor_1) or np.any(self.floor_2))

    @property
    def has_spread(self) -> bool:
        """Whether any place was measured, with an error."""
        return bool(np.any(self.spread))

    def of(self, which: Flags | Index) -> UnitEncodings:
        """Some of the cells."""
        return UnitEncodings(*(np.broadcast_to(a, self.mean_1.shape)[which] for a in self))


class Signals(NamedTuple):
    """The two noisy signals of each cell: means and sds, and a shift towards "second greater".

    `shift` adds to the decision variable, in its sds. `shown_1` and `shown_2` are the means before
    any effect, by which noise goes. Arrays that broadcast to (..., C).
    """

    mean_1: Array
    sd_1: Array
    mean_2: Array
    sd_2: Array
    shift: Array | float = 0.0
    shown_1: Array | float = np.nan
    shown_2: Array | float = np.nan


def unit_encodings(
    encoding: Encoding,
    stimulus_1: ArrayLike,
    stimulus_2: ArrayLike,
    standard: ArrayLike,
    noise: str = "weber",
) -> UnitEncodings:
    """Both encoded stimuli of every cell, (C,), in the stimulus's own unit.

    With "weber" noise each interval has the sd of its own stimulus, as a receptor has;
    "equal-variance" is the textbook form, where both have the sd of the standard; with "constant"
    noise all have the sd of a typical stimulus.
    """
    encoding = with_noise(encoding, noise, (stimulus_1, stimulus_2))
    s1, s2, s0 = np.broadcast_arrays(
        *(np.asarray(s, float) for s in (stimulus_1, stimulus_2, standard))
    )
    sign = encoding.direction
    if noise != "equal-variance":
        sd_1, sd_2 = encoding.sd_per_weber_fraction(s1), encoding.sd_per_weber_fraction(s2)
    else:
        sd_1 = sd_2 = encoding.sd_per_weber_fraction(s0)
    means = sign * encoding.mean(s1), sign * encoding.mean(s2)
    floor_sd: Any = getattr(encoding, "floor_sd", None)
    at = ((s0, s0) if noise == "equal-variance" else (s1, s2)) if floor_sd else ()
    return UnitEncodings(means[0], sd_1, means[1], sd_2, *map(floor_sd, at))


def with_noise(encoding: Encoding, noise: str, stimuli: tuple[ArrayLike, ArrayLike]) -> Encoding:
    """The encoding, whose noise is the same at every stimulus where it is to be "constant": that of
    the geometric mean of the signals of pairs of stimuli."""
    checks.one_of("noise", noise, NOISES)
    if noise != "constant" or isinstance(encoding, ConstantNoise | LogAxisEncoding):
        return encoding
    signals = np.abs(encoding.mean(np.concatenate([np.ravel(s) for s in stimuli])))
    if not signals.size:
        return encoding
    if np.any(signals == 0):
        raise Refusal(
            argument("noise", noise) + " is in units of a typical signal, a geometric mean",
            "a signal of 0",
            "leave these trials out, or " + named("noise"),
        )
    return ConstantNoise(encoding, float(np.exp(np.mean(np.log(signals)))))


def encoding_for(scale: str, log_unit: float | None, noise: str) -> Encoding:
    """The encoding a table of magnitudes calls for, when no whisker stands between."""
    checks.one_of("noise", noise, NOISES)
    if scale == "linear":
        return IdentityEncoding()
    if log_unit is None or noise == "equal-variance":
        return LogAxisEncoding(1.0 if log_unit is None else log_unit)
    return LogEncoding(log_unit)


def condensed(
    decision_sd: Callable[[Signals], Array],
    pairs: UnitEncodings,
    n: Array,
    count: Array,
    group: Index,
) -> tuple[UnitEncodings, Array, Array, Index]:
    """Pairs, trials, answers and groups of nodes that stand for those given, (C,), where the task
    has its `decision_sd`: many different stimuli as a few quadrature nodes.

    A log-likelihood is a sum over trials of a smooth function of the decision variable D of a Weber
    fraction of 1, one function for each answer. Within a narrow bin of D such a sum is that over
    three Gaussian nodes with the same moments up to the fifth: what is lost is of sixth order in
    the width of the bin. The cost of a fit then does not grow with the number of different stimuli.
    Measured places add a variance to D, by which trials are binned too.
    """
    sd = decision_sd(pairs.encoded(np.float64(1.0)))
    d, ratio = (pairs.mean_2 - pairs.mean_1) / sd, pairs.sd_2 / pairs.sd_1
    variance = np.broadcast_to(np.asarray(pairs.spread, dtype=float) / sd**2, d.shape)
    parts = [nodes_of(d, some, group, variance, ratio) for some in (count, n - count)]
    d, weight, variance, ratio = (np.concatenate([p[i] for p in parts]) for i in range(4))
    given = np.where(np.arange(d.size) < parts[0][0].size, weight, 0.0)
    unit = UnitEncodings(np.zeros(d.size), np.ones(d.size), ratio, ratio)
    sd = decision_sd(unit.encoded(np.float64(1.0)))
    fewer = unit._replace(mean_2=sd * d, spread=sd**2 * variance)
    return fewer, weight, given, np.concatenate([p[4] for p in parts])


def nodes_of(
    d: Array, weight: Array, group: Index, variance: Array, ratio: Array
) -> tuple[Array, Array, Array, Array, Index]:
    """Nodes (N,) with weights, mean variances and ratios of the two sds, and groups, for weights at
    d (C,) in groups.

    Examples
    --------
    >>> d = np.linspace(0.1, 0.12, 500)
    >>> at, n, *_ = nodes_of(d, np.ones(500), np.zeros(500, int), np.zeros(500), np.ones(500))
    >>> at.size, bool(abs(n @ np.exp(at) - np.exp(d).sum()) < 1e-9)
    (3, True)
    """
    used = weight > 0
    d, weight, variance, ratio = (a[used] for a in (d, weight, variance, ratio))
    group = group[used]
    smallest = 3e-3  # Weber fraction below which bins about zero are not narrower
    # Bins are half a unit wide in asinh(D/smallest), half of D far from zero, and ln variance.
    place = np.floor(2 * np.arcsinh(d / smallest)).astype(np.intp)
    level = np.floor(4 * np.log(np.maximum(variance, smallest**2))).astype(np.intp)
    keys, row = np.unique(np.stack([group, place, level]), axis=1, return_inverse=True)
    row = row.reshape(-1)
    count = keys.shape[1]

    def total(values: Array) -> Array:
        return np.bincount(row, weight * values, count).astype(float)

    # In each bin's own coordinate the polynomials orthogonal under the weights (Stieltjes), and
    # the nodes as eigenvalues of their recurrence (Golub & Welsch 1969).
    mass = total(np.ones(d.size))
    middle = total(d) / mass
    scale = np.sqrt(total((d - middle[row]) ** 2) / mass) + 1e-300
    x = np.where(scale[row] > 1e-9 * np.abs(middle[row]), (d - middle[row]) / scale[row], 0.0)
    jacobi = np.zeros((count, 3, 3))
    before, now, norm = np.zeros(d.size), np.ones(d.size), mass
    b = np.zeros(count)
    for i in range(3):
        real = norm > 1e-10 * mass  # of one or two different values there are no more polynomials
        a = np.divide(total(x * now**2), norm, where=real, out=np.zeros(count))
        jacobi[:, i, i] = a
        before, now = now, (x - a[row]) * now - b[row] * before
        rest = total(now**2)
        b = np.divide(rest, norm, where=real, out=np.zeros(count))
        b[rest < 1e-10 * mass] = 0.0
        if i < 2:
            jacobi[:, i, i + 1] = jacobi[:, i + 1, i] = np.sqrt(b)
        norm = rest
    value, vector = np.linalg.eigh(jacobi)
    share = vector[:, 0] ** 2
    at, weights = middle[:, None] + scale[:, None] * value, mass[:, None] * share
    kept = share > 1e-12
    by_bin = total(variance) / mass, total(ratio) / mass, keys[0]
    others = [np.repeat(a, 3)[kept.ravel()] for a in by_bin]
    return at[kept], weights[kept], others[0], others[1], others[2]
