"""Sweeps: the same work on many chunks, serially, on all cores, or on a cluster.

Recovery, power, calibration and surfaces of JNDs are all of one kind: a function of a chunk (what
to do) and a seed (its own) that returns a table. `run` does it for every chunk, and the answer is
the same to the bit whatever does it and in what order.
"""

from .record import read
from .runner import CampaignError, all_cores, run

__all__ = ["CampaignError", "all_cores", "read", "run"]
