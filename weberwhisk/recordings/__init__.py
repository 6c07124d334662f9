"""Measured contacts: from trackers' files and tables of forces to distances.

`locate` makes one posterior of each row of a table, and one of each touch.
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
