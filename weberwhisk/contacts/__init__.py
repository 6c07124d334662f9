"""Measured contacts: from trackers' files and tables of forces to distances."""

from .calibration import Calibration, HingedTap, calibrate
from .rows import MeasuredAngle, locate
from .simulated import simulate_tracking
from .trackers import read_tracking

__all__ = [
    "Calibration",
    "HingedTap",
    "MeasuredAngle",
    "calibrate",
    "locate",
    "read_tracking",
    "simulate_tracking",
]
