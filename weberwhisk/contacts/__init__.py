"""Measured contacts: from trackers' files and tables of forces to distances."""

from .rows import MeasuredAngle, locate

__all__ = ["MeasuredAngle", "locate"]
