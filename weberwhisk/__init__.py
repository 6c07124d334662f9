"""Bayesian inference and psychophysics of touch through rat whiskers.

One argument, told by the modules in order: whisker → bending → cue → receptor noise → observer →
posterior → JND → behaviour → fit.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from . import array as array
    from . import behaviour as behaviour
    from . import cues as cues
    from . import design as design
    from . import inference as inference
    from . import mechanics as mechanics
    from . import plots as plots
    from . import receptors as receptors
    from . import recordings as recordings
    from . import sensitivity as sensitivity
    from . import sweeping as sweeping
    from ._util import campaign as campaign
    from ._util.output import cite as cite
    from .array import ArrayObserver as ArrayObserver
    from .array import WhiskerArray as WhiskerArray
    from .array.place import place as place
    from .behaviour import Trials as Trials
    from .behaviour import compare as compare
    from .behaviour import fit_population as fit_population
    from .behaviour import fit_weber as fit_weber
    from .behaviour import read_trials as read_trials
    from .behaviour import simulate_population as simulate_population
    from .behaviour import simulate_trials as simulate_trials
    from .design import plan_experiment as plan_experiment
    from .design import power as power
    from .design import read_plan as read_plan
    from .design import simulate_study as simulate_study
    from .inference import Status as Status
    from .inference import posterior as posterior
    from .inference.observer import Observer as Observer
    from .inference.touches import touches as touches
    from .mechanics import Outcome as Outcome
    from .mechanics import bend as bend
    from .mechanics import choose_model as choose_model
    from .mechanics import flick_past as flick_past
    from .mechanics import press as press
    from .plots.designs import write_plan as write_plan
    from .recordings import calibrate as calibrate
    from .recordings import read_tracking as read_tracking
    from .recordings import tracked_signals as tracked_signals
    from .recordings.locate import locate as locate
    from .sensitivity import information as information
    from .sensitivity import jnd_curve as jnd_curve
    from .whisker import Whisker as Whisker

# Each public name's home, imported when the name is first used: `import weberwhisk` stays light.
_NAMES = {
    "whisker": "Whisker",
    "array": "ArrayObserver WhiskerArray place",
    "mechanics": "Outcome bend choose_model flick_past press",
    "inference": "Observer Status posterior touches",
    "sensitivity": "information jnd_curve",
    "behaviour": "Trials compare fit_population fit_weber read_trials simulate_population "
    "simulate_trials",
    "recordings": "calibrate locate read_tracking tracked_signals",
    "design": "plan_experiment power read_plan simulate_study",
    "plots.designs": "write_plan",
    "_util.output": "cite",
}
_MODULES = {
    name: name
    for name in ("array", "behaviour", "cues", "design", "inference", "mechanics",
                 "plots", "receptors", "recordings", "sensitivity", "sweeping")
} | {"campaign": "_util.campaign"}  # fmt: skip
_HOME = {name: home for home, names in _NAMES.items() for name in names.split()}
if not TYPE_CHECKING:  # which goes by the imports above
    __all__ = sorted([*_HOME, *_MODULES])


def _version() -> str:
    """As installed: its tag's, or of a commit between two; "unknown" if it was not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f".{_MODULES[name]}", __name__)
    if name == "__version__":
        return _version()
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*_HOME, *_MODULES, "__version__"]
