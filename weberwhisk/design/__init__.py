"""The design of experiments: which distances, offsets, trials and animals, and why.

The argument, a room each: a `Scheme` within `Constraints` is to tell hypotheses apart.
"""

from .analysis import Finding, analyse
from .goals import Animals, Goal
from .hypotheses import Hypothesis, cues, noises, taper
from .plan import Plan
from .plan_file import plan_json, read_plan
from .rehearsal import Rehearsal, rehearse
from .scheme import LEVELS, Constraints, Scheme
from .trial_lists import trial_lists

__all__ = [
    "LEVELS",
    "Animals",
    "Constraints",
    "Finding",
    "Goal",
    "Hypothesis",
    "Plan",
    "Rehearsal",
    "Scheme",
    "analyse",
    "cues",
    "noises",
    "plan_json",
    "read_plan",
    "rehearse",
    "taper",
    "trial_lists",
]
