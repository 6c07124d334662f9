"""The Runge–Kutta method of order 8 under beam and rod: SciPy's DOP853, for many rows.

Slopes are kept with those of stages 1 and 2 first, which later stages do not use: each stage then
needs one product with neighbouring slopes, and the end of the step and its error are one more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853

Array = NDArray[np.float64]

STAGES = 12
#: Where in a step the stages lie.
PLACES = np.asarray(DOP853.C[:STAGES], dtype=float)
_ORDER = [1, 2, 0, *range(3, STAGES)]
#: Where the slope of each stage is kept.
SLOTS = [_ORDER.index(i) for i in range(STAGES)]


def _stage(i: int) -> tuple[slice, Array]:
    row = np.asarray(DOP853.A[i, _ORDER], dtype=float)
    used = np.flatnonzero(row)
    part = slice(used[0], used[-1] + 1) if used.size else slice(0, 0)
    return part, np.ascontiguousarray(row[part])


#: The slopes that make each stage's point, and their weights.
POINTS = [_stage(i) for i in range(STAGES)]
#: The weights of the step, and of its estimate of error of order h⁶.
ENDS: Array = np.ascontiguousarray(np.stack([DOP853.B, DOP853.E5[:STAGES]])[:, _ORDER], dtype=float)
#: What h⁶ estimates to the power of 3/2 are multiplied with for a bound on the method's own error,
#: of order h⁹, which then holds in 99 of 100 whiskers and exceeds the error by 7 in the median.
#: Hairer, Nørsett & Wanner (I, II.10) also use an estimate of order h⁴; but for the norm of all
#: parts of the state, which do not pass through zero together, this is closer, with less scatter.
CAUTION = 4.0
