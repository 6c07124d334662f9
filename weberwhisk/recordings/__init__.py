"""Measured contacts: radial distances from trackers' files and from tables of forces.

`locate` infers one posterior for each row of a table, and one for each touch.
"""

from ..cues.protocol import MeasuredAngle
from .calibration import Calibration, HingedTap, calibrate
from .locate import locate, methods_paragraph
from .signals import tracked_signals
from .trackers import read_tracking

__all__ = [
    "Calibration", "HingedTap", "MeasuredAngle", "calibrate", "locate", "methods_paragraph",
    "read_tracking", "tracked_signals",
]  # fmt: skip
