"""How well radial distance is known: just noticeable differences, their curves, and bits."""

from .curves import JNDCurve, jnd_curve, jnd_sweep, linear_surface, touches_jnd
from .jnd import (
    added_information,
    convert_jnd,
    criterion_factor,
    fisher_jnd,
    fused_jnds,
    information,
    is_linear,
    prior_draws,
    weber_propagation,
)

__all__ = [
    "JNDCurve", "added_information", "convert_jnd", "criterion_factor", "fisher_jnd",
    "fused_jnds", "information", "is_linear", "jnd_curve", "jnd_sweep", "linear_surface",
    "prior_draws", "touches_jnd", "weber_propagation",
]  # fmt: skip
