"""Measured contacts: from trackers' files and tables of forces to distances."""

from .rows import MeasuredAngle, locate
from .trackers import read_tracking

__all__ = ["MeasuredAngle", "locate", "read_tracking"]
