"""Whisker mechanics: a ladder of beam models, from the closed form up."""

from .contact import Bending, Outcome, Rung
from .elastica import FlickPast
from .ladder import bend, flick_past, press, signal_jacobian

__all__ = [
    "Bending",
    "FlickPast",
    "Outcome",
    "Rung",
    "bend",
    "flick_past",
    "press",
    "signal_jacobian",
]
