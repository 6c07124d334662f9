"""Charts of results: each takes a result and, optionally, axes, and returns the axes.

Nothing is computed here but the scaling of axes and the error bars of counts. Colours are those of
Okabe and Ito, which colour-blind readers can distinguish, and every colour comes with its own
marker or line style, so that figures can be read in grey.
"""

from .choices import population, psychometrics
from .contacts import (
    bending,
    calibrated,
    jnd_lines,
    jnd_surface,
    located,
    place,
    posteriors,
    whisker_array,
)
from .designs import (
    analysed,
    placements,
    planned_jnds,
    planned_psychometrics,
    power_curve,
    rehearsed,
)
from .fits import comparison, engagement, residuals, shrinkage
from .style import COLOURS, DOUBLE, LINES, MARKERS, SINGLE, figure_of, new_figure, shown, styled

__all__ = [
    "COLOURS", "DOUBLE", "LINES", "MARKERS", "SINGLE", "analysed", "bending", "calibrated",
    "comparison", "engagement", "figure_of", "jnd_lines", "jnd_surface", "located", "new_figure",
    "place", "placements", "planned_jnds", "planned_psychometrics", "population", "posteriors",
    "power_curve", "psychometrics", "rehearsed", "residuals", "shown", "shrinkage", "styled",
    "whisker_array",
]  # fmt: skip
