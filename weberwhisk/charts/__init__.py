"""Speed against accuracy, measured here and now: beams, posteriors, JNDs, fits and growth.

Every part is a table in one form, a row for each method, scene and setting of the method's own
knob: `part`, `scene`, `method`, `knob`, `seconds` (CPU of one core, of one solution), `error`,
`failed` (share without an answer, or flagged by the method itself). Time and error are of the same
run. Rows of other tools may be joined to them; `weberwhisk.figures.speed_accuracy` draws either.
"""

from ..citing import machine
from . import beams, fits, posteriors

#: Name of each part, and what measures it: ``measure(full=...)`` gives its table.
PARTS = {
    "beams": beams.measure,
    "posteriors": posteriors.measure,
    "jnds": posteriors.measure_jnds,
    "fits": fits.measure,
    "growth": fits.measure_growth,
}

__all__ = ["PARTS", "beams", "fits", "machine", "posteriors"]
