"""Contacts in coordinates without edges: the change of variables of every posterior.

Radial distance and deflection angle are bounded, by the tip and by the angle at which the whisker
flicks past; any further unknown has a prior alone. Posteriors are explored in x, in which there
are no bounds: `constrain` carries x to the contact, `unconstrain` back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logit, ndtr, ndtri, wrightomega

from .._util.checks import one_of, shown
from .._util.refusals import Refusal
from .._util.values import Array, Index, distinct
from ..cues.protocol import Cue
from ..mechanics.forward import ForwardModel, forward_of
from ..whisker import Whisker

#: Of an unknown's moments and quantiles; a stiffness over the whisker's own is a ratio.
UNITS = {
    "radial_distance": "m", "side": "m", "deflection_angle": "rad", "bearing": "rad",
    "azimuth": "rad", "friction_angle": "rad", "surface_tilt": "rad", "angular_velocity": "rad/s",
    "curvature_offset": "1/m", "hinge_stiffness": "N m/rad", "roll": "rad",
}  # fmt: skip

#: Of signals, by the end or beginning of their names; the first that fits.
_SIGNAL_UNITS = (
    (r"_(angle|direction)$|^azimuth", "rad"), (r"^angular_velocity", "rad/s"),
    (r"^moment_rate", "N m/s"), (r"^moment|_amplitude$", "N m"), (r"force", "N"),
)  # fmt: skip


def signal_unit(name: str) -> str:
    """The unit of a signal of a cue; "1" for a ratio, a probability or a count.

    Examples
    --------
    >>> signal_unit("moment_2"), signal_unit("force_direction"), signal_unit("mode_2_ratio")
    ('N m', 'rad', '1')
    """
    plain = re.sub(r"_\d+$", "", name)  # of several with one name
    return next((unit for form, unit in _SIGNAL_UNITS if re.search(form, plain)), "1")


#: x₁ at the ends of the reach, as far as numbers go: the fraction 1e-32 and its mirror image.
FARTHEST = 5.0


@dataclass(frozen=True, eq=False)
class ContactCoordinates:
    """The bijection between the contacts open to an observer and x in ℝᵁ.

    Supports of the `prior`, of frozen SciPy distributions by name, bound distance and angle
    further; each unknown that the whisker does not bound needs one. The first `bounded` unknowns
    are those that the whisker bounds; `reach` has the ends of the radial distance, m, between which
    some deflection angle is open: where the largest comes down to the least that a prior has,
    distances end.

    x₁ = asinh(logit(r/reach)), in which base and tip lie double-exponentially far off, and x₂ = y +
    ln(M/θ_d), with M the small-angle moment and logistic(y + eʸ) the fraction of the largest θ_d at
    that r. Down low x₂ is ln M, up high it closes in on the fold or the tip double-exponentially.
    So the tails of posteriors are short, and the force map's ridge, along which M is constant, is
    straight. Any further unknown has a coordinate in which its prior is the standard normal.
    """

    whisker: Whisker
    cue: Cue
    prior: Mapping[str, Any]
    bounded: int = field(init=False)
    reach: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        further = self.cue.unknowns[2 if "deflection_angle" in self.cue.unknowns else 1 :]
        values = {
            "bounded": len(self.cue.unknowns) - len(further),
            "reach": self._range("radial_distance", self.cue.farthest(self.whisker)),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if self.is_wedge:
            object.__setattr__(self, "reach", self.open_reach())

    @property
    def is_wedge(self) -> bool:
        """Whether the range of angles closes at a distance: its prior begins above 0."""
        return self.bounded > 1 and self._least_angle > 0

    @property
    def _least_angle(self) -> float:
        given = "deflection_angle" in self.prior
        return self._range("deflection_angle", np.pi)[0] if given else 0.0

    def open_reach(self, further: Sequence[float] = ()) -> tuple[float, float]:
        """The ends of the distances at which some deflection angle is open, m.

        With the values (F,) of unknowns that have priors alone, or of the widest range there is.
        """
        ends = self.reach
        # Of the lower and of the upper end: distances between which it is.
        brackets = np.array([ends, ends])
        for _ in range(6):  # to rounding
            r = np.linspace(brackets[:, 0], brackets[:, 1], 258)
            contact = np.broadcast_to([0.0, 0.0, *further], (r.size, 2 + len(further))).copy()
            contact[:, 0] = r.ravel()
            width = self.angle_range(contact[:, 0], contact)[1].reshape(r.shape)
            open_ = [np.flatnonzero(w > 0) for w in width.T]
            if not all(o.size for o in open_):
                return ends  # there is no contact at all
            first, last = open_[0][0], open_[1][-1]
            brackets = np.array(
                [[r[max(first - 1, 0), 0], r[first, 0]], [r[last, 1], r[min(last + 1, 257), 1]]]
            )
        return float(brackets[0, 0]), float(brackets[1, 1])

    def _range(self, name: str, top: float) -> tuple[float, float]:
        low, high = self.prior[name].support() if name in self.prior else (0.0, np.inf)
        low, high = max(float(low), 0.0), min(float(high), top)
        if not low < high:
            raise Refusal(
                f"The prior of {name} has no overlap with what this whisker can reach",
                f"{low:g} and more where the reach ends at {top:g}",
                "give it in m (rad for angles)",
            )
        return low, high

    def constrain(self, x: ArrayLike, further: Sequence[Any] | None = None) -> tuple[Array, Array]:
        """The contact (..., U) at x (..., U), and ln of its prior density in x (...).

        Of the first unknowns alone where x has fewer; where `further` has the values of the others,
        the density is that of the first unknowns given them. Flat priors count as the density 1 of
        the contact, so that theirs is ln |d contact/dx|.
        """
        x = np.asarray(x, dtype=float)
        low, high = self.reach
        out = np.empty((*x.shape[:-1], x.shape[-1] + len(further or ())))
        for i, value in enumerate(further or (), x.shape[-1]):
            out[..., i] = value
        for i in range(self.bounded, x.shape[-1]):
            out[..., i] = from_normal(self.prior[self.cue.unknowns[i]], x[..., i])
        fraction, log_prior = constrain_distance(x[..., 0])
        # Rounding must not put a contact on an edge, where there is none.
        out[..., 0] = np.clip(
            low + (high - low) * fraction, np.nextafter(low, high), np.nextafter(high, low)
        )
        log_prior += np.log(high - low)
        if self.bounded > 1:
            if further and x.shape[-1] == self.bounded:
                # Cells of a tree stand in columns of one distance, and ranges in space are dear.
                more = [np.ravel(value) for value in further]
                (r, *more), back = distinct(out[..., 0].ravel(), *more)
                low_angle, width = self.angle_range(r, np.column_stack([r, 0 * r, *more]))
                width = width[back].reshape(out.shape[:-1])
            else:
                low_angle, width = self.angle_range(out[..., 0], out)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                y = x[..., 1] - self._log_gain(out[..., 0], low_angle + width)
                fraction, log_slope = constrain_angle(y)
                out[..., 1] = low_angle + width * fraction
                if "deflection_angle" in self.prior:  # whose density may be infinite at an end
                    ends = np.nextafter(low_angle, np.pi), np.nextafter(low_angle + width, 0.0)
                    out[..., 1] = np.clip(out[..., 1], *ends)
                log_prior += np.where(width > 0, np.log(width) + log_slope, -np.inf)
        for i, name in enumerate(self.cue.unknowns[: x.shape[-1]]):
            if i >= self.bounded:
                log_prior -= 0.5 * (x[..., i] ** 2 + np.log(2 * np.pi))
            elif name in self.prior:
                log_prior = log_prior + self.prior[name].logpdf(out[..., i])
        return out, log_prior

    def reaching(self, farthest: Array) -> ContactCoordinates:
        """The same with distances that end at another reach (...), m, of each contact its own."""
        out = copy(self)
        object.__setattr__(out, "reach", (self.reach[0], farthest))
        return out

    def distance(self, x: Array) -> Array:
        """The radial distances (...), m, at the first coordinate."""
        low, high = self.reach
        return np.asarray(low + (high - low) * constrain_distance(x)[0])

    def unconstrain(self, contact: ArrayLike) -> Array:
        """The coordinates x (..., U) of a contact (..., U) inside the reach."""
        contact = np.asarray(contact, dtype=float)
        low, high = self.reach
        out = np.empty(contact.shape)
        out[..., 0] = unconstrain_distance((contact[..., 0] - low) / (high - low))
        if self.bounded > 1:
            low_angle, width = self.angle_range(contact[..., 0], contact)
            fraction = (contact[..., 1] - low_angle) / width
            # Rounding may put a contact that is all but at the fold upon it.
            fraction = np.where(fraction == 1, np.nextafter(1.0, 0.0), fraction)
            out[..., 1] = unconstrain_angle(fraction) + self._log_gain(
                contact[..., 0], low_angle + width
            )
        for i in range(self.bounded, contact.shape[-1]):
            out[..., i] = to_normal(self.prior[self.cue.unknowns[i]], contact[..., i])
        return out

    def unconstrain_one(self, value: Array, unknown: int) -> Array:
        """One coordinate, of values (...) of an unknown other than the deflection angle.

        Beyond the range of the unknown it is infinite.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if unknown >= self.bounded:
                return to_normal(self.prior[self.cue.unknowns[unknown]], value)
            low, high = self.reach
            return unconstrain_distance(np.clip((value - low) / (high - low), 0.0, 1.0))

    def spread(self, fractions: Array, *, others: int = 7) -> Array:
        """Coordinates (n, U) of contacts at all combinations of fractions of each range.

        Unknowns that have priors alone take as many values as `others`, within 2.5 sd of the
        middle.
        """
        bounded = [f(fractions) for f in (unconstrain_distance, unconstrain_angle)[: self.bounded]]
        further = [np.linspace(-2.5, 2.5, others)] * (len(self.cue.unknowns) - self.bounded)
        x = np.stack([a.ravel() for a in np.meshgrid(*bounded, *further, indexing="ij")], axis=-1)
        if self.bounded > 1:
            r = self.distance(x[:, 0])
            low_angle, width = self.angle_range(r)
            x[:, 1] += self._log_gain(r, low_angle + width)
        return x

    def prior_scores(self, contact: Array) -> Array:
        """How far up the priors that were given of distance and angle contacts (..., U) are.

        As standard normal scores (..., P) within ±9.
        """
        given = [(self.cue.unknowns.index(name), self.prior[name]) for name in self.peaks]
        scores = [to_normal(prior, contact[..., i]) for i, prior in given]
        none = np.zeros((*contact.shape[:-1], 0))
        return np.clip(np.stack(scores, axis=-1), -9.0, 9.0) if scores else none

    def given_scores(self, contact: Array) -> Array:
        """`prior_scores` without an end.

        Beyond ±9 by how far ln of the density is below its highest.
        """
        scores = self.prior_scores(contact)
        for j, (name, peak) in enumerate(self.peaks.items()):
            below = peak - self.prior[name].logpdf(contact[..., self.cue.unknowns.index(name)])
            depth = np.sqrt(2 * np.maximum(below, 0.0))
            scores[..., j] = np.copysign(np.maximum(np.abs(scores[..., j]), depth), scores[..., j])
        return scores

    @cached_property
    def peaks(self) -> Mapping[str, float]:
        """The highest ln of the density of priors of the bounded unknowns, by name."""
        p = np.geomspace(1e-6, 0.5, 40)
        p = np.concatenate([p, 1 - p])
        stated = {n: self.prior[n] for n in self.cue.unknowns[: self.bounded] if n in self.prior}
        return {n: float(np.max(prior.logpdf(prior.ppf(p)))) for n, prior in stated.items()}

    def angle_range(self, r: Array, contact: Array | None = None) -> tuple[float, Array]:
        """Lowest deflection angle and width of the range open at each distance.

        Friction and curvature are those of `contact` (..., U); where that lacks them, or without
        it, the range is the widest there is.
        """
        count = len(self.cue.unknowns)
        if contact is not None and contact.shape[-1] == count:
            models = [self.cue.forward(self.whisker, contact)]
        else:
            models = self.cue.forward(self.whisker, np.ones((*r.shape, count))).extremes(5)
        whiskers = models if self.cue.takes_curved else [self.whisker] * len(models)
        # Some curvatures reach no further than others, which has no say in how far those do.
        limit = largest = np.asarray(-np.inf)
        for model, whisker in zip(models, whiskers, strict=True):
            limit = np.fmax(limit, model.limit(r))
            largest = np.fmax(largest, self.cue.largest_angle(whisker, r))
        limit = np.minimum(limit, largest)
        low = 0.0
        if "deflection_angle" in self.prior:
            low, high = self._range("deflection_angle", np.pi)
            limit = np.minimum(limit, high)
        return low, np.nan_to_num(np.maximum(limit - low, 0.0))

    def angle_scale(self, contact: Array) -> AngleScale:
        """How the angle goes with its coordinate at contacts (N, U), of which it is no matter."""
        low, width = self.angle_range(contact[:, 0], contact)
        return AngleScale(float(low), width, self._log_gain(contact[:, 0], low + width))

    @cached_property
    def reach_varies(self) -> bool:
        """Whether what contacts are held depends on a further unknown."""
        contact = np.ones((1, len(self.cue.unknowns)))
        return len(self.cue.forward(self.whisker, contact).extremes(2)) > 1

    @cached_property
    def _forward(self) -> ForwardModel:
        return forward_of(self.whisker)

    def _log_gain(self, r: Array, largest: Array) -> Array:
        """What turns ln θ_d into ln M (small angle): contacts of one moment share a coordinate.

        By the largest angles, which do not vanish where the range of a prior closes.
        """
        w = self._forward
        room = np.maximum(1 / r - 1 / (w.base.apex_distance * w.reach / w.length), 1e-300)
        if w.is_hinged:  # in series
            room = 1 / (1 / room + w.hinge_compliance * w.base.compliance_constant)
        # Where there is no angle there is nothing to carry.
        largest = np.maximum(largest, np.finfo(float).tiny)
        return np.asarray(np.log(largest * w.length * room))


@dataclass(frozen=True)
class AngleScale:
    """The deflection angle as a function of its coordinate, at N distances.

    From `low` it goes over widths (N,); `log_gain` (N,) shifts the coordinate.
    """

    low: float
    width: Array
    log_gain: Array

    @property
    def high(self) -> Array:
        """The largest angles (N,)."""
        return self.low + self.width

    def of(self, which: Index) -> AngleScale:
        return AngleScale(self.low, self.width[which], self.log_gain[which])

    def coordinate(self, value: Array, which: Index) -> Array:
        """The coordinates (m, Q) of angles (m, Q), at distances `which` (m,)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            width = self.width[which, None]
            # Where there is room for the least angle alone, all of it lies below.
            fraction = np.where(width > 0, np.clip((value - self.low) / width, 0.0, 1.0), 1.0)
            return unconstrain_angle(fraction) + self.log_gain[which, None]


@dataclass(frozen=True)
class PriorScale:
    """An unknown that has a prior alone as a function of its coordinate, at N distances alike."""

    prior: Any
    count: int

    @property
    def low(self) -> float:
        """The least value there is."""
        return float(self.prior.support()[0])

    @property
    def high(self) -> Array:
        """The largest value there is, (N,)."""
        return np.full(self.count, float(self.prior.support()[1]))

    def coordinate(self, value: Array, which: Index) -> Array:
        """The coordinates (m, Q) of values (m, Q), at distances `which` (m,)."""
        with np.errstate(divide="ignore"):
            return to_normal(self.prior, value)


def constrain_distance(y: Array) -> tuple[Array, Array]:
    """The fraction logistic(sinh y) and the ln of its slope."""
    z = np.sinh(np.clip(y, -FARTHEST, FARTHEST))
    return _logistic(z, 0.5 * np.log1p(z * z))


def unconstrain_distance(fraction: Array) -> Array:
    """The y of a fraction."""
    return np.asarray(np.arcsinh(logit(fraction)))


def constrain_angle(y: Array) -> tuple[Array, Array]:
    """The fraction logistic(y + eʸ) and the ln of its slope."""
    growth = np.exp(np.minimum(y, 30.0))
    return _logistic(y + growth, np.log1p(growth))


def unconstrain_angle(fraction: Array) -> Array:
    """The y of a fraction: eʸ is Wright's ω of its logit."""
    z = logit(fraction)
    omega = wrightomega(z)
    return np.where(z > 0, np.log(omega), z - omega)


def _logistic(z: Array, log_slope: Array) -> tuple[Array, Array]:
    """logistic(z) and ln of its slope, where ln dz/dy is `log_slope`."""
    distance = np.abs(z)
    tail = np.exp(-distance)
    upper = 1 / (1 + tail)
    return np.where(z < 0, tail * upper, upper), 2 * np.log(upper) - distance + log_slope


def from_normal(distribution: Any, z: Array) -> Array:
    """The value as far up its distribution as z (...) is up the standard normal."""
    z = np.clip(z, -37.0, 37.0)  # probabilities above the smallest there is
    below, tail = z < 0, ndtr(-np.abs(z))
    out = np.empty(z.shape)
    out[below], out[~below] = distribution.ppf(tail[below]), distribution.isf(tail[~below])
    return out


def to_normal(distribution: Any, value: Array) -> Array:
    """Where on the standard normal a value of a distribution is."""
    below, above = distribution.cdf(value), distribution.sf(value)
    return np.where(below < above, ndtri(below), -ndtri(above))


def is_discontinuous(distribution: Any) -> bool:
    """Whether a density leaps inside its support, as a histogram's does.

    Examples
    --------
    >>> from scipy import stats
    >>> histogram = stats.rv_histogram(([1, 3, 0, 2], [0.0, 1.0, 2.0, 3.0, 4.0]))()
    >>> [is_discontinuous(d) for d in (histogram, stats.norm(), stats.uniform())]
    [True, False, False]
    >>> is_discontinuous(stats.rv_histogram(([0, 1, 0], [0.0, 1.0, 2.0, 3.0]))())
    True
    """
    ends = distribution.ppf(np.linspace(1e-6, 1 - 1e-6, 1025))
    width = ends[-1] - ends[0]
    # Where a support goes on in which there is no mass, the density may have leapt to 0.
    margin = np.linspace(0.0, 1.0, 65)[1:-1]
    low, high = distribution.support()
    below = ends[0] - margin * min(ends[0] - low, width)
    above = ends[-1] + margin * min(high - ends[-1], width)
    value = np.concatenate([below, ends, np.linspace(ends[0], ends[-1], 2049), above])
    value = np.unique(value)

    with np.errstate(divide="ignore", invalid="ignore"):
        # Between narrow peaks a smooth density underflows: 60 nats below the highest is nothing.
        floor = np.nanmax(distribution.logpdf(value)) - 60.0

    def step(low: Array, high: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            log = [np.fmax(distribution.logpdf(x), floor) for x in (low, high)]
        return np.nan_to_num(np.abs(log[0] - log[1]))

    low, high = value[:-1], value[1:]
    for _ in range(50):  # what is steep is less so over half of the way
        steep = step(low, high) > 0.05
        low, high = low[steep], high[steep]
        if not low.size:
            return False
        middle = (low + high) / 2
        first = step(low, middle) > step(middle, high)
        low, high = np.where(first, low, middle), np.where(first, middle, high)
    return True


def _refuse_discontinuous(name: str, distribution: Any) -> None:
    """Refuse a prior that no coordinate makes smooth, with a smooth one of its mean and sd."""
    if not is_discontinuous(distribution):
        return
    quantiles = distribution.ppf((np.arange(10_000) + 0.5) / 10_000)  # own priors may lack a mean
    mean, sd = float(quantiles.mean()), float(quantiles.std())
    low, high = map(float, distribution.support())
    smooth = f"scipy.stats.norm({mean:.4g}, {sd:.4g})"
    if np.isfinite(high - low):
        share, relative_sd = (mean - low) / (high - low), sd / (high - low)
        count = share * (1 - share) / relative_sd**2 - 1
        count = max(count, 1.01 / min(share, 1 - share))  # of one peak
        smooth = (
            f"scipy.stats.beta({count * share:.4g}, {count * (1 - share):.4g}, {low:.4g}, "
            f"{high - low:.4g})"
        )
    raise Refusal(
        f"The prior of {name} must have a density without steps",
        f"{shown(distribution)}, as a histogram's is",
        f"write {smooth}, say, which has its mean",
    )


def family(distribution: Any) -> Any:
    """What frozen SciPy distributions are compared by; any other distribution by itself."""
    family: Any = getattr(distribution, "dist", None)
    try:
        # A histogram's table and a user's own limits are the family's.
        made = family._updated_ctor_param()
        limits = tuple((k, v) for k, v in made.items() if k not in ("badvalue", "seed"))
        key = type(family), distribution.args, tuple(sorted(distribution.kwds.items())), limits
        hash(key)
    except (AttributeError, TypeError):
        return distribution
    return key


def is_all_around(distribution: Any) -> bool:
    """Whether an angle is as likely to be any: flat over a whole turn."""
    flat = getattr(getattr(distribution, "dist", None), "name", None) == "uniform"
    return flat and bool(np.ptp(distribution.support()) > 2 * np.pi - 1e-9)


def within_half_turn(angle: Array) -> Array:
    """Angles, rad, less as many whole turns as leave half a turn at most."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))


def in_words(prior: Any) -> str:
    """A frozen distribution as one would write it."""
    given = [f"{a:.4g}" for a in prior.args] + [f"{k}={v:.4g}" for k, v in prior.kwds.items()]
    return f"{prior.dist.name}({', '.join(given)})"


def priors_of(prior: Any, cue: Cue) -> Mapping[str, Any]:
    """The priors given, refused where they are not distributions of the cue's unknowns."""
    if prior is None:
        return {}
    if not isinstance(prior, Mapping):
        raise Refusal(
            "prior must be a mapping of unknown to distribution",
            shown(prior),
            'write {"radial_distance": scipy.stats.uniform(10e-3, 20e-3)}, say',
        )
    for name, distribution in prior.items():
        one_of("prior of", name, cue.unknowns)
        loose, whole = hasattr(distribution, "freeze"), hasattr(distribution, "logpmf")
        if not hasattr(distribution, "support") or loose or whole:
            raise Refusal(
                f"The prior of {name} must be a frozen SciPy distribution, a continuous one",
                shown(distribution),
                "write scipy.stats.uniform(10e-3, 20e-3), say",
            )
        if name in ("radial_distance", "deflection_angle"):
            _refuse_discontinuous(name, distribution)
    return prior
