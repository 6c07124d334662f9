"""Sensitivity to radial distance: just noticeable differences, their curves, and information."""

from .bits import Bits, added_information, alone, information, prior_draws
from .curves import JNDCurve, jnd_curve, linear_surface, touches_jnd
from .jnd import convert_jnd, criterion_factor, fisher_jnd, is_linear, weber_propagation

__all__ = [
    "Bits", "JNDCurve", "added_information", "alone", "convert_jnd", "criterion_factor",
    "fisher_jnd", "information", "is_linear", "jnd_curve",
    "linear_surface", "prior_draws", "touches_jnd", "weber_propagation",
]  # fmt: skip
