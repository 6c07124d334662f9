"""Trial tables, tasks, simulated observers, and Weber fractions fitted to choices.

A `Task` and an `Encoding` make the psychometric function; `Trials` are read or simulated;
`fit_weber` makes a `WeberFit` of them.
"""

from .comparison import Comparison, compare
from .criticism import quantile_residuals, residuals_by
from .cue_encoding import CueEncoding, PooledEncoding
from .encodings import Encoding, IdentityEncoding, LogAxisEncoding, LogEncoding
from .fit import StateFit, WeberFit, fit_weber
from .io import load_numerosity, load_rat_auditory, read_trials
from .located import simulate_moving, with_distances
from .population_fit import PopulationFit, PopulationStatus, fit_population
from .predictive import checks
from .priors import Priors
from .psychometric import response_probability, threshold
from .simulate import simulate_population, simulate_trials
from .states import States
from .tasks import TASKS, PercentCorrect, SignedChoice, Task, task_named
from .trials import Trials
from .verdict import FitStatus
from .weber_law import WeberLawTest, weber_law_test

__all__ = [
    "TASKS", "Comparison", "CueEncoding", "Encoding", "FitStatus", "IdentityEncoding",
    "LogAxisEncoding", "LogEncoding", "PercentCorrect", "PooledEncoding", "PopulationFit",
    "PopulationStatus", "Priors", "SignedChoice", "StateFit", "States", "Task", "Trials",
    "WeberFit", "WeberLawTest", "checks", "compare", "fit_population", "fit_weber",
    "load_numerosity", "load_rat_auditory", "quantile_residuals",
    "read_trials", "residuals_by", "response_probability", "simulate_moving", "simulate_population",
    "simulate_trials", "task_named", "threshold", "weber_law_test", "with_distances",
]  # fmt: skip
