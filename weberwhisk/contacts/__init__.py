"""Measured contacts: from trackers' files and tables of forces to distances."""

from ..cues.force_map import MeasuredAngle
from .calibration import Calibration, HingedTap, calibrate
from .rows import locate
from .signals import tracked_signals
from .trackers import read_tracking, simulate_tracking

__all__ = [
    "Calibration", "HingedTap", "MeasuredAngle", "calibrate", "locate", "read_tracking",
    "simulate_tracking", "tracked_signals",
]  # fmt: skip
