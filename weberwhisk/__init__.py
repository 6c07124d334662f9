"""Bayesian inference and psychophysics of touch through rat whiskers."""

from .mechanics import Bending, FlickPast, Outcome, Rung, bend, flick_past, press, signal_jacobian
from .whisker import Whisker, identities

__version__ = "0.1.0"

__all__ = [
    "Bending",
    "FlickPast",
    "Outcome",
    "Rung",
    "Whisker",
    "bend",
    "flick_past",
    "identities",
    "press",
    "signal_jacobian",
]
