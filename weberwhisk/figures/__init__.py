"""Charts of results: each takes a result and, if wanted, axes to draw on, and returns the axes.

Nothing is computed here but the scaling of axes and the error bars of counts. Colours are those of
Okabe and Ito, which the colour-blind can tell apart, and every colour comes with its own marker or
line style, so that a figure also reads in grey.
"""

from .._values import renamed_names
from .contacts import (
    bending,
    calibrated,
    jnd_lines,
    jnd_surface,
    located,
    posterior_histogram,
    posteriors,
)
from .designs import (
    information_map,
    placements,
    plan_page,
    planned_jnds,
    planned_power,
    planned_psychometrics,
    power_curve,
    rehearsed,
)
from .fits import (
    adaptive,
    comparison,
    pairs,
    population,
    psychometric,
    psychometrics,
    residuals,
    shrinkage,
)
from .reports import fits_and_growth, paper_1d, paper_2, paper_3, speed_accuracy
from .style import COLOURS, DOUBLE, LINES, MARKERS, SINGLE, figure_of, new_figure, shown, styled
from .surveys import (
    best_cue,
    cue_information,
    cue_jnds,
    cue_outcomes,
    curvature,
    decisions,
    ridge,
    weber_2d,
)
from .whisks import (
    along_push,
    array_counts,
    array_map,
    jnd_limits,
    lateral_sweep,
    place,
    reversal,
    touches,
    whisker_array,
    whisking_speed,
)

__all__ = [
    "COLOURS",
    "DOUBLE",
    "LINES",
    "MARKERS",
    "SINGLE",
    "adaptive",
    "along_push",
    "array_counts",
    "array_map",
    "bending",
    "best_cue",
    "calibrated",
    "comparison",
    "cue_information",
    "cue_jnds",
    "cue_outcomes",
    "curvature",
    "decisions",
    "figure_of",
    "fits_and_growth",
    "information_map",
    "jnd_limits",
    "jnd_lines",
    "jnd_surface",
    "lateral_sweep",
    "located",
    "new_figure",
    "pairs",
    "paper_1d",
    "paper_2",
    "paper_3",
    "place",
    "placements",
    "plan_page",
    "planned_jnds",
    "planned_power",
    "planned_psychometrics",
    "population",
    "posterior_histogram",
    "posteriors",
    "power_curve",
    "psychometric",
    "psychometrics",
    "rehearsed",
    "residuals",
    "reversal",
    "ridge",
    "shown",
    "shrinkage",
    "speed_accuracy",
    "styled",
    "touches",
    "weber_2d",
    "whisker_array",
    "whisking_speed",
]
__getattr__ = renamed_names(
    __name__,
    {
        "jnd_curve": "jnd_lines",
        "posterior": "posterior_histogram",
        "information": "information_map",
    },
)
