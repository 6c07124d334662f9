"""§2h: the largest moment of the muscle that turns a whisker, as a function of its angle.

The cue `BalanceOfMoments` compares it with the whisker's moment in EI₀/L times a gain.
"""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._util.checks import finite, positive_number
from .._util.values import Array

__all__ = ["SEPARATION", "WHISKING", "MuscleCurve", "whisking_range"]

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
