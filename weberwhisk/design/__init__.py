"""The design of experiments: which stimuli, offsets, trials and animals, and why.

A `Scheme` within `Constraints` is to distinguish hypotheses, with a power that is simulated. While
it runs, a placer chooses each trial from the answers to those before.
"""

from .goals import Contrast, Evidence, Goal, Precision
from .hypotheses import Hypothesis, SubjectPopulation, cues, noises, taper, with_priors
from .magnitude import MAGNITUDES, Magnitude, magnitude_named
from .placement import BayesianPlacer, Proposal, TrialLog, next_trial
from .plan import AnalysisResult, Plan, analyse
from .plan_file import plan_json, read_plan
from .power_analysis import Power, power, smallest
from .questions import plan_experiment
from .rehearsal import simulate_study
from .rivals import rivals
from .scheme import LEVELS, Constraints, Scheme, lattice
from .scheme_search import best_scheme
from .session import Session, trial_lists

__all__ = [
    "LEVELS", "MAGNITUDES", "AnalysisResult", "BayesianPlacer", "Constraints", "Contrast",
    "Evidence", "Goal",
    "Hypothesis", "Magnitude", "Plan", "Power", "Precision", "Proposal", "Scheme", "Session",
    "SubjectPopulation", "TrialLog", "analyse", "best_scheme", "cues", "lattice",
    "magnitude_named", "next_trial", "noises", "plan_experiment", "plan_json", "power",
    "read_plan", "rivals", "simulate_study", "smallest", "taper", "trial_lists", "with_priors",
]  # fmt: skip
