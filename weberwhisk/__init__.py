"""Bayesian inference and psychophysics of touch through rat whiskers.

One argument, told by the modules in order: whisker → bending → cue → receptor noise → observer →
posterior → JND → behaviour → fit.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ._deprecated import renamed_names

__version__ = "0.1.0"

if TYPE_CHECKING:
    from . import (
        along_whisk,
        array,
        behaviour,
        campaign,
        contacts,
        cues,
        design,
        figures,
        many_touches,
        mechanics,
        places,
        receptors,
        sweeping,
    )
    from .array import WhiskerArray
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
    from .citing import cite
    from .contacts import calibrate, locate, read_tracking, simulate_tracking, tracked_signals
    from .design import plan_experiment, power, read_plan, simulate_study
    from .figures.page import write_plan
    from .fusion import added_information, fused_jnds, information
    from .jnd import convert_jnd, criterion_factor
    from .jnd_curves import JNDCurve, jnd_curve, jnd_sweep
    from .many_touches import Touches, touches, touches_jnd
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
    from .place_maps import array_by_count, array_by_whisker, array_resolution
    from .places import ArrayObserver, Place, place
    from .posterior import Posterior, Status, posterior
    from .whisker import Whisker, identities

# Each public name's home, imported when the name is first used: `import weberwhisk` stays light.
_NAMES = {
    "whisker": "Whisker identities",
    "array": "WhiskerArray",
    "place_maps": "array_by_count array_by_whisker array_resolution",
    "mechanics": "Bending Choice FlickPast Outcome Parabola Profile Model Spiral "
    "bend choose_model flick_past press rest_angle signal_jacobian sticking sweep",
    "observer": "Observer",
    "posterior": "Posterior Status posterior",
    "fusion": "added_information fused_jnds information",
    "jnd": "convert_jnd criterion_factor",
    "many_touches": "Touches touches touches_jnd",
    "jnd_curves": "JNDCurve jnd_curve jnd_sweep",
    "behaviour": "Comparison PopulationFit Trials WeberFit compare "
    "fit_population fit_weber read_trials simulate_population simulate_trials",
    "contacts": "calibrate locate read_tracking simulate_tracking tracked_signals",
    "design": "plan_experiment power read_plan simulate_study",
    "places": "ArrayObserver Place place",
    "figures.page": "write_plan",
    "citing": "cite",
}
_MODULES = {
    "along_whisk", "array", "behaviour", "campaign", "contacts", "cues", "design", "figures",
    "many_touches", "mechanics", "places", "receptors", "sweeping",
}  # fmt: skip
_HOME = {name: home for home, names in _NAMES.items() for name in names.split()}
__all__ = [
    "ArrayObserver",
    "Bending",
    "Choice",
    "Comparison",
    "FlickPast",
    "JNDCurve",
    "Model",
    "Observer",
    "Outcome",
    "Parabola",
    "Place",
    "PopulationFit",
    "Posterior",
    "Profile",
    "Spiral",
    "Status",
    "Touches",
    "Trials",
    "WeberFit",
    "Whisker",
    "WhiskerArray",
    "added_information",
    "along_whisk",
    "array",
    "array_by_count",
    "array_by_whisker",
    "array_resolution",
    "behaviour",
    "bend",
    "calibrate",
    "campaign",
    "choose_model",
    "cite",
    "compare",
    "contacts",
    "convert_jnd",
    "criterion_factor",
    "cues",
    "design",
    "figures",
    "fit_population",
    "fit_weber",
    "flick_past",
    "fused_jnds",
    "identities",
    "information",
    "jnd_curve",
    "jnd_sweep",
    "locate",
    "many_touches",
    "mechanics",
    "place",
    "places",
    "plan_experiment",
    "posterior",
    "power",
    "press",
    "read_plan",
    "read_tracking",
    "read_trials",
    "receptors",
    "rest_angle",
    "signal_jacobian",
    "simulate_population",
    "simulate_study",
    "simulate_tracking",
    "simulate_trials",
    "sticking",
    "sweep",
    "sweeping",
    "touches",
    "touches_jnd",
    "tracked_signals",
    "write_plan",
]


_renamed = renamed_names(
    __name__,
    {"Rung": "Model", "choose_rung": "choose_model", "rehearse": "simulate_study"},
)


class _Package(ModuleType):
    """This package, whose `posterior` is the function, and not the subpackage of that name."""

    @property
    def posterior(self) -> Any:
        return import_module(".posterior", __name__).posterior

    @posterior.setter
    def posterior(self, subpackage: ModuleType) -> None:
        """What importing a subpackage does to its parent, and is not wanted here."""


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f".{name}", __name__)
    if name not in _HOME:
        return _renamed(name)
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
