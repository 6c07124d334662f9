"""The observer: whisker × cue × receptor noise × prior → the density of the unknown contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit, ndtr, ndtri, wrightomega

from ._checks import finite, one_of
from .cues.protocol import Cue, given, straight
from .mechanics.contact import Outcome
from .mechanics.surface import surface_of
from .receptors import Events, Joint, LogNormal, ReceptorNoise, Seed
from .receptors.gaussian import Gaussian
from .whisker import Whisker

Array = NDArray[np.float64]

#: Values of each unknown that has a prior alone in `Observer.spread`.
OTHERS = 7
#: x₁ at the ends of the reach, as far as numbers go: the fraction 1e-32 and its mirror image.
FARTHEST = 5.0


class Observer:
    """An ideal observer of one contact.

    Parameters
    ----------
    whisker : Whisker
        One whisker: its fields are numbers, not arrays.
    cue : Cue
        How distance is felt; see `weberwhisk.cues`.
    noise : ReceptorNoise
        Default the cue's own, which is Weber's law with k = 0.1 wherever signals are forces.
    prior : mapping of name to frozen SciPy distribution, optional
        Prior of any of the cue's unknowns (``"radial_distance"`` in m, ``"deflection_angle"`` in
        rad). By default these two are flat over every contact that the whisker can hold: up to
        the tip, and up to the angle at which it flicks past; further unknowns have the cue's.
    model : {"closed_form", "elastica"}, optional
        The rung of the mechanics; by default the cheapest that the scene needs.

    Raises
    ------
    ValueError
        For whisker fields that are arrays, chances of events with noise of something else or the
        other way round, a prior of something that is not unknown, a prior
        that has no overlap with the whisker's reach.

    Notes
    -----
    Posteriors are explored in coordinates x that have no edges: x₁ = asinh(logit(r/reach)), in
    which base and tip lie double-exponentially far off, and x₂ = y + ln(M/θ_d), with M the small-
    angle moment and logistic(y + eʸ) the fraction of the largest θ_d at that r. Down low x₂ is
    ln M, up high it closes in on the fold or the tip double-exponentially. So the tails of
    posteriors are short, and the force map's ridge, along which M is constant, is straight. Any
    further unknown has a coordinate in which its prior is the standard normal.

    Examples
    --------
    >>> from weberwhisk import cues
    >>> observer = Observer(Whisker(50e-3, 100e-6, 5e-6), cues.Compliance())
    >>> observer.unknowns, observer.reach
    (('radial_distance',), (0.0, 0.05))
    """

    def __init__(
        self,
        whisker: Whisker,
        cue: Cue,
        noise: ReceptorNoise | None = None,
        prior: Mapping[str, Any] | None = None,
        *,
        model: str | None = None,
    ) -> None:
        straight(whisker)
        if isinstance(cue, type) or not isinstance(cue, Cue):
            raise ValueError(f"An observer needs a cue, got {cue!r}; write cues.Compliance(), say.")
        if isinstance(noise, type) or not isinstance(noise, ReceptorNoise | None):
            raise ValueError(
                f"An observer needs receptor noise, got {noise!r}; write receptors.Weber(0.1), say."
            )
        for name in ("length", "base_radius", "tip_radius", "youngs_modulus", "curvature"):
            if np.ndim(getattr(whisker, name)):
                raise ValueError(
                    f"An observer has one whisker, got {np.size(getattr(whisker, name))} values of "
                    f"{name}; make one Observer for each."
                )
        self.whisker = whisker
        self.cue = cue
        self.noise: ReceptorNoise = cue.default_noise() if noise is None else noise
        if isinstance(self.noise, Events) != isinstance(cue.default_noise(), Events):
            raise ValueError(
                f"The signals of {cue!r} are not what this noise reports, got {self.noise!r}; "
                f"leave noise out for {cue.default_noise()!r}."
            )
        size = len(cue.signal_names)
        count = self.noise.reading_size(size)
        try:
            spread = np.shape(self.noise.sd(np.ones(size)))
        except ValueError:  # as many values as some other cue has signals
            spread = ()
        if spread != (count,):
            raise ValueError(
                f"The noise is not of {size} signals ({', '.join(cue.signal_names)}), got "
                f"{self.noise!r}; give one value, or one for each signal."
            )
        for name, distribution in (prior or {}).items():
            one_of("prior of", name, cue.unknowns)
            if not hasattr(distribution, "support"):
                raise ValueError(
                    f"The prior of {name} must be a frozen SciPy distribution, got "
                    f"{distribution!r}; write scipy.stats.uniform(10e-3, 20e-3), say."
                )
        if model is not None:
            one_of("model", model, ("closed_form", "elastica", "profile", "rod"))
        self.prior = {**cue.priors(whisker), **(prior or {})}
        self.model = model
        self._from_normal = {
            name: _from_normal(self.prior[name])
            for name in cue.unknowns
            if name not in ("radial_distance", "deflection_angle")
        }
        #: How many unknowns the whisker bounds: the first ones; the rest have priors alone.
        self.bounded = 2 if "deflection_angle" in cue.unknowns else 1
        self.reach = self._range("radial_distance", cue.farthest(whisker))

    def __repr__(self) -> str:
        return f"Observer({self.whisker}, {self.cue!r}, {self.noise!r})"

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of what the cue does not know of the contact, radial distance first."""
        return self.cue.unknowns

    def _range(self, name: str, top: float) -> tuple[float, float]:
        low, high = self.prior[name].support() if name in self.prior else (0.0, np.inf)
        low, high = max(float(low), 0.0), min(float(high), top)
        if not low < high:
            raise ValueError(
                f"The prior of {name} has no overlap with what this whisker can reach, got "
                f"{low:g} and more where the reach ends at {top:g}; give it in m (rad for angles)."
            )
        return low, high

    # -- coordinates ---------------------------------------------------------------------------

    def contact(self, x: ArrayLike) -> tuple[Array, Array]:
        """The contact (..., U) at coordinates x (..., U), and ln of its prior density in x (...).

        Of the first unknowns alone where x has fewer. Flat priors count as the density 1 of the
        contact, so that theirs is ln |d contact/dx|.
        """
        x = np.asarray(x, dtype=float)
        low, high = self.reach
        out = np.empty(x.shape)
        fraction, log_prior = _place(x[..., 0])
        # Rounding must not put a contact on an edge, where there is none.
        out[..., 0] = np.clip(
            low + (high - low) * fraction, np.nextafter(low, high), np.nextafter(high, low)
        )
        log_prior += np.log(high - low)
        if self.bounded > 1:
            low_angle, width = self.angle_range(out[..., 0])
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                fraction, log_slope = _squash(x[..., 1] - self._shear(out[..., 0], width))
                out[..., 1] = low_angle + width * fraction
                log_prior += np.where(width > 0, np.log(width) + log_slope, -np.inf)
        for i, name in enumerate(self.unknowns[: x.shape[-1]]):
            if i >= self.bounded:
                out[..., i] = self._from_normal[name](x[..., i])
                log_prior -= 0.5 * (x[..., i] ** 2 + np.log(2 * np.pi))
            elif name in self.prior:
                log_prior = log_prior + self.prior[name].logpdf(out[..., i])
        return out, log_prior

    def coordinates(self, contact: ArrayLike) -> Array:
        """The coordinates x (..., U) of a contact (..., U) inside the reach."""
        contact = np.asarray(contact, dtype=float)
        low, high = self.reach
        out = np.empty(contact.shape)
        out[..., 0] = _unplace((contact[..., 0] - low) / (high - low))
        if self.bounded > 1:
            low_angle, width = self.angle_range(contact[..., 0])
            out[..., 1] = _unsquash((contact[..., 1] - low_angle) / width) + self._shear(
                contact[..., 0], width
            )
        for i in range(self.bounded, contact.shape[-1]):
            out[..., i] = _to_normal(self.prior[self.unknowns[i]], contact[..., i])
        return out

    def spread(self, fractions: Array) -> Array:
        """Coordinates (n, U) of contacts at all combinations of fractions of each range.

        Unknowns that have priors alone take `OTHERS` values within 2.5 sd of the middle.
        """
        bounded = [f(fractions) for f in (_unplace, _unsquash)[: self.bounded]]
        others = [np.linspace(-2.5, 2.5, OTHERS)] * (len(self.unknowns) - self.bounded)
        x = np.stack([a.ravel() for a in np.meshgrid(*bounded, *others, indexing="ij")], axis=-1)
        if self.bounded > 1:
            low, high = self.reach
            r = low + (high - low) * _place(x[:, 0])[0]
            x[:, 1] += self._shear(r, self.angle_range(r)[1])
        return x

    def at_middle(self, contact: ArrayLike) -> Array:
        """Contacts (..., U) of the first unknowns (..., ≤ U), the others at their prior medians."""
        contact = np.asarray(contact, dtype=float)
        rest = [
            np.full(contact.shape[:-1], float(self.prior[name].median()))
            for name in self.unknowns[contact.shape[-1] :]
        ]
        return np.concatenate([contact, *(a[..., None] for a in rest)], axis=-1)

    def prior_information(self, contact: ArrayLike) -> Array:
        """What their priors tell of the unknowns that have priors alone, (..., U, U).

        The precision of the standard normal, carried to each such unknown; 0 for the others.
        """
        contact = np.asarray(contact, dtype=float)
        out = np.zeros((*contact.shape, contact.shape[-1]))
        for i in range(self.bounded, contact.shape[-1]):
            distribution = self.prior[self.unknowns[i]]
            z = _to_normal(distribution, contact[..., i])
            slope = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) / distribution.pdf(contact[..., i])
            out[..., i, i] = slope**-2
        return out

    def distance_prior(self, r: ArrayLike) -> Array:
        """Prior density of the radial distance r (...), m, up to a factor; 0 outside the reach.

        The prior of the contact with all else integrated out: where the deflection angle is
        unknown and its prior flat, the range of angles that the whisker holds at that distance.
        """
        r = np.asarray(r, dtype=float)
        low, high = self.reach
        inside = (r > low) & (r < high)
        place = np.where(inside, r, (low + high) / 2)
        density = np.ones(r.shape)
        if "radial_distance" in self.prior:
            density = self.prior["radial_distance"].pdf(place)
        if self.bounded > 1:
            least, width = self.angle_range(place)
            if "deflection_angle" in self.prior:
                angle = self.prior["deflection_angle"]
                width = angle.cdf(least + width) - angle.cdf(least)
            density = density * width
        return np.where(inside, density, 0.0)

    def _shear(self, r: Array, width: Array) -> Array:
        """What turns ln θ_d into ln M (small angle): contacts of one moment share a coordinate."""
        w = self.whisker
        # Where a prior leaves no angle there is nothing to shear.
        width = np.maximum(width, np.finfo(float).tiny)
        return np.asarray(np.log(width * w.length * (1 / r - 1 / w.apex_distance)))

    def angle_range(self, r: Array) -> tuple[float, Array]:
        """Lowest deflection angle and width of the range open at each distance."""
        limit = surface_of(self.whisker).limit(r.reshape(-1)).reshape(r.shape)
        if hasattr(self.cue, "largest_angle"):
            limit = np.minimum(limit, self.cue.largest_angle(self.whisker, r))
        low = 0.0
        if "deflection_angle" in self.prior:
            low, high = self._range("deflection_angle", np.pi)
            limit = np.minimum(limit, high)
        return low, np.maximum(limit - low, 0.0)

    # -- densities -----------------------------------------------------------------------------

    def signals(self, contact: ArrayLike) -> tuple[Array, NDArray[np.int8]]:
        """Signals (..., S) of a contact (..., U), NaN where not held, and the outcome (...)."""
        return self.cue.signals(self.whisker, np.asarray(contact, dtype=float), model=self.model)

    def given(self, contact: Array) -> Callable[[Array], tuple[Array, NDArray[np.int8]]]:
        """Signals and outcome for values (...) of the last unknown, the others (..., U − 1) given.

        What does not depend on it is worked out once.
        """
        return given(self.cue, self.whisker, np.asarray(contact, dtype=float), model=self.model)

    def last_unknown(self, z: Array) -> Array:
        """The last unknown's values (...) at its coordinate z."""
        return self._from_normal[self.unknowns[-1]](z)

    def log_likelihood(self, reading: ArrayLike, contact: ArrayLike) -> Array:
        """ln p(reading | contact), (...); −∞ where the contact is not held."""
        signals, outcome = self.signals(contact)
        held = outcome == Outcome.HELD
        value = self.noise.log_likelihood(reading, np.where(held[..., None], signals, 1.0))
        return np.where(held, value, -np.inf)

    def log_density(self, x: ArrayLike, reading: ArrayLike) -> Array:
        """ln of the posterior density in the coordinates x, up to the evidence, (...)."""
        return self.log_density_and_contact(x, reading)[0]

    def log_density_and_contact(self, x: ArrayLike, reading: ArrayLike) -> tuple[Array, Array]:
        """ln of the posterior density in the coordinates x (...), and the contact (..., U)."""
        contact, log_prior = self.contact(x)
        return self.log_likelihood(reading, contact) + log_prior, contact

    def information(self, contact: ArrayLike) -> Array:
        """Fisher information of one reading about the contact, (..., U, U).

        ∂μᵀΣ⁻¹∂μ + ½tr(Σ⁻¹∂ΣΣ⁻¹∂Σ); NaN where the contact is not held.
        """
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.signals(contact)
        held = (outcome == Outcome.HELD)[..., None]
        slope = self.cue.jacobian(self.whisker, contact, model=self.model)
        inner = self.noise.fisher(np.where(held, signals, 1.0))
        value = np.swapaxes(slope, -1, -2) @ inner @ slope
        return np.where(held[..., None], value, np.nan)

    # -- readings ------------------------------------------------------------------------------

    def reading_outcome(self, reading: ArrayLike) -> NDArray[np.int8]:
        """What the cue's method, taken by itself and as exact, makes of readings (..., R).

        An `Outcome` each: `HELD` where it finds a contact, for cues without an inverse, and where
        readings are not of the signals themselves (spikes are counts).
        """
        y = self.checked_reading(reading)
        if not (hasattr(self.cue, "reading_outcome") and _of_signals(self.noise)):
            return np.zeros(y.shape[:-1], dtype=np.int8)
        return np.asarray(self.cue.reading_outcome(self.whisker, y), dtype=np.int8)

    def read(self, contact: ArrayLike, seed: Seed = None) -> Array:
        """Noisy readings (..., S) of a contact (..., U).

        Raises
        ------
        ValueError
            Where the whisker cannot hold the contact.
        """
        signals, outcome = self.signals(self.checked(contact))
        if np.any(outcome != Outcome.HELD):
            bad = Outcome(int(outcome[outcome != Outcome.HELD].flat[0]))
            raise ValueError(
                f"There is no reading of a contact that is not held, got one {bad.message}; "
                "choose distances and angles inside flick_past()."
            )
        return self.noise.sample(signals, seed)

    def checked(self, contact: ArrayLike) -> Array:
        """`contact` as an array (..., U) of finite numbers."""
        array = finite("contact", contact, "give metres and radians")
        count = len(self.unknowns)
        if count == 1 and (array.ndim == 0 or array.shape[-1] != 1):
            array = array[..., None]
        if array.shape[-1] != count:
            raise ValueError(
                f"A contact of {self.cue!r} has {count} numbers ({', '.join(self.unknowns)}), got "
                f"shape {array.shape}; put them along the last axis."
            )
        return array

    def checked_reading(self, reading: ArrayLike) -> Array:
        """`reading` as an array (..., S) of finite numbers."""
        array = finite("reading", reading, "give the base signals in SI units")
        count = self.noise.reading_size(len(self.cue.signal_names))
        if count == 1 and (array.ndim == 0 or array.shape[-1] != 1):
            array = array[..., None]
        if array.ndim == 0 or array.shape[-1] != count:
            of = f"of {', '.join(self.cue.signal_names)}"
            if isinstance(self.noise, Events):
                of = f"one of {self.noise.reports.tolist()}"
            raise ValueError(
                f"A reading of {self.cue!r} under {self.noise!r} has {count} numbers "
                f"({of}), got shape {array.shape}; put them along the last axis."
            )
        return array


def _of_signals(noise: ReceptorNoise) -> bool:
    """Whether readings are numbers that a cue's inverse can take."""
    if isinstance(noise, Joint):
        return all(map(_of_signals, noise.noises))
    return isinstance(noise, Gaussian | LogNormal | Events)


def _from_normal(distribution: Any) -> Callable[[Array], Array]:
    """The value as far up its distribution as z is up the standard normal, as a function of z."""
    family = getattr(getattr(distribution, "dist", None), "name", None)
    if family == "norm":
        mean, sd = float(distribution.mean()), float(distribution.std())
        return lambda z: mean + sd * z
    if family == "lognorm" and distribution.support()[0] == 0.0:
        middle, above = distribution.ppf([0.5, ndtr(1.0)])
        spread = np.log(above / middle)
        return lambda z: np.asarray(middle * np.exp(spread * z))
    if family == "uniform":
        low, high = distribution.support()
        return lambda z: np.asarray(low + (high - low) * ndtr(z))

    def value(z: Array) -> Array:
        z = np.clip(z, -37.0, 37.0)  # probabilities above the smallest there is
        below, tail = z < 0, ndtr(-np.abs(z))
        out = np.empty(z.shape)
        out[below], out[~below] = distribution.ppf(tail[below]), distribution.isf(tail[~below])
        return out

    return value


def _to_normal(distribution: Any, value: Array) -> Array:
    """Where on the standard normal a value of a distribution is."""
    below, above = distribution.cdf(value), distribution.sf(value)
    return np.where(below < above, ndtri(below), -ndtri(above))


def _place(y: Array) -> tuple[Array, Array]:
    """f = logistic(sinh y) and the ln of its slope."""
    z = np.sinh(np.clip(y, -FARTHEST, FARTHEST))
    distance = np.abs(z)
    tail = np.exp(-distance)
    upper = 1 / (1 + tail)
    log_slope = -distance + 2 * np.log(upper) + 0.5 * np.log1p(z * z)
    return np.where(z < 0, tail * upper, upper), log_slope


def _unplace(fraction: Array) -> Array:
    """The y of a fraction."""
    return np.asarray(np.arcsinh(logit(fraction)))


def _squash(y: Array) -> tuple[Array, Array]:
    """f = logistic(y + eʸ) and the ln of its slope."""
    growth = np.exp(np.minimum(y, 30.0))
    z = y + growth
    distance = np.abs(z)
    tail = np.exp(-distance)
    upper = 1 / (1 + tail)
    log_slope = -distance + 2 * np.log(upper) + np.log1p(growth)
    return np.where(z < 0, tail * upper, upper), log_slope


def _unsquash(fraction: Array) -> Array:
    """The y of a fraction: eʸ is Wright's ω of its logit."""
    z = logit(fraction)
    omega = wrightomega(z)
    return np.where(z > 0, np.log(omega), z - omega)
