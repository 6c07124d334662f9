"""How far out a whisker holds a contact at a given deflection angle."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from ..mechanics.forward import ForwardModel, forward_of
from ..whisker import Whisker


def reach_at(whisker: Whisker | ForwardModel, deflection_angle: float, name: str) -> float:
    """Largest radial distance at which an angle is held: the tip, or where it flicks past, m.

    Parameters
    ----------
    whisker : Whisker or ForwardModel
    deflection_angle : float
        From where it first touches, rad.
    name : str
        Of the angle, for the refusal.

    Raises
    ------
    ValueError
        For an angle that is held nowhere.

    Examples
    --------
    >>> w = Whisker(50e-3, 100e-6, 5e-6)
    >>> round(reach_at(w, np.radians(24.5732), "tap_angle") / w.length, 5)
    0.7
    """
    forward = forward_of(whisker)
    length = forward.reach

    def room(fraction: float) -> float:
        last = max(f.limit(fraction * length) for f in forward.extremes())
        # The tip of a perfect cone holds no contact at all.
        return float(np.nan_to_num(last)) - deflection_angle

    if room(1e-6) < 0:
        raise ValueError(
            f"No contact holds a {name} of {np.degrees(deflection_angle):.1f} degrees; "
            "write a smaller one."
        )
    if room(1.0) >= 0:
        return length
    return length * float(brentq(room, 1e-6, 1.0, xtol=1e-13, rtol=1e-13))
