"""Charts of results: each takes a result and, if wanted, axes to draw on, and returns the axes.

Nothing is computed here but the scaling of axes and the error bars of counts. Colours are those of
Okabe and Ito, which the colour-blind can tell apart, and every colour comes with its own marker or
line style, so that a figure also reads in grey.
"""

from .charts import fits_and_growth, speed_accuracy
from .choices import psychometric, psychometrics
from .criticism import pairs, residuals, shrinkage
from .design import information, power_curve
from .jnds import jnd_curve, jnd_surface
from .page import plan_page
from .placements import adaptive, placements
from .plans import planned_jnds, planned_power, planned_psychometrics, rehearsed
from .posteriors import posterior
from .signals import bending
from .style import COLOURS, DOUBLE, LINES, MARKERS, SINGLE, figure_of, new_figure, styled
from .surveys import best_cue, cue_information, cue_jnds, cue_outcomes, ridge, weber_2d

__all__ = [
    "COLOURS",
    "DOUBLE",
    "LINES",
    "MARKERS",
    "SINGLE",
    "adaptive",
    "bending",
    "best_cue",
    "cue_information",
    "cue_jnds",
    "cue_outcomes",
    "figure_of",
    "fits_and_growth",
    "information",
    "jnd_curve",
    "jnd_surface",
    "new_figure",
    "pairs",
    "placements",
    "plan_page",
    "planned_jnds",
    "planned_power",
    "planned_psychometrics",
    "posterior",
    "power_curve",
    "psychometric",
    "psychometrics",
    "rehearsed",
    "residuals",
    "ridge",
    "shrinkage",
    "speed_accuracy",
    "styled",
    "weber_2d",
]
