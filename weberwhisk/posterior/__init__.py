"""Posteriors of a contact: quadrature, emcee and Laplace, from one `Observer`."""

from .result import Estimate, Posterior, Status
from .solve import posterior

__all__ = ["Estimate", "Posterior", "Status", "posterior"]
