"""Whisker mechanics: four models of a beam, each of which leaves less out.

`bend`, `press`, `flick_past` and `signal_jacobian` call any model, `choose_model` says
which one a scene needs. The models themselves are the modules `closed_form`, `elastica`, `profile`
and `rod`; `modes` has the small vibrations.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..whisker import rest_shape
from .contact import Bending, FlickPast, Model, Outcome
from .ladder import bend, flick_past, press, signal_jacobian

if TYPE_CHECKING:
    from . import closed_form, elastica, modes, profile, rod
    from .model_choice import Choice, choose_model
    from .modes import Modes
    from .profile import rest_angle
    from .rod import RodBending
    from .shape import Parabola, Profile, Spiral

# What a plain straight whisker does not need, imported when it is first used.
_HOME = {
    "model_choice": ("Choice", "choose_model"),
    "shape": ("Parabola", "Profile", "Spiral"),
    "profile": ("rest_angle",),
    "rod": ("RodBending",),
    "modes": ("Modes",),
}
_MODULES = ("closed_form", "elastica", "modes", "profile", "rod")
__all__ = [
    "Bending", "Choice", "FlickPast", "Model", "Modes", "Outcome", "Parabola",
    "Profile", "RodBending", "Spiral", "bend", "choose_model", "closed_form", "elastica",
    "flick_past", "modes", "press", "profile", "rest_angle", "rest_shape", "rod",
    "signal_jacobian",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f".{name}", __name__)
    for home, names in _HOME.items():
        if name in names:
            globals()[name] = value = getattr(import_module(f".{home}", __name__), name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
