"""Balance of moments (§2h): distance from how far a muscle turns a whisker past the impact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from enum import Enum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, number, positive_number, shown
from .._util.refusals import Refusal
from .._util.values import Array, Flags
from ..mechanics import closed_form
from ..mechanics.contact import Outcome
from ..mechanics.forward import ForwardModel, forward_of
from ..receptors import GeneralisedWeber
from .protocol import ANGLE_SD, Cue, Encoded

__all__ = ["BalanceOfMoments", "MuscleCurve"]

#: w of equation (2.2), at the centre of the pad (§2h).
SEPARATION = 1.25


class MuscleCurve(Enum):
    """Equation (2.2), on two scales.

    PRINTED is the equation as it stands, whose peak is w/2 (1 for w ≥ 2), near 128.7° for w = 1.25;
    NORMALISED is the same over its peak.

    Notes
    -----
    The equation is the sine of the angle at which a muscle pulls on the follicle, in a triangle:
    the follicle is a lever of length 2 from its pivot, the muscle's other end lies w from that
    pivot, and these two sides enclose 180° − θ. So w is the follicles' separation over *half* the
    lever's length, where the paper's words have half the ratio of separation to length. The
    arctangent must be that of the full circle: the principal value jumps by 180° where
    cos θ = −w/2 (128.7°), inside the range of whisking, and the moment from +w/2 to −w/2.
    """

    PRINTED = "printed"
    NORMALISED = "normalised"

    def moment(self, angle: ArrayLike, separation: float = SEPARATION) -> Array:
        """Largest muscle moment at the follicle angle `angle`, rad.

        Parameters
        ----------
        angle : float or array
            rad.
        separation : float
            w of equation (2.2).

        Examples
        --------
        >>> print(MuscleCurve.NORMALISED.moment(np.radians([30, 128.68, 150])).round(3))
        [0.318 1.    0.901]
        """
        theta = finite("angle", angle, "give radians")
        w = positive_number("separation", separation, "give w of equation (2.2), such as 1.25")
        inner = np.arctan2(2 * np.sin(theta), w + 2 * np.cos(theta))
        return np.asarray(np.sin(theta - inner) / self._unit(w))

    def gain(self, separation: float = SEPARATION) -> float:
        """The factor on M L/EI₀ with which figure 3's whisker flicks past from 0.697 L on.

        The paper scaled the moments so that it "tended to flick past the object when contact
        occurred at around 70 per cent of vibrissa length": 2.0 for a curve whose peak is 1.

        Examples
        --------
        >>> MuscleCurve.NORMALISED.gain(), MuscleCurve.PRINTED.gain()
        (2.0, 1.25)
        """
        return 2.0 * min(separation / 2, 1.0) / self._unit(separation)

    def _unit(self, w: float) -> float:
        # sin(θ − atan2(…)) = w sin θ/√(w² + 4w cos θ + 4): its peak is w/2 below w = 2, else 1.
        return 1.0 if self is MuscleCurve.PRINTED else min(w / 2, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class BalanceOfMoments(Cue):
    """Radial distance from the angle θ_b at which muscle and bent whisker balance (§2h).

    The muscle turns the follicle past the impact until the whisker's moment is the muscle's:
    gain·M(r, θ_b)·L/EI₀ = effort·curve(impact + θ_b). With a known effort the angle alone informs
    of distance. Otherwise the effort is sensed, with noise, as a second signal, and the deflection
    angle at the balance, which is the true θ_b, is a second unknown. Angles of a curved whisker are
    from where it first touches.

    Parameters
    ----------
    impact_angle : float
        Follicle angle at first contact, rad; known.
    effort : float or None
        Part of the largest muscle moment that is used, known; None where it is sensed.
    curve : MuscleCurve
        Which curve of the largest muscle moment.
    gain, separation, whisking
        Muscle units per EI₀/L (default `MuscleCurve.gain`), w of equation (2.2), the range of
        follicle angles (rad; default figure 3c's).

    Raises
    ------
    ValueError
        For an impact outside the range of whisking, an effort or gain that is not positive.

    Notes
    -----
    The first crossing of the two curves is on the rising flank of effort(θ) = gain·M(r,
    θ)/curve(impact + θ): beyond its peak the whisker flicks past. Known and sensed effort differ in
    what is flat beforehand: r alone, or r and θ_d. Of models that are named, the closed form and
    the straight elastica serve; any other is the table of the one that leaves nothing out.

    Examples
    --------
    >>> from weberwhisk import Whisker
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> cue = BalanceOfMoments(np.radians(60))
    >>> angle, outcome = cue.signals(w, np.array([[15e-3], [25e-3], [35e-3]]))
    >>> np.degrees(angle[:, 0]).round(2), [Outcome(k).name for k in outcome]
    (array([2.54, 6.09,  nan]), ['HELD', 'HELD', 'FLICKED_PAST'])
    """

    takes_curved = True
    impact_angle: float = float(np.radians(60.0))
    _: KW_ONLY
    effort: float | None = 1.0
    curve: MuscleCurve = MuscleCurve.NORMALISED
    gain: float | None = None
    separation: float = SEPARATION
    whisking: tuple[float, float] = (float(np.radians(30.0)), float(np.radians(150.0)))

    def __post_init__(self) -> None:
        impact = number("impact_angle", self.impact_angle, "give radians, such as 1.05")
        low, high = whisking_range(self.whisking)
        if not low <= impact < high:
            raise Refusal(
                f"impact_angle must be in the range of whisking, {low:.4g} to {high:.4g} rad",
                f"{impact:g}",
                "change it or `whisking`",
            )
        if not isinstance(self.curve, MuscleCurve):
            raise Refusal(
                "curve must be a MuscleCurve",
                shown(self.curve),
                "write ww.mechanics.MuscleCurve.NORMALISED",
            )
        effort = self.effort
        if effort is not None:
            effort = positive_number("effort", effort, "give a part of the largest, 0.5 say")
        width = positive_number("separation", self.separation, "give w of equation (2.2), 1.25 say")
        gain = self.gain
        if gain is not None:
            gain = positive_number("gain", gain, "give muscle units per EI₀/L, such as 2.0")
        self._set(
            impact_angle=impact, effort=effort, gain=gain, separation=width, whisking=(low, high)
        )

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The balance angle, and the effort where it is sensed."""
        return ("balance_angle", "effort")[: 1 + (self.effort is None)]

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The distance, and the deflection angle where the effort is sensed."""
        return ("radial_distance", "deflection_angle")[: 1 + (self.effort is None)]

    @property
    def _gain(self) -> float:
        return self.curve.gain(self.separation) if self.gain is None else self.gain

    @property
    def room(self) -> float:
        """How far whisking goes on past the impact, rad."""
        return float(self.whisking[1] - self.impact_angle)

    # -- effort --------------------------------------------------------------------------------

    def _effort(self, whisker: Any, r: Array, theta: Array, model: str | None = None) -> Array:
        """The effort that holds a deflection; NaN where the contact is not held."""
        forward = _served(whisker, model)
        if model == "closed_form":
            moment = closed_form.moment(forward.base, r, 1.0)
            moment = theta * moment / (1 + forward.hinge_compliance * moment)
        else:
            moment = forward.signals(r, theta)[0][..., 0]
        muscle = self.curve.moment(self.impact_angle + theta, self.separation)
        return np.asarray(self._gain * moment / forward.base.moment_scale / muscle)

    def largest_angle(self, whisker: Any, radial_distance: Array) -> Array:
        """Largest deflection (...) at which a muscle can be in balance, rad: the observer's edge.

        Where effort(θ) peaks, or where whisking or the contact ends before.
        """
        forward = _served(whisker)
        top = np.minimum(forward.limit(radial_distance), self.room)
        share = forward.between(_peaks(self, forward.extremes(1)[0])(radial_distance))
        return np.asarray(top * share)

    # -- the cue -------------------------------------------------------------------------------

    def _ends(self, whisker: Any, r: Array, model: str | None) -> tuple[Array, Flags]:
        """The largest rotation, and whether the known effort is reached by then, (...) each."""
        assert self.effort is not None
        top = np.full(r.shape, self.room)
        if model != "closed_form":
            top = np.nan_to_num(self.largest_angle(whisker, r)) * (1 - 1e-12)
        return top, np.asarray(self._effort(whisker, r, top, model) >= self.effort)

    def _balance(self, whisker: Any, r: Array, model: str | None) -> tuple[Array, Flags]:
        """Rotation at which the known effort is reached, and whether it ever is, (...) each."""
        from scipy.optimize.elementwise import find_root

        effort, (top, balanced) = self.effort, self._ends(whisker, r, model)
        assert effort is not None
        forward = _served(whisker, model)
        given = {n: getattr(forward, n) for n in ("friction", "offset", "hinge")}
        given = {name: value for name, value in given.items() if np.ndim(value)}

        def excess(theta: Array, r: Array, *values: Array) -> Array:
            uncertain: dict[str, Any] = dict(zip(given, values, strict=True))
            return self._effort(replace(forward, **uncertain), r, theta, model) - effort

        with np.errstate(invalid="ignore"):
            solution = find_root(excess, (np.zeros(r.shape), top), args=(r, *given.values()))
        return np.asarray(solution.x), balanced

    def signals(self, whisker: Any, contact: Array, *, model: str | None = None) -> Encoded:
        """Balance angle, rad, and effort where it is sensed (..., S), and the outcome (...)."""
        contact = np.asarray(contact, dtype=float)
        forward = _served(whisker)
        r, limit = contact[..., 0], forward.limit(contact[..., 0])
        on_whisker = (r > 0) & (r < forward.base.apex_distance) & np.isfinite(limit)
        r = np.where(on_whisker, r, forward.reach / 2)
        if self.effort is None:
            theta = contact[..., 1]
            balanced = np.asarray(on_whisker & (theta > 0))
            if model != "closed_form":
                balanced &= theta <= self.largest_angle(whisker, r)
            effort = self._effort(whisker, r, np.where(balanced, theta, 1e-3), model)
            balanced &= np.isfinite(effort)
            signals = np.stack([theta, effort], axis=-1)
        else:
            angle, reached = self._balance(whisker, r, model)
            balanced, signals = on_whisker & reached, angle[..., None]
        outcome = np.where(on_whisker, Outcome.HELD, Outcome.OUT_OF_REACH).astype(np.int8)
        lost = on_whisker & ~balanced
        if lost.any():
            beyond = np.nan_to_num(limit) + 1.0
            end = np.where(
                limit > self.room, Outcome.END_OF_WHISKING, forward.signals(r, beyond)[1]
            )
            outcome[lost] = end[lost]
        return np.where(balanced[..., None], signals, np.nan), outcome

    def default_noise(self) -> GeneralisedWeber:
        """One degree of angle at every angle, and Weber's law, k = 0.1, of the effort."""
        if self.effort is None:
            return GeneralisedWeber([0.0, 0.1], floor=[ANGLE_SD, 0.0])
        return GeneralisedWeber(0.0, floor=ANGLE_SD)

    def farthest(self, whisker: Any) -> float:
        """As far as a balance is reached, m; the tip where the effort is sensed."""
        forward = forward_of(whisker)
        if self.effort is None:
            return forward.reach
        last = max(_last_balance(self, f, None) for f in forward.extremes())
        if last == 0:
            raise Refusal(
                f"No contact balances an effort of {self.effort:g} after an impact at "
                f"{self.impact_angle:.3g} rad",
                remedy="write a smaller effort or an earlier impact",
            )
        return last


def _served(whisker: Any, model: str | None = None) -> ForwardModel:
    """The forward model whose table serves."""
    forward = forward_of(whisker)
    straight = model == "elastica" and not forward.is_plain
    return replace(forward, model=model if straight else None)


@lru_cache(maxsize=64)
def _peaks(cue: BalanceOfMoments, forward: ForwardModel) -> Callable[[Array], Array]:
    """Where effort(θ) peaks, over the largest angle there is, against r, at all extremes."""
    from scipy.interpolate import PchipInterpolator

    share = (1 - np.cos(np.linspace(0, np.pi, 201)[1:-1])) / 2
    r, ends = share * forward.reach, []
    for model in forward.extremes(5):
        top = np.minimum(model.limit(r), cue.room)
        reached = np.isfinite(top)
        top[~reached] = 0.0
        low, high = np.zeros(r.shape), np.ones(r.shape)
        for _ in range(30):  # effort is level there: an angle off by 1e-9 is nothing
            middle = (low + high) / 2
            sides = np.minimum(middle + 1e-7, 1 - 1e-12), middle - 1e-7
            after, before = (cue._effort(model, r, side * top) for side in sides)
            rises = after > before
            low, high = np.where(rises, middle, low), np.where(rises, high, middle)
        high[~reached] = high[reached][-1]  # beyond its tip: anything smooth
        ends.append(np.concatenate([high[:1], high, high[-1:]]))
    places = np.concatenate([[0.0], r, [forward.reach]])
    interpolant: Callable[[Array], Array] = PchipInterpolator(places, np.stack(ends, axis=-1))
    return interpolant


@lru_cache(maxsize=64)
def _last_balance(cue: BalanceOfMoments, forward: ForwardModel, model: str | None) -> float:
    """The first distance from the base at which there is no balance, m; 0 where there is none."""

    def balances(r: Array) -> Flags:
        return cue._ends(forward, r, model)[1]

    r = np.linspace(0.005, 1 - 1e-9, 400) * forward.reach
    balanced = balances(r)
    if balanced.all():
        return forward.reach
    if not balanced[0]:
        return 0.0
    for _ in range(9):  # to the last digits
        first = balanced.argmin()
        r = np.linspace(r[first - 1], r[first], 64)
        balanced = balances(r)
    return float(r[balanced.argmin() - 1])


def whisking_range(whisking: Any) -> tuple[float, float]:
    """The range of follicle angles, refused where it is not two angles that go up below π."""
    ends = finite("whisking", whisking, "give (low, high) in radians")
    # Beyond the muscle of equation (2.2) pulls the other way.
    if ends.shape != (2,) or not 0 <= ends[0] < ends[1] < np.pi:
        raise Refusal(
            "whisking must be two angles that go up between 0 and π",
            ends.tolist(),
            "give (low, high) in radians",
        )
    return float(ends[0]), float(ends[1])
