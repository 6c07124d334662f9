"""§2h: how far a muscle of limited moment turns a whisker past its first contact.

The muscle's largest moment is a function of the follicle angle θ; the whisker's moment grows with
the rotation past the impact at θ_i. Where the two first meet they balance: the angle θ_b past the
impact is the cue. The whisker's moment, in EI₀/L, is
multiplied by `gain` to compare, so that curves of one shape need gains in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, positive, positive_number
from .._util.values import Array, Codes, Flags, Index, Worded
from ..whisker import Whisker
from . import elastica

#: Figure 3c: the range of whisking, rad.
WHISKING = (np.radians(30.0), np.radians(150.0))
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


def whisking_range(whisking: Any) -> tuple[float, float]:
    """The range of follicle angles, refused where it is not two angles that go up below π."""
    ends = finite("whisking", whisking, "give (low, high) in radians")
    # Beyond the muscle of equation (2.2) pulls the other way.
    if ends.shape != (2,) or not 0 <= ends[0] < ends[1] < np.pi:
        raise ValueError(
            f"whisking must be two angles that go up between 0 and π, got {ends.tolist()}; "
            "give (low, high) in radians."
        )
    return float(ends[0]), float(ends[1])


class Balance(Worded):
    """What became of the muscle against the whisker; `message` says it in words."""

    BALANCED = 0, "balanced: the object holds the whisker at this angle"
    FLICKED_PAST = 1, "flicked past: the muscle is stronger all the way to the fold"
    SLIPPED_OFF_TIP = 2, "slipped off the tip: the muscle is stronger all the way to the tip"
    END_OF_WHISKING = 3, "end of whisking: the range of whisking ends before the balance"
    OUT_OF_REACH = 4, "out of reach: the contact lies beyond the whisker"


@dataclass(frozen=True, eq=False)
class MomentBalance:
    """Where a muscle and a whisker balance.

    Attributes
    ----------
    balance_angle : float or array
        θ_b, rad past the impact; NaN where there is no balance.
    moment : float or array
        The whisker's moment there, N m.
    outcome : Balance or array of int
    end_angle : float or array
        Where the rotation ended for whatever reason, rad past the impact.
    """

    balance_angle: Array
    moment: Array
    outcome: Codes
    end_angle: Array


def moment_balance(
    whisker: Whisker,
    radial_distance: ArrayLike,
    impact_angle: ArrayLike,
    *,
    curve: MuscleCurve = MuscleCurve.NORMALISED,
    gain: float | None = None,
    separation: float = SEPARATION,
    whisking: tuple[float, float] = WHISKING,
    samples: int = 200,
) -> MomentBalance:
    """The angle at which the muscle's largest moment first equals that of the bent whisker.

    Parameters
    ----------
    whisker : Whisker
        Straight.
    radial_distance, impact_angle : float or array
        m; follicle angle at first contact, rad.
    curve : MuscleCurve
        On which of the two scales.
    gain : float, optional
        Muscle units per EI₀/L: M L/EI₀ times `gain` is compared with the curve. Default the
        curve's own, `MuscleCurve.gain`.
    separation : float
        w of equation (2.2).
    whisking : (float, float)
        Range of follicle angles, rad.
    samples : int
        Steps in which the first crossing is looked for, each then solved to the last digits.

    Returns
    -------
    MomentBalance

    Raises
    ------
    ValueError
        For a curved whisker, an impact outside the range of whisking, and what `press` refuses.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6, 3e9)
    >>> b = moment_balance(w, np.array([0.3, 0.5, 0.7]) * 50e-3, np.radians(60))
    >>> np.degrees(b.balance_angle).round(2), [Balance(k).name for k in b.outcome]
    (array([2.54, 6.09,  nan]), ['BALANCED', 'BALANCED', 'FLICKED_PAST'])
    """
    r = positive("radial_distance", radial_distance, "give metres, such as 35e-3")
    impact = finite("impact_angle", impact_angle, "give radians, such as np.radians(60)")
    gain = positive_number(
        "gain",
        curve.gain(separation) if gain is None else gain,
        "give muscle units per EI₀/L, such as 2.0",
    )
    if np.any(np.not_equal(whisker.curvature, 0)):
        raise ValueError(
            "moment_balance() takes a straight whisker, got curvature "
            f"{np.max(np.abs(whisker.curvature)):g} 1/m; write curvature=0."
        )
    low, high = whisking_range(whisking)
    if np.any((impact < low) | (impact > high)):
        raise ValueError(
            f"impact_angle must be in the range of whisking, {low:.4g} to {high:.4g} rad, got "
            f"{np.ravel(impact)[np.argmax(np.abs(impact - (low + high) / 2))]:g}; "
            "change it or `whisking`."
        )
    limit = elastica.flick_past(whisker, r)
    shape = np.broadcast_shapes(np.shape(limit.deflection_angle), impact.shape)
    flick = np.broadcast_to(np.nan_to_num(limit.deflection_angle), shape)
    impact = np.broadcast_to(impact, shape)
    reach = np.minimum(flick * (1 - 1e-12), high - impact)

    def excess(theta: Array) -> Array:
        """Muscle over whisker, > 0 while it still turns; rotation past the impact."""
        bent = np.asarray(elastica.press(whisker, r, theta).normalised_moment)
        return np.asarray(
            curve.moment(impact + theta, separation) - gain * np.nan_to_num(bent, nan=np.inf)
        )

    found, left, right = _first_crossing(excess, reach, samples)
    for _ in range(54):
        middle = (left + right) / 2
        over = excess(middle) > 0
        left, right = np.where(over, middle, left), np.where(over, right, middle)
    outcome = np.select(
        [
            np.broadcast_to(np.equal(limit.ended_by, elastica.Outcome.OUT_OF_REACH), shape),
            found,
            flick > high - impact,
            np.broadcast_to(np.equal(limit.ended_by, elastica.Outcome.SLIPPED_OFF_TIP), shape),
        ],
        [Balance.OUT_OF_REACH, Balance.BALANCED, Balance.END_OF_WHISKING, Balance.SLIPPED_OFF_TIP],
        Balance.FLICKED_PAST,
    ).astype(np.int8)
    balanced = outcome == Balance.BALANCED
    angle = np.where(balanced, left, np.nan)
    end = np.where(balanced, left, np.where(outcome == Balance.OUT_OF_REACH, np.nan, reach))
    moment = elastica.press(whisker, r, np.where(balanced, left, 0.0)).moment
    return MomentBalance(
        angle[()],
        np.where(balanced, moment, np.nan)[()],
        outcome if shape else Balance(int(outcome)),  # type: ignore[arg-type]
        end[()],
    )


def _first_crossing(excess: Any, reach: Array, samples: int) -> tuple[Flags, Array, Array]:
    """Whether and between which angles the excess first falls to zero."""
    k = np.arange(samples + 1).reshape(-1, *(1,) * reach.ndim)
    # Closer steps towards the fold, about which everything goes as a square root.
    place = reach * (1 - (1 - k / samples) ** 2)
    over = np.stack([excess(row) for row in place])

    def of(index: Index) -> Array:
        return np.take_along_axis(place, np.clip(index, 0, samples)[None], axis=0)[0]

    falls = over <= 0
    found, first = np.asarray(falls.any(axis=0)), falls.argmax(axis=0)
    left, right = of(first - 1), of(first)
    if not found.all():
        # A pair of crossings between two samples: look at the very bottom of the lowest dip.
        at = over.argmin(axis=0)
        low, high = of(at - 1), of(at + 1)
        for _ in range(60):
            one, other = low + (high - low) / 3, high - (high - low) / 3
            lower = excess(one) < excess(other)
            low, high = np.where(lower, low, one), np.where(lower, other, high)
        left, right = np.where(found, left, of(at - 1)), np.where(found, right, low)
        found = found | (excess(low) <= 0)
    return found, left, right
