"""Receptor noise: what the follicle reports of the signals at the base.

=================== ========================================== ==================================
model               sd of a reading of a signal I              information about ln I
=================== ========================================== ==================================
`Weber`             k·I (equation (3.1))                       1/k² + 2 at every I
`GeneralisedWeber`  √(σ₀² + (k·I)²), up to a ceiling           falls below σ₀/k; 0 above a ceiling
`Saturating`        k·mean, where the mean levels off          falls smoothly about the ceiling
`LogNormal`         k·I, never across zero                     1/ln(1 + k²) at every I
`SpikeCount`        counts of single afferents                 1/k² within their thresholds' range
=================== ========================================== ==================================

Signals carry their kinds (moment, axial force, …) along the last axis, and so do readings, but for
`SpikeCount`, whose readings are counts, one for each afferent, and `Events`, whose signals are
probabilities. `Joint` gives each group of signals a model of its own. Constant noise, natural for
angles, is `GeneralisedWeber(0, floor=sd)`. How to write another law: `ReceptorNoise`.
"""

from .._util.values import Array
from .gaussian import Gaussian, GeneralisedWeber, Saturating, Weber
from .other_laws import Events, LogNormal
from .protocol import Component, Joint, ReceptorNoise, Seed
from .spike_count import Afferents, SpikeCount

__all__ = [
    "Afferents", "Array", "Component", "Events", "Gaussian", "GeneralisedWeber", "Joint",
    "LogNormal", "ReceptorNoise", "Saturating", "Seed", "SpikeCount", "Weber",
]  # fmt: skip
