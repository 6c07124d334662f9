"""The design of experiments: which distances, offsets, trials and animals, and why.

The argument, a room each: a `Scheme` within `Constraints` is to tell hypotheses apart. While it
runs, a placer chooses each trial from what the ones before have told.
"""

from .hypotheses import Hypothesis, cues, noises, taper
from .placement import BayesianPlacer, Placer, Proposal, TrialLog, lattice, next_trial
from .scheme import LEVELS, Constraints, Scheme
from .session import Session
from .staircases import Staircase

__all__ = [
    "LEVELS",
    "BayesianPlacer",
    "Constraints",
    "Hypothesis",
    "Placer",
    "Proposal",
    "Scheme",
    "Session",
    "Staircase",
    "TrialLog",
    "cues",
    "lattice",
    "next_trial",
    "noises",
    "taper",
]
