"""Trial tables, tasks, simulated observers, and Weber fractions fitted to choices.

The argument, a room each: a `Task` and a `Percept` make the psychometric function; `Trials` are
read or simulated; `fit_weber` makes a `WeberFit` of them.
"""

from .datasets import load_numerosity, load_rat_auditory
from .fit import fit_weber
from .law import WeberLawTest, weber_law_test
from .percepts import CuePercept, IdentityPercept, LogAxisPercept, LogPercept, Percept
from .priors import Priors
from .psychometric import response_probability, threshold
from .reading import read_trials
from .result import WeberFit
from .simulate import simulate_trials
from .status import FitStatus
from .tasks import TASKS, PercentCorrect, SignedChoice, Task, task_named
from .trials import Trials

__all__ = [
    "TASKS",
    "CuePercept",
    "FitStatus",
    "IdentityPercept",
    "LogAxisPercept",
    "LogPercept",
    "PercentCorrect",
    "Percept",
    "Priors",
    "SignedChoice",
    "Task",
    "Trials",
    "WeberFit",
    "WeberLawTest",
    "fit_weber",
    "load_numerosity",
    "load_rat_auditory",
    "read_trials",
    "response_probability",
    "simulate_trials",
    "task_named",
    "threshold",
    "weber_law_test",
]
