"""The observer: whisker × cue × receptor noise × prior → the density of the unknown contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import logit, wrightomega

from ._checks import finite, one_of
from .cues.protocol import Cue
from .mechanics.contact import Outcome
from .mechanics.surface import surface_of
from .receptors import ReceptorNoise, Seed, Weber
from .whisker import Whisker

Array = NDArray[np.float64]


class Observer:
    """An ideal observer of one contact.

    Parameters
    ----------
    whisker : Whisker
        One whisker: its fields are numbers, not arrays.
    cue : Cue
        How distance is felt; see `weberwhisk.cues`.
    noise : ReceptorNoise
        Default Weber's law with k = 0.1.
    prior : mapping of name to frozen SciPy distribution, optional
        Prior of any of the cue's unknowns (``"radial_distance"`` in m, ``"deflection_angle"`` in
        rad). By default flat over every contact that the whisker can hold: up to the tip, and up
        to the angle at which it flicks past.
    model : {"closed_form", "elastica"}, optional
        The rung of the mechanics; by default the cheapest that the scene needs.

    Raises
    ------
    ValueError
        For whisker fields that are arrays, a prior of something that is not unknown, a prior
        that has no overlap with the whisker's reach.

    Notes
    -----
    Posteriors are explored in coordinates x that have no edges: x₁ = asinh(logit(r/reach)), in
    which base and tip lie double-exponentially far off, and x₂ = y + ln(M/θ_d), with M the small-
    angle moment and logistic(y + eʸ) the fraction of the largest θ_d at that r. Down low x₂ is
    ln M, up high it closes in on the fold or the tip double-exponentially. So the tails of
    posteriors are short, and the force map's ridge, along which M is constant, is straight.

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
        for name in ("length", "base_radius", "tip_radius", "youngs_modulus", "curvature"):
            if np.ndim(getattr(whisker, name)):
                raise ValueError(
                    f"An observer has one whisker, got {np.size(getattr(whisker, name))} values of "
                    f"{name}; make one Observer for each."
                )
        if whisker.curvature != 0:
            raise ValueError(
                f"Cues are for straight whiskers so far, got curvature {whisker.curvature:g} 1/m; "
                "write curvature=0."
            )
        self.whisker = whisker
        self.cue = cue
        self.noise: ReceptorNoise = Weber(0.1) if noise is None else noise
        self.prior = dict(prior or {})
        self.model = model
        for name in self.prior:
            one_of("prior of", name, cue.unknowns)
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
        """The contact (..., U) at coordinates x (..., U), and ln |d contact/dx| (...)."""
        x = np.asarray(x, dtype=float)
        low, high = self.reach
        out = np.empty(x.shape)
        fraction, log_jacobian = _place(x[..., 0])
        # Rounding must not put a contact on an edge, where there is none.
        out[..., 0] = np.clip(
            low + (high - low) * fraction, np.nextafter(low, high), np.nextafter(high, low)
        )
        log_jacobian += np.log(high - low)
        if x.shape[-1] > 1:
            low_angle, width = self._angles(out[..., 0])
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                fraction, log_slope = _squash(x[..., 1] - self._shear(out[..., 0], width))
                out[..., 1] = low_angle + width * fraction
                log_jacobian += np.where(width > 0, np.log(width) + log_slope, -np.inf)
        return out, log_jacobian

    def coordinates(self, contact: ArrayLike) -> Array:
        """The coordinates x (..., U) of a contact (..., U) inside the reach."""
        contact = np.asarray(contact, dtype=float)
        low, high = self.reach
        out = np.empty(contact.shape)
        out[..., 0] = _unplace((contact[..., 0] - low) / (high - low))
        if contact.shape[-1] > 1:
            low_angle, width = self._angles(contact[..., 0])
            out[..., 1] = _unsquash((contact[..., 1] - low_angle) / width) + self._shear(
                contact[..., 0], width
            )
        return out

    def spread(self, fractions: Array) -> Array:
        """Coordinates (n, U) of contacts at all combinations of fractions of each range."""
        inverses = (_unplace, _unsquash)[: len(self.unknowns)]
        axes = np.meshgrid(*(inverse(fractions) for inverse in inverses), indexing="ij")
        x = np.stack([a.ravel() for a in axes], axis=-1)
        if x.shape[-1] > 1:
            r = self.contact(x[:, :1])[0][:, 0]
            x[:, 1] += self._shear(r, self._angles(r)[1])
        return x

    def _shear(self, r: Array, width: Array) -> Array:
        """What turns ln θ_d into ln M (small angle): contacts of one moment share a coordinate."""
        w = self.whisker
        return np.asarray(np.log(width * w.length * (1 / r - 1 / w.apex_distance)))

    def _angles(self, r: Array) -> tuple[float, Array]:
        """Lowest deflection angle and width of the range open at each distance."""
        limit = surface_of(self.whisker).limit(r.reshape(-1)).reshape(r.shape)
        low = 0.0
        if "deflection_angle" in self.prior:
            low, high = self._range("deflection_angle", np.pi)
            limit = np.minimum(limit, high)
        return low, np.maximum(limit - low, 0.0)

    # -- densities -----------------------------------------------------------------------------

    def signals(self, contact: ArrayLike) -> tuple[Array, NDArray[np.int8]]:
        """Signals (..., S) of a contact (..., U), NaN where not held, and the outcome (...)."""
        return self.cue.signals(self.whisker, np.asarray(contact, dtype=float), model=self.model)

    def log_prior(self, contact: ArrayLike) -> Array:
        """ln of the prior density (flat where none is given, up to a constant), (...)."""
        contact = np.asarray(contact, dtype=float)
        total = np.zeros(contact.shape[:-1])
        for name, distribution in self.prior.items():
            total = total + distribution.logpdf(contact[..., self.unknowns.index(name)])
        return total

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
        contact, log_jacobian = self.contact(x)
        value = self.log_likelihood(reading, contact) + log_jacobian
        return (value + self.log_prior(contact) if self.prior else value), contact

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
            raise ValueError(
                f"A reading of {self.cue!r} under {self.noise!r} has {count} numbers "
                f"(of {', '.join(self.cue.signal_names)}), got shape {array.shape}; "
                "put them along the last axis."
            )
        return array


def _place(y: Array) -> tuple[Array, Array]:
    """f = logistic(sinh y) and the ln of its slope."""
    z = np.sinh(np.clip(y, -5.0, 5.0))  # the fraction 1e-32 and its mirror image
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
