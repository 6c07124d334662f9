"""The design of experiments: which distances, offsets, trials and animals, and why.

The argument, a room each: a `Scheme` within `Constraints` is to tell hypotheses apart.
"""

from .hypotheses import Hypothesis, cues, noises, taper
from .scheme import LEVELS, Constraints, Scheme

__all__ = ["LEVELS", "Constraints", "Hypothesis", "Scheme", "cues", "noises", "taper"]
