"""The signals of a tap: how fast its moment grows (§2e), and the vibration that it leaves (§2d)."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .._util.checks import non_negative_number, positive_number, whole
from .._util.refusals import Refusal
from .._util.values import Array
from ..mechanics import closed_form, modes
from ..mechanics.contact import Outcome
from ..mechanics.forward import forward_of
from ..receptors import GeneralisedWeber
from ..whisker import Whisker
from .protocol import Cue, Encoded, reach_at, straight

__all__ = ["Compliance", "Vibration"]


@dataclass(frozen=True, eq=False, repr=False)
class Compliance(Cue):
    """Radial distance from the moment rate Ṁ and the angular velocity θ̇ (equation (2.1)).

    By default θ̇ is known. With a spread it is unknown, sensed with noise of its own, and the
    posterior of the distance is that of both readings.

    Parameters
    ----------
    tap_angle : float
        How far the whisker is pushed into the object, rad: Ṁ is the moment reached, over the time
        it took. 0, the default, is the limit of a light tap, in which the closed form is exact.
    angular_velocity : float
        θ̇, rad/s; with a spread, the median of its log-normal prior.
    velocity_spread : float
        Sd of ln θ̇ from tap to tap. 0, the default: θ̇ is known, and no signal.

    Raises
    ------
    ValueError
        For a negative tap angle or spread, an angular velocity that is not positive.

    Notes
    -----
    With Weber fractions k_M and k_θ and a wide prior the JND is √(k_M² + k_θ²)·r(1 − r/A): the
    readings' ratio informs of r. Noise that both share cancels (a clock: ρ = 1, equal fractions).

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> rate, outcome = Compliance().signals(w, np.array([20e-3]))
    >>> float(Compliance().radial_distance(w, rate[0]).round(12))
    0.02
    """

    takes_curved = True
    _: KW_ONLY
    tap_angle: float = 0.0
    angular_velocity: float = 1.0
    velocity_spread: float = 0.0

    def __post_init__(self) -> None:
        self._set(
            tap_angle=non_negative_number(
                "tap_angle", self.tap_angle, "give radians, 0 for the lightest tap"
            ),
            angular_velocity=positive_number(
                "angular_velocity", self.angular_velocity, "give rad/s, such as 1"
            ),
            velocity_spread=non_negative_number(
                "velocity_spread", self.velocity_spread, "give the sd of ln, such as 0.5"
            ),
        )

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The moment rate, and the angular velocity where it is not known."""
        return ("moment_rate", "angular_velocity")[: 1 + (self.velocity_spread > 0)]

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the angular velocity where it is not known."""
        return ("radial_distance", "angular_velocity")[: 1 + (self.velocity_spread > 0)]

    def _velocity(self, contact: Array) -> Array:
        """θ̇ of a contact: what it says, or the known one."""
        if self.velocity_spread > 0:
            return contact[..., 1]
        return np.full(contact.shape[:-1], self.angular_velocity)

    def _stiffness(self, whisker: Whisker, r: Array, model: str | None) -> Encoded:
        """Moment for each radian of the tap, N m, and outcome."""
        forward = forward_of(whisker, model)
        if self.tap_angle == 0:
            return forward.stiffness(r)
        signals, outcome = forward.signals(r, np.full_like(r, self.tap_angle))
        return signals[..., 0] / self.tap_angle, outcome

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Moment rate, N m/s, and where unknown θ̇, rad/s, (..., S); outcome of a contact."""
        contact = np.asarray(contact, dtype=float)
        stiffness, outcome = self._stiffness(whisker, contact[..., 0], model)
        velocity = self._velocity(contact)
        rate = stiffness * velocity
        if self.velocity_spread == 0:
            return rate[..., None], outcome
        velocity = np.where(outcome == Outcome.HELD, velocity, np.nan)
        return np.stack([rate, velocity], axis=-1), outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """d(Ṁ, θ̇)/d(r, θ̇), (..., S, U): equation (3.3)."""
        contact = np.asarray(contact, dtype=float)
        r = contact[..., 0]
        forward = forward_of(whisker, model)
        if not forward.is_plain:
            return super().jacobian(whisker, contact, model=model)
        if self.tap_angle == 0 or model == "closed_form":
            slope = -forward.base.compliance_constant / r**2
            if forward.is_hinged:  # in series with a hinge, which takes a share of every angle
                slope = slope * (1 - forward.hinge_compliance * forward.stiffness(r)[0]) ** 2
        else:
            slope = forward.jacobian(r, self.tap_angle)[..., 0, 0] / self.tap_angle
        slope = np.asarray(slope * self._velocity(contact))
        if self.velocity_spread == 0:
            return slope[..., None, None]
        stiffness, _ = self._stiffness(whisker, r, model)
        jacobian = [[slope, stiffness], [np.zeros_like(r), np.ones_like(r)]]
        return np.stack([np.stack(row, axis=-1) for row in jacobian], axis=-2)

    def priors(self, whisker: Whisker) -> dict[str, Any]:
        """Log-normal, of θ̇ where it is unknown."""
        if self.velocity_spread == 0:
            return {}
        return {
            "angular_velocity": scipy.stats.lognorm(
                self.velocity_spread, scale=self.angular_velocity
            )
        }

    def farthest(self, whisker: Whisker) -> float:
        """The tip, or where the whisker flicks past at the tap angle, m."""
        if self.tap_angle == 0:
            return forward_of(whisker).reach
        return reach_at(whisker, self.tap_angle, "tap_angle")

    def radial_distance(
        self, whisker: Whisker, moment_rate: ArrayLike, angular_velocity: ArrayLike | None = None
    ) -> Array:
        """The inverse (2.1) for a light tap, m: r = Cθ̇A/(Cθ̇ + ṀA); θ̇ by default the cue's.

        NaN where no distance up to the tip gives the rate.

        Raises
        ------
        ValueError
            For a whisker that is curved, and a cue whose tap is not light.
        """
        velocity = self.angular_velocity if angular_velocity is None else angular_velocity
        forward, rate = forward_of(whisker), np.asarray(moment_rate, dtype=float)
        if self.tap_angle > 0 or not forward.is_plain:
            raise Refusal(
                "Equation (2.1) is of a light tap on a straight whisker",
                f"{self!r} and {whisker}",
                "write ww.posterior(observer, reading), which needs no inverse",
            )
        # What the hinge does not take up.
        bending = np.asarray(velocity) - forward.hinge_compliance * rate
        r = closed_form.distance_from_moment(forward.base, rate, bending)
        return np.where((r > 0) & (r <= whisker.length * (1 + 1e-12)), r, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class Vibration(Cue):
    """Radial distance from the amplitudes of the modes that a short impact at r excites.

    An impulse J at r gives mode n the velocity Jφ_n(r), and the base a moment that rings with
    amplitude J|φ_n(r)|·M_n/ω_n, M_n the base moment for a unit of the mode. By default J is
    unknown, and the signals are the ratios of the amplitudes to that of the first mode, which has
    no node on the whisker. With J known they are the amplitudes themselves.

    Parameters
    ----------
    count : int
        Modes that are sensed, 2 to 12 (with J known 1 to 12).
    impulse : float, optional
        J, N s, where it is known.
    phase : bool
        Whether the phase is sensed too: then signals have the sign of φ_n(r).
    damping_ratio : float
        Share of critical damping of every mode.

    Raises
    ------
    ValueError
        For a count outside that range, an impulse that is not positive, a damping ratio below 0 or
        of 1 and more.

    Notes
    -----
    Modes whose half-power bands (2ζω wide) touch are one peak in the spectrum: where that happens
    to any two neighbours the outcome is `UNRESOLVED` everywhere. Ratios to one amplitude have
    correlated noise, ½ between any two for equal Weber fractions; with that correlation their
    information is that of the amplitudes with J unknown, Σ(l_n − l̄)²/k² with l_n = d ln|φ_n|/dr.
    An amplitude of zero, at a node, is sensed no better than the floor of the noise.

    The signature need not be unique: `inference.approximate.count_peaks` counts the places left.
    Quadrature with one unknown finds them all; emcee and Laplace may miss some, and then say so.
    With further unknowns (a fusion) any method may find only the highest peak.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> ratios, outcome = Vibration(3).signals(w, np.array([[20e-3], [45e-3]]))
    >>> ratios.round(2)
    array([[1.64, 1.69],
           [1.43, 0.81]])
    """

    count: int = 3
    _: KW_ONLY
    impulse: float | None = None
    phase: bool = False
    damping_ratio: float = 0.0

    @property
    def is_smooth(self) -> bool:
        """With the phase; an amplitude alone has a kink at each node of its mode."""
        return self.phase

    def __post_init__(self) -> None:
        least = 1 + (self.impulse is None)
        hint = "write 3, or impulse= for one mode"
        count = whole("count", self.count, hint)
        if not least <= count <= 12:
            raise Refusal(f"count must be {least} to 12", count, hint)
        if self.impulse is not None:
            unit = "give newton seconds, such as 1e-9, or None where it is unknown"
            self._set(impulse=positive_number("impulse", self.impulse, unit))
        zeta = non_negative_number("damping_ratio", self.damping_ratio, "give a share, 0.05 say")
        if zeta >= 1:
            raise Refusal("damping_ratio must be below 1", f"{zeta:g}", "write 0.05")
        self._set(count=count, phase=bool(self.phase), damping_ratio=zeta)

    @cached_property
    def signal_names(self) -> tuple[str, ...]:
        """The ratios to the first mode's amplitude, or the amplitudes."""
        first, kind = (2, "ratio") if self.impulse is None else (1, "amplitude")
        return tuple(f"mode_{n}_{kind}" for n in range(first, self.count + 1))

    def resolved(self, whisker: Whisker) -> bool:
        """Whether the half-power bands of all the modes are separate."""
        omega = _modes(whisker, self.count).angular_frequency
        return bool(np.all(np.diff(omega) > self.damping_ratio * (omega[1:] + omega[:-1])))

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Ratios of amplitudes, or amplitudes (N m), (..., S), and outcome of a contact (..., 1).

        There is one model: `model` makes no difference.
        """
        straight(whisker)
        r = np.asarray(contact, dtype=float)[..., 0]
        reached = (r > 0) & (r <= whisker.length)
        outcome = np.where(reached, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        if not self.resolved(whisker):
            outcome[reached] = Outcome.UNRESOLVED
        r = np.where(reached, r, whisker.length)
        value = _amplitudes(whisker, self.count)(r)
        if self.impulse is None:
            value = value[..., 1:] / value[..., :1]
        else:
            # Without r², which the spline leaves out and ratios do not need.
            size = self.impulse / np.sqrt(1 - self.damping_ratio**2)
            value = value * (r**2 * size)[..., None]
        if not self.phase:
            value = np.abs(value)
        return np.where((outcome == Outcome.HELD)[..., None], value, np.nan), outcome

    def noise(self, weber_fraction: float, floor: float) -> GeneralisedWeber:
        """Weber's law for every mode's amplitude, carried to the signals.

        Parameters
        ----------
        weber_fraction : float
            k of each amplitude.
        floor : float
            Sd at a node: of a ratio, or with the impulse known of an amplitude, N m.
        """
        if self.impulse is None:
            return GeneralisedWeber(np.sqrt(2) * weber_fraction, floor=floor, correlation=0.5)
        return GeneralisedWeber(weber_fraction, floor=floor)

    def default_noise(self) -> GeneralisedWeber:
        """Weber's law, k = 0.1 for each amplitude, with a floor at the nodes.

        The floor is 0.05 of a ratio, and 0.1 J m/s of an amplitude: a few per cent of most.
        """
        return self.noise(0.1, 0.05 if self.impulse is None else 0.1 * self.impulse)


_modes = lru_cache(maxsize=32)(modes.modes)


@lru_cache(maxsize=32)
def _amplitudes(whisker: Whisker, count: int) -> Any:
    """Spline over r of the amplitudes at the base over r², (..., count), per N s.

    Divided by r², which every clamped shape starts with, so that their ratios are right down to
    the base.
    """
    from scipy.interpolate import CubicSpline

    modes = _modes(whisker, count)
    s = np.linspace(0, whisker.length, 1001)
    shapes = np.empty((s.size, count))
    shapes[0] = modes.derivative(0.0, 2) / 2
    shapes[1:] = (modes.shape(s[1:]) / s[1:] ** 2).T
    return CubicSpline(s, shapes * (modes.base_moment / modes.angular_frequency))
