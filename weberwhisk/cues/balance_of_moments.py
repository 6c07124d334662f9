"""Balance of moments (§2h): distance from how far a muscle turns a whisker past the impact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import number, positive, positive_number, shown
from ..mechanics import closed_form, ladder
from ..mechanics.contact import Outcome
from ..mechanics.muscle import SEPARATION, WHISKING, MuscleCurve, whisking_range
from ..mechanics.surface import base_signals, surface_of
from ..receptors import GeneralisedWeber
from ..whisker import Whisker
from .angle_side_angle import ANGLE_SD
from .protocol import Array, Cue, Felt, straight

#: Steps of Newton's method, with slopes read off a table; relative size of the last that ends it.
STEPS, ENDED = 2, 1e-8


@dataclass(frozen=True, eq=False, repr=False)
class BalanceOfMoments(Cue):
    """Radial distance from the angle θ_b at which muscle and bent whisker balance (§2h).

    The muscle turns the follicle past the impact until the whisker's moment is the muscle's:
    gain·M(r, θ_b)·L/EI₀ = effort·curve(impact + θ_b). With a known effort the angle alone tells of
    distance. Otherwise the effort is felt, with noise, as a second signal, and the deflection
    angle at the balance, which is the true θ_b, is a second unknown.

    Parameters
    ----------
    impact_angle : float
        Follicle angle at first contact, rad; known.
    effort : float or None
        Part of the largest muscle moment that is used, known; None where it is felt.
    curve : MuscleCurve
        Which curve of the largest muscle moment.
    gain, separation, whisking
        As for `moment_balance`: muscle units per EI₀/L, w of equation (2.2), the range of
        follicle angles (rad).

    Raises
    ------
    ValueError
        For an impact outside the range of whisking, an effort or gain that is not positive.

    Notes
    -----
    The first crossing of the two curves is on the rising flank of effort(θ) = gain·M(r,
    θ)/curve(impact + θ): beyond its peak the whisker flicks past. Known and felt effort differ in
    what is flat beforehand: r alone, or r and θ_d.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> cue = BalanceOfMoments(np.radians(60))
    >>> angle, outcome = cue.signals(w, np.array([[15e-3], [25e-3], [35e-3]]))
    >>> np.degrees(angle[:, 0]).round(2), [Outcome(k).name for k in outcome]
    (array([2.54, 6.09,  nan]), ['HELD', 'HELD', 'FLICKED_PAST'])
    >>> r, outcome = cue.radial_distance(w, angle[:2, 0])
    >>> (r * 1e3).round(6)
    array([15., 25.])
    """

    impact_angle: float = float(np.radians(60.0))
    _: KW_ONLY
    effort: float | None = 1.0
    curve: MuscleCurve = MuscleCurve.NORMALISED
    gain: Any = None
    separation: float = SEPARATION
    whisking: Any = WHISKING

    def __post_init__(self) -> None:
        impact = number("impact_angle", self.impact_angle, "give radians, such as 1.05")
        low, high = whisking_range(self.whisking)
        if not low <= impact < high:
            raise ValueError(
                f"impact_angle must be in the range of whisking, {low:.4g} to {high:.4g} rad, got "
                f"{impact:g}; change it or `whisking`."
            )
        if not isinstance(self.curve, MuscleCurve):
            raise ValueError(
                f"curve must be a MuscleCurve, got {shown(self.curve)}; "
                "write MuscleCurve.NORMALISED."
            )
        effort = self.effort
        if effort is not None:
            effort = positive_number("effort", effort, "give a part of the largest, 0.5 say")
        width = positive_number("separation", self.separation, "give w of equation (2.2), 1.25 say")
        gain = self.curve.gain(width) if self.gain is None else self.gain
        self._set(
            impact_angle=impact,
            effort=effort,
            gain=positive_number("gain", gain, "give muscle units per EI₀/L, such as 2.0"),
            separation=width,
            whisking=(low, high),
        )

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The balance angle, and the effort where it is felt."""
        return ("balance_angle", "effort")[: 1 + (self.effort is None)]

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the deflection angle where the effort is felt."""
        return ("radial_distance", "deflection_angle")[: 1 + (self.effort is None)]

    @property
    def room(self) -> float:
        """How far whisking goes on past the impact, rad."""
        return float(self.whisking[1] - self.impact_angle)

    # -- effort --------------------------------------------------------------------------------

    def _muscle(self, theta: Array) -> Array:
        """The largest muscle moment at a rotation past the impact."""
        return self.curve.moment(self.impact_angle + theta, self.separation)

    def _effort(self, whisker: Whisker, r: Array, theta: Array, model: str | None = None) -> Array:
        """The effort that holds a deflection; NaN where the contact is not held."""
        if model == "closed_form":
            moment = closed_form.moment(whisker, r, theta)
        else:
            moment = base_signals(whisker, r, theta)[0][..., 0]
        return np.asarray(self.gain * moment / whisker.moment_scale / self._muscle(theta))

    def _slopes(
        self, whisker: Whisker, r: Array, theta: Array, model: str | None = None
    ) -> tuple[Array, Array]:
        """d effort/dr and d effort/dθ."""
        jacobian = (closed_form if model == "closed_form" else ladder).signal_jacobian(
            whisker, r, theta
        )
        by_r, by_theta = np.moveaxis(jacobian[..., 0, :] / whisker.moment_scale, -1, 0)
        muscle, h = self._muscle(theta), 1e-5
        rise = (self._muscle(theta + h) - self._muscle(theta - h)) / (2 * h) / muscle
        effort = self._effort(whisker, r, theta, model)
        return self.gain * by_r / muscle, self.gain * by_theta / muscle - effort * rise

    def largest_angle(self, whisker: Whisker, radial_distance: Array) -> Array:
        """Largest deflection (...) at which a muscle can be in balance, rad: the observer's edge.

        Where effort(θ) peaks, or where whisking or the contact ends before.
        """
        limit = (
            surface_of(whisker).limit(radial_distance.reshape(-1)).reshape(radial_distance.shape)
        )
        top = np.minimum(limit, self.room)
        return np.asarray(top * _peaks(self, whisker)(radial_distance / whisker.length))

    # -- the cue -------------------------------------------------------------------------------

    def _balance(
        self, whisker: Whisker, r: Array, model: str | None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Rotation at which the known effort is reached, and whether it ever is, (n,) each."""
        assert self.effort is not None
        top, balanced = self._ends(whisker, r, model)
        angle, slope = _guesses(self, whisker, model)(r)
        near = np.flatnonzero(balanced & (angle > 0))
        at, end, step = r[near], top[near], np.full(near.shape, np.inf)
        for _ in range(STEPS):
            step = (self.effort - self._effort(whisker, at, angle[near], model)) / slope[near]
            angle[near] = np.clip(angle[near] + step, 0.0, end)
        # Next to the last balance, within brackets.
        ended = np.zeros(r.shape, dtype=bool)
        ended[near] = np.abs(step) <= ENDED * angle[near]
        left = balanced & ~ended
        if left.any():
            angle[left] = self._bracketed(whisker, r[left], top[left], model)
        return angle, balanced

    def _ends(
        self, whisker: Whisker, r: Array, model: str | None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """The largest rotation, and whether the known effort is reached by then, (n,) each."""
        assert self.effort is not None
        top = np.full(r.shape, self.room)
        if model != "closed_form":
            top = np.nan_to_num(self.largest_angle(whisker, r)) * (1 - 1e-12)
        return top, np.asarray(self._effort(whisker, r, top, model) >= self.effort)

    def _bracketed(self, whisker: Whisker, r: Array, top: Array, model: str | None) -> Array:
        """The rotations (n,) below `top` at which the known effort is reached there, or before."""
        from scipy.optimize.elementwise import find_root

        known = self.effort
        assert known is not None

        def excess(theta: Array, *r: Any) -> Array:
            return self._effort(whisker, r[0], theta, model) - known

        ends = (np.zeros(r.shape), top)
        found = find_root(excess, ends, args=(r,), tolerances={"fatol": 0.0})
        return np.asarray(found.x)

    def signals(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Felt:
        """Balance angle, rad, and effort where it is felt (..., S), and the outcome (...)."""
        straight(whisker)
        contact = np.asarray(contact, dtype=float)
        r = contact[..., 0]
        on_whisker = (r > 0) & (r <= whisker.length) & (r < whisker.apex_distance)
        r = np.where(on_whisker, r, whisker.length / 2)
        if self.effort is None:
            theta = contact[..., 1]
            balanced = np.asarray(on_whisker & (theta > 0))
            if model != "closed_form":
                balanced &= theta <= self.largest_angle(whisker, r)
            theta = np.where(balanced, theta, np.nan)
            safe = np.where(balanced, theta, 1e-3)
            effort = np.where(balanced, self._effort(whisker, r, safe, model), np.nan)
            signals = np.stack([theta, effort], axis=-1)
        else:
            angle, reached = self._balance(whisker, r.reshape(-1), model)
            balanced = on_whisker & reached.reshape(r.shape)
            signals = np.where(balanced, angle.reshape(r.shape), np.nan)[..., None]
        outcome = np.zeros(r.shape, dtype=np.int8)
        lost = ~balanced
        outcome[lost] = np.where(
            on_whisker[lost], self._end(whisker, r[lost]), Outcome.OUT_OF_REACH
        )
        return signals, outcome

    def _end(self, whisker: Whisker, r: Array) -> NDArray[np.int8]:
        """What ends a rotation (n,) without a balance: whisking, or what ends any deflection."""
        _, end = base_signals(whisker, r, np.full(r.shape, np.pi))
        whisked = surface_of(whisker).limit(r) > self.room
        return np.where(whisked, Outcome.END_OF_WHISKING, end).astype(np.int8)

    def jacobian(self, whisker: Whisker, contact: Array, *, model: str | None = None) -> Array:
        """Slopes of the signals (..., S, U): dθ_b/dr = −(∂effort/∂r)/(∂effort/∂θ) of the known."""
        contact = np.asarray(contact, dtype=float)
        signals, _ = self.signals(whisker, contact, model=model)
        r, theta = contact[..., 0], signals[..., 0]
        held = np.isfinite(theta)
        safe_r = np.where(held, r, whisker.length / 2)
        safe = np.where(held, theta, 1e-3)
        by_r, by_theta = self._slopes(whisker, safe_r, safe, model)
        if self.effort is not None:
            return np.where(held, -by_r / by_theta, np.nan)[..., None, None]
        felt = np.stack([by_r, by_theta], axis=-1)
        both = np.stack([np.broadcast_to([0.0, 1.0], felt.shape), felt], axis=-2)
        return np.where(held[..., None, None], both, np.nan)

    def default_noise(self) -> GeneralisedWeber:
        """One degree of angle everywhere, and Weber's law, k = 0.1, of the effort."""
        if self.effort is None:
            return GeneralisedWeber([0.0, 0.1], floor=[ANGLE_SD, 0.0])
        return GeneralisedWeber(0.0, floor=ANGLE_SD)

    def farthest(self, whisker: Whisker) -> float:
        """As far as a balance is reached, m; the tip where the effort is felt."""
        length = float(whisker.length)
        if self.effort is not None:
            last = _last_balance(self, whisker, None)
            if last == 0:
                raise ValueError(
                    f"No contact balances an effort of {self.effort:g} after an impact at "
                    f"{self.impact_angle:.3g} rad; write a smaller effort or an earlier impact."
                )
            return last
        return length

    def radial_distance(
        self, whisker: Whisker, balance_angle: ArrayLike, effort: ArrayLike | None = None
    ) -> tuple[Array, NDArray[np.int8]]:
        """The distance at which muscle and whisker balance at an angle, m, and its outcome.

        The effort that a deflection takes falls with distance: bisection. NaN and
        `OUT_OF_REACH` where no contact gives the angle.
        """
        theta = positive("balance_angle", balance_angle, "give radians past the impact")
        known = self.effort if effort is None else effort
        if known is None:
            raise ValueError(
                "The effort of this cue is felt, got none; write effort=1.0 for the largest, say."
            )
        wanted = positive("effort", known, "give a part of the largest, 0.5 say")
        theta, wanted = np.broadcast_arrays(theta, wanted)
        low, high = np.zeros(theta.shape), np.full(theta.shape, float(whisker.length))
        for _ in range(60):
            r = (low + high) / 2
            far = ~(theta <= self.largest_angle(whisker, r))
            effort_here = self._effort(whisker, r, np.where(far, 1e-6, theta))
            far |= effort_here < wanted
            low, high = np.where(far, low, r), np.where(far, r, high)
        found = np.abs(self._effort(whisker, np.maximum(low, 1e-9), theta) / wanted - 1) < 1e-6
        outcome = np.where(found, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        return np.where(found, low, np.nan), outcome


@lru_cache(maxsize=64)
def _peaks(cue: BalanceOfMoments, whisker: Whisker) -> Callable[[Array], Array]:
    """Where effort(θ) peaks, over the largest angle there is, against r/L."""
    from scipy.interpolate import PchipInterpolator

    share = (1 - np.cos(np.linspace(0, np.pi, 201)[1:-1])) / 2
    r = share * whisker.length
    top = np.minimum(surface_of(whisker).limit(r), cue.room)
    low, high = np.zeros(r.shape), np.ones(r.shape)
    for _ in range(30):  # effort is level there: an angle off by 1e-9 is nothing
        middle = (low + high) / 2
        rises = cue._slopes(whisker, r, middle * top)[1] > 0
        low, high = np.where(rises, middle, low), np.where(rises, high, middle)
    ends = np.concatenate([high[:1], high, high[-1:]])
    interpolant: Callable[[Array], Array] = PchipInterpolator(
        np.concatenate([[0.0], share, [1.0]]), ends
    )
    return interpolant


@lru_cache(maxsize=64)
def _guesses(
    cue: BalanceOfMoments, whisker: Whisker, model: str | None
) -> Callable[[Array], tuple[Array, Array]]:
    """Nearly the rotation at a balance, and d effort/dθ there, as functions of r (n,), m.

    Near the base the one goes with r, the other with 1/r; NaN past the last balance.
    """
    from scipy.interpolate import CubicSpline

    # Next to the last balance the rotation changes as a root does: evenly in phi.
    phi = np.linspace(0, np.pi, 258)[1:-1]
    last = _last_balance(cue, whisker, model)
    r = last * (1 - np.cos(phi)) / 2
    top, balanced = cue._ends(whisker, r, model)
    if not balanced.all():  # none, or not in one stretch: all by brackets
        return lambda r: (np.full(r.shape, np.nan), np.full(r.shape, np.nan))
    angle = cue._bracketed(whisker, r, top, model)
    slope = cue._slopes(whisker, r, angle, model)[1]
    table = CubicSpline(phi, np.stack([angle / r, slope * r], axis=-1))

    def guess(at: Array) -> tuple[Array, Array]:
        place = np.arccos(np.clip(1 - 2 * at / last, -1.0, 1.0))
        ratio, product = table(np.maximum(place, phi[0])).T
        return ratio * at, product / at

    return guess


@lru_cache(maxsize=64)
def _last_balance(cue: BalanceOfMoments, whisker: Whisker, model: str | None) -> float:
    """The first distance from the base at which there is no balance, m; 0 where there is none."""

    def balances(r: Array) -> NDArray[np.bool_]:
        return cue._ends(whisker, r, model)[1]

    r = np.linspace(0.005, 1 - 1e-9, 400) * whisker.length
    held = balances(r)
    if held.all():
        return float(whisker.length)
    if not held[0]:
        return 0.0
    for _ in range(9):  # to the last digits
        first = held.argmin()
        r = np.linspace(r[first - 1], r[first], 64)
        held = balances(r)
    return float(r[held.argmin() - 1])
