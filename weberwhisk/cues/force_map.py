"""The map of moment and forces in the plane (§2f): contacts from signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import numbers, one_or_more, positive_number, refuse_hinge
from .._util.values import Array, Codes
from ..mechanics import Profile, closed_form, rest_angle
from ..mechanics.contact import Outcome
from ..mechanics.forward import forward_of
from ..receptors import GeneralisedWeber, Joint, ReceptorNoise, Weber
from ..whisker import Whisker
from .protocol import Cue, Encoded, reach_at, readings

__all__ = ["SIGNALS", "ForceMap", "MeasuredAngle", "is_curved"]

SIGNALS = ("moment", "axial_force", "transverse_force")


@dataclass(frozen=True, eq=False, repr=False, init=False)
class ForceMap(Cue):
    """Radial distance, and deflection angle where unknown, from moment and forces at the base.

    Moment M and axial force Fx, the paper's pair, are one-to-one with the contact on a tapered
    whisker; on a cylinder M² = 2EI·Fx at every contact, so that the map collapses to a curve and
    the posterior to a ridge. With the transverse force Fy (Scholz & Rahn 2004) either of the
    others will do, on a cylinder too. At a known angle the moment is enough.

    Parameters
    ----------
    signal_names : sequence of {"moment", "axial_force", "transverse_force"}
        Which are encoded.
    deflection_angle : float, optional
        θ_d, rad, where it is known; by default it is unknown. On a curved whisker counted from
        where it first touches: ``press(w, r, rest_angle(w, r) + deflection_angle)``.

    Raises
    ------
    ValueError
        For a signal that there is not, none or one twice, and an angle that is not positive.

    Notes
    -----
    The transverse force is that across the base tangent, and changes its sign where the contact
    angle passes 90°, the axial force of a whisker on its concave side at light contacts: where they
    do, their noise has a floor (`inference.default_noise`). Unknown stiffness is
    `UnknownStiffness`; noise with a correlation, one Weber fraction a signal, is `Weber`'s.

    Examples
    --------
    >>> w = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
    >>> signals, outcome = ForceMap().signals(w, np.array([30e-3, 0.4]))
    >>> contact, outcome = ForceMap().contact(w, signals)
    >>> contact.round(9)
    array([0.03, 0.4 ])
    """

    takes_curved = True
    signal_names: tuple[str, ...] = SIGNALS[:2]
    _: KW_ONLY
    deflection_angle: float | None = None

    def __init__(
        self, signal_names: Sequence[str] = SIGNALS[:2], *, deflection_angle: float | None = None
    ) -> None:
        names = one_or_more("signals", signal_names, SIGNALS)
        if deflection_angle is not None:
            hint = "give radians, or None where it is unknown"
            deflection_angle = positive_number("deflection_angle", deflection_angle, hint)
        self._set(signal_names=names, deflection_angle=deflection_angle)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the deflection angle where it is not known."""
        return ("radial_distance", "deflection_angle")[: 1 + (self.deflection_angle is None)]

    @cached_property
    def _columns(self) -> list[int]:
        """Columns of the signals among all three."""
        return [SIGNALS.index(name) for name in self.signal_names]

    def _place(self, contact: Array) -> tuple[Array, Array]:
        """Distance and angle of a contact."""
        contact = np.asarray(contact, dtype=float)
        r = contact[..., 0]
        if self.deflection_angle is None:
            return r, contact[..., 1]
        return r, np.full_like(r, self.deflection_angle)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        """Moment (N m) and forces (N), (..., S), and outcome of a contact (..., U)."""
        signals, outcome = forward_of(whisker, model).signals(*self._place(contact))
        if self._columns == [0, 1]:  # a view, where it will do: the bulk of all work
            return signals[..., :2], outcome
        return signals[..., self._columns], outcome

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        r, theta = self._place(contact)
        slope = forward_of(whisker, model).jacobian(r, theta)
        return slope[..., self._columns, : len(self.unknowns)]

    def farthest(self, whisker: Whisker) -> float:
        """The tip, or where the whisker flicks past at the known angle, m."""
        if self.deflection_angle is None:
            return forward_of(whisker).reach
        return reach_at(whisker, self.deflection_angle, "deflection_angle")

    # -- inverse -------------------------------------------------------------------------------

    def contact(self, whisker: Whisker, signals: ArrayLike) -> Encoded:
        """The contact that gives these signals: of two signals, or of the moment at a known angle.

        Newton's method from the closed-form inverse, or from the nearest contact of a coarse map;
        bisection at a known angle, where the moment falls with distance.

        Parameters
        ----------
        whisker : Whisker
        signals : array, shape (..., S)
            Moment (N m) and forces (N), as in `signal_names`; of the moment alone also (...).

        Returns
        -------
        contact : array, shape (..., U)
            r (m) and θ_d (rad); NaN where no held contact on this whisker gives the signals.
        outcome : array of int
            `HELD`, or `OUT_OF_REACH` where there is none: every reading of M and Fx on a cylinder,
            and readings too stiff or too slack for this taper.

        Raises
        ------
        ValueError
            For any other set of signals: more than the unknowns have no exact inverse, and a force
            alone at a known angle has several.
        """
        wanted = numbers("signals", signals, "give the base signals in SI units")
        if self.deflection_angle is not None and self.signal_names == ("moment",):
            alone = wanted.ndim == 0 or wanted.shape[-1] != 1
            wanted = readings("signals", wanted[..., None] if alone else wanted, 1)
            contact = self._bisect(whisker, wanted)
        elif self.deflection_angle is None and len(self.signal_names) == 2:
            wanted = readings("signals", wanted, 2)
            order = np.argsort(self._columns)  # as the closed form has them
            ordered = ForceMap([self.signal_names[i] for i in order])
            contact = ordered._solve(whisker, wanted[..., order])
        else:
            raise ValueError(
                f"There is no unique contact for the signals of {self!r}; write "
                "ww.posterior(observer, reading), which needs none."
            )
        lost = np.isnan(contact[..., 0])
        return contact, np.where(lost, Outcome.OUT_OF_REACH, Outcome.HELD).astype(np.int8)

    def reading_outcome(self, whisker: Whisker, reading: Array) -> Codes:
        """What `contact` says of readings (..., S); `HELD` where there is no unique inverse."""
        known = self.deflection_angle is not None
        if (self.signal_names != ("moment",)) if known else (len(self.signal_names) != 2):
            return np.zeros(reading.shape[:-1], dtype=np.int8)
        return self.contact(whisker, reading)[1]

    def _bisect(self, whisker: Whisker, wanted: Array) -> Array:
        low = np.full(wanted.shape, 1e-9 * forward_of(whisker).length)
        high = np.full(wanted.shape, self.farthest(whisker))
        ends = [self.signals(whisker, end)[0] for end in (high * (1 - 1e-12), low)]
        inside = (wanted >= ends[0]) & (wanted <= ends[1])
        for _ in range(80):
            middle = (low + high) / 2
            farther = self.signals(whisker, middle)[0] > wanted
            low, high = np.where(farther, middle, low), np.where(farther, high, middle)
        return np.where(inside, (low + high) / 2, np.nan)

    def _solve(self, whisker: Whisker, wanted: Array) -> Array:
        contact = np.full(wanted.shape, np.nan)
        if self.signal_names == SIGNALS[:2]:
            forward = forward_of(whisker)
            r, bent = closed_form.contact_from_signals(forward.base, wanted[..., 0], wanted[..., 1])
            known = np.isfinite(r)
            angle = bent + forward.hinge_compliance * wanted[..., 0]
            contact[known] = self._newton(whisker, wanted[known], r[known], angle[known])
        # Large angles are far from the closed form: start again from the nearest of a coarse map.
        missed = np.isnan(contact[..., 0]) & (np.abs(wanted) > 0).all(axis=-1)
        one_to_one = not forward_of(whisker).is_plain or np.any(whisker.taper)
        if np.any(missed) and (one_to_one or self.signal_names != SIGNALS[:2]):
            contact[missed] = self._newton(
                whisker, wanted[missed], *self._nearest(whisker, wanted[missed])
            )
        return contact

    def _size(self, whisker: Whisker, wanted: Array) -> Array:
        """Of the signals; of the transverse force, which passes through zero, not much less."""
        size = np.abs(wanted)
        if 2 in self._columns[1:]:
            other = size[..., 0] / (forward_of(whisker).length if self._columns[0] == 0 else 1.0)
            size[..., 1] = np.maximum(size[..., 1], 0.1 * other)
        return size

    def _nearest(self, whisker: Whisker, wanted: Array) -> tuple[Array, Array]:
        """The contact of a coarse map whose signals are nearest in logarithms, (n,) each."""
        forward = forward_of(whisker)
        r = np.linspace(0.01, 0.99, 50)[:, None] * forward.reach
        share = np.sin(np.linspace(0.02, 0.98, 50) * np.pi / 2)
        theta = share * forward.limit(r)
        grid = np.stack(np.broadcast_arrays(r, theta), axis=-1).reshape(-1, 2)
        known = self.signals(whisker, grid)[0]
        sizes = self._size(whisker, wanted)
        best = [
            np.nansum(_miss(known, y, size)[0] ** 2, axis=1).argmin()
            for y, size in zip(wanted, sizes, strict=True)
        ]
        return grid[best, 0], grid[best, 1]

    def _newton(self, whisker: Whisker, wanted: Array, r: Array, theta: Array) -> Array:
        """Newton's method in ln r and ln θ_d. NaN where it fails."""
        forward = forward_of(whisker)
        length = forward.reach
        contact = np.stack([np.minimum(r, 0.98 * length), theta], axis=-1)
        found, size = np.full(wanted.shape, np.nan), self._size(whisker, wanted)
        left = np.arange(len(wanted))
        least, since = np.full(len(wanted), np.inf), np.zeros(len(wanted), dtype=int)
        for _ in range(60):
            r, theta = contact[left].T
            point = np.stack([r, np.minimum(theta, 0.995 * forward.limit(r))], axis=-1)
            signals = self.signals(whisker, point)[0]
            miss, slope = _miss(signals, wanted[left], size[left])
            (a, b), (c, d) = np.moveaxis(
                self.jacobian(whisker, point) * slope[..., :, None] * point[..., None, :], 0, -1
            )
            with np.errstate(divide="ignore", invalid="ignore"):
                move = np.stack([d * miss[:, 0] - b * miss[:, 1], a * miss[:, 1] - c * miss[:, 0]])
                move = np.clip(move / (a * d - b * c), -0.3, 0.3).T
                after = point * np.exp(move)
            after[:, 0] = np.where(after[:, 0] < length, after[:, 0], (point[:, 0] + length) / 2)
            near = np.all(np.abs(miss) < 1e-9, axis=-1)
            found[left] = np.where(near[:, None], after, np.nan)
            contact[left] = after
            # A point at which the signals depend on one unknown alone leads nowhere, nor do ten
            # steps that come no nearer.
            far = np.abs(miss).max(axis=-1)
            since[left] = np.where(far < 0.99 * least[left], 0, since[left] + 1)
            least[left] = np.fmin(far, least[left])
            going = ~near & np.isfinite(after).all(axis=-1) & (since[left] < 10)
            left = left[going]
            if not left.size:
                break
        return found


def _miss(signals: Array, wanted: Array, size: Array) -> tuple[Array, Array]:
    """How far signals are from those wanted, and how fast that falls with each signal.

    On an axis that is logarithmic for signals that are far too large, as there the map is nearly
    linear, and that passes through zero smoothly.
    """
    miss = np.arcsinh(wanted / size) - np.arcsinh(signals / size)
    return miss, 1 / np.hypot(signals, size)


def is_curved(whisker: Any) -> bool:
    """Whether a Whisker or Profile is curved anywhere."""
    return any(np.any(value) for value in vars(Profile.of(whisker).law).values())


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredAngle(Cue):
    """A map of forces, and the deflection angle as video shows it, with an error of its own.

    The angle is that from the base tangent, on curved whiskers too, whose unknown deflection angle
    is counted from the first touch.

    Parameters
    ----------
    cue : Cue
        Of a distance and an unknown deflection angle.

    Examples
    --------
    >>> cue = MeasuredAngle(ForceMap(["moment"]))
    >>> cue.signal_names, cue.unknowns
    (('moment', 'measured_angle'), ('radial_distance', 'deflection_angle'))
    """

    cue: Cue
    takes_curved = True

    @property
    def signal_names(self) -> tuple[str, ...]:
        return (*self.cue.signal_names, "measured_angle")

    @property
    def unknowns(self) -> tuple[str, ...]:
        return self.cue.unknowns

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Encoded:
        refuse_hinge(whisker, "MeasuredAngle")
        contact = np.asarray(contact, dtype=float)
        signals, outcome = self.cue.signals(whisker, contact, model=model)
        angle, held = contact[..., 1].copy(), outcome == Outcome.HELD
        if is_curved(whisker) and held.any():
            angle[held] += rest_angle(whisker, contact[held, 0])
        return np.concatenate([signals, angle[..., None]], axis=-1), outcome

    def default_noise(self) -> ReceptorNoise:
        """Weber's law with k = 0.1, and a degree of the angle."""
        angle = GeneralisedWeber(0.0, floor=float(np.radians(1.0)))
        return Joint([Weber(0.1), angle], [len(self.cue.signal_names), 1])
