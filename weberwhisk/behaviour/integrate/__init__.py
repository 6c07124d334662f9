"""The one integrator of choices: zoom in from the prior, then sum on even nodes.

`grid` serves one data set (`fit_weber`, `weber_law_test`), `batch` thousands of one design
(`power`, populations); `windows` says where they lie, and `blocks` evaluates them.
"""

from .batch import Likelihood, likelihood, marginal
from .grid import PosteriorGrid, integrate, refined

__all__ = ["Likelihood", "PosteriorGrid", "integrate", "likelihood", "marginal", "refined"]
