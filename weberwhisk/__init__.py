"""Bayesian inference and psychophysics of touch through rat whiskers.

One argument, told by the modules in order: whisker → bending → cue → receptor noise → observer →
posterior → JND → behaviour → fit.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._deprecated import renamed_names

__version__ = "0.1.0"

if TYPE_CHECKING:
    from . import campaign, cues, design, mechanics, receptors
    from .behaviour import (
        Comparison,
        PopulationFit,
        Trials,
        WeberFit,
        compare,
        fit_population,
        fit_weber,
        read_trials,
        simulate_population,
        simulate_trials,
    )
    from .design import plan_experiment, power, read_plan, simulate_study
    from .fusion import added_information, fused_jnds, information
    from .jnd import convert_jnd, criterion_factor, jnd_curve
    from .jnd_surface import jnd_sweep
    from .mechanics import (
        Bending,
        Choice,
        FlickPast,
        Model,
        Outcome,
        Parabola,
        Profile,
        Spiral,
        bend,
        choose_model,
        flick_past,
        press,
        rest_angle,
        signal_jacobian,
        sticking,
        sweep,
    )
    from .observer import Observer
    from .planning import write_plan
    from .posterior import Posterior, Status, posterior
    from .whisker import Whisker, identities

# Each public name and its home, imported when it is first used: `import weberwhisk` stays light.
_HOME = {
    "Whisker": "whisker",
    "identities": "whisker",
    "mechanics": "mechanics",
    "Bending": "mechanics",
    "Choice": "mechanics",
    "FlickPast": "mechanics",
    "Outcome": "mechanics",
    "Parabola": "mechanics",
    "Profile": "mechanics",
    "Model": "mechanics",
    "Spiral": "mechanics",
    "bend": "mechanics",
    "choose_model": "mechanics",
    "flick_past": "mechanics",
    "press": "mechanics",
    "rest_angle": "mechanics",
    "signal_jacobian": "mechanics",
    "sticking": "mechanics",
    "sweep": "mechanics",
    "cues": "cues",
    "receptors": "receptors",
    "Observer": "observer",
    "Posterior": "posterior",
    "Status": "posterior",
    "posterior": "posterior",
    "added_information": "fusion",
    "fused_jnds": "fusion",
    "information": "fusion",
    "convert_jnd": "jnd",
    "criterion_factor": "jnd",
    "jnd_curve": "jnd",
    "jnd_sweep": "jnd_surface",
    "campaign": "campaign",
    "Comparison": "behaviour",
    "PopulationFit": "behaviour",
    "Trials": "behaviour",
    "WeberFit": "behaviour",
    "compare": "behaviour",
    "fit_population": "behaviour",
    "fit_weber": "behaviour",
    "read_trials": "behaviour",
    "simulate_population": "behaviour",
    "simulate_trials": "behaviour",
    "design": "design",
    "plan_experiment": "design",
    "power": "design",
    "read_plan": "design",
    "simulate_study": "design",
    "write_plan": "planning",
}
__all__ = [
    "Bending",
    "Choice",
    "Comparison",
    "FlickPast",
    "Model",
    "Observer",
    "Outcome",
    "Parabola",
    "PopulationFit",
    "Posterior",
    "Profile",
    "Spiral",
    "Status",
    "Trials",
    "WeberFit",
    "Whisker",
    "added_information",
    "bend",
    "campaign",
    "choose_model",
    "compare",
    "convert_jnd",
    "criterion_factor",
    "cues",
    "design",
    "fit_population",
    "fit_weber",
    "flick_past",
    "fused_jnds",
    "identities",
    "information",
    "jnd_curve",
    "jnd_sweep",
    "mechanics",
    "plan_experiment",
    "posterior",
    "power",
    "press",
    "read_plan",
    "read_trials",
    "receptors",
    "rest_angle",
    "signal_jacobian",
    "simulate_population",
    "simulate_study",
    "simulate_trials",
    "sticking",
    "sweep",
    "write_plan",
]


_renamed = renamed_names(
    __name__,
    {"Rung": "Model", "choose_rung": "choose_model", "rehearse": "simulate_study"},
)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        return _renamed(name)
    module = import_module(f".{_HOME[name]}", __name__)
    # A name that is its own home is the module; `posterior` can be called as well.
    value = module if _HOME[name] == name else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
