"""From readings to contacts: the observer, and the posterior of what it does not know."""

from .floors import default_noise
from .methods import Estimate, Posterior, Status, posterior
from .observer import Observer
from .touches import Touches, touches

__all__ = [
    "Estimate", "Observer", "Posterior", "Status", "Touches", "default_noise", "posterior",
    "touches",
]  # fmt: skip
