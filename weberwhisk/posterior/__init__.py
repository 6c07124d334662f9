"""Posteriors of a contact: quadrature, emcee and Laplace, from one `Observer`."""

import sys
from types import ModuleType
from typing import Any

from .result import Estimate, Posterior, Status
from .solve import posterior


class _CallableModule(ModuleType):
    """`weberwhisk.posterior` is this package and the function it is named after, both."""

    def __call__(self, *args: Any, **kwargs: Any) -> Posterior:
        return posterior(*args, **kwargs)


sys.modules[__name__].__class__ = _CallableModule

__all__ = ["Estimate", "Posterior", "Status", "posterior"]
