"""How widely the biases of a population spread: a factor of their prior in a single fit.

Biases count in sds of the difference between the two signals, which grow with k: PSEs that lie
closer together than a prior expects speak for a small k, a little in one animal, and with every
animal more. So a population's biases are those of the prior all times one factor, which is learnt.
What a change of k does to all biases, the factor undoes: the pull is gone, whatever the prior's
shape and also where the animals share a bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.stats import norm

from .likelihood import Draws, WeberModel
from .priors import Priors

Array = NDArray[np.float64]

STEP = 0.35  # between nodes, in asinh(scale / unit): log-likelihoods of one bias err by 1e-3 there
NARROWEST = 0.8  # of the step of the bias nodes: a narrower density cannot be seen on them
MARGIN = 2.0  # by what factor a scale may be off that was guessed from the animals one by one
LIKELY = 20.0  # nats under the best guess, where scales are left out
FAR = 1e-12  # of the scale's prior, beyond which it is not looked for


@dataclass(frozen=True)
class BiasScales:
    """Scales at which members are tabulated, and what lies between them.

    `nodes` (S,) are even in asinh(scale / `unit`), where the unit is what a member's answers tell a
    bias to. Log-likelihoods are even about a scale of zero.
    """

    nodes: Array
    unit: float

    @classmethod
    def between(cls, low: float, high: float, unit: float, step: float = STEP) -> BiasScales:
        """Nodes over a range, from zero where that is close."""
        first, last = np.arcsinh(low / unit), np.arcsinh(high / unit)
        first = 0.0 if first < 2 * step else first
        count = max(int(np.ceil((last - first) / step)), 3) + 1
        return cls(unit * np.sinh(np.linspace(first, last, count)), unit)

    def onto(self, scales: ArrayLike) -> Array:
        """Share of every node in the value at other scales, (..., S): a cubic spline's.

        Examples
        --------
        >>> known = BiasScales.between(0.0, 2.0, unit=0.1)
        >>> seen = -0.5 * np.log(known.nodes**2 + 0.1**2)  # a bias of none, seen with an sd of 0.1
        >>> bool(abs(known.onto(0.3) @ seen + 0.5 * np.log(0.3**2 + 0.1**2)) < 1e-3)
        True
        """
        wanted = np.asarray(scales, dtype=float)
        if self.nodes.size == 1:
            return np.ones((*wanted.shape, 1))
        at = np.arcsinh(self.nodes / self.unit)
        first: Any = "clamped" if self.nodes[0] == 0 else "not-a-knot"
        spline = CubicSpline(at, np.eye(at.size), bc_type=(first, "not-a-knot"))
        return np.asarray(spline(np.arcsinh(wanted / self.unit)))


#: Of biases that are known, or none.
AS_BELIEVED = BiasScales(np.ones(1), 1.0)


def scaled_prior(priors: Priors, bias: Array, step: Array, scales: Array) -> Array:
    """Log prior mass of nodes of a bias for each scale, (..., B, S).

    Parameters
    ----------
    bias : ndarray, shape (..., B)
    step : ndarray, shape (..., B)
        Widths of the nodes.
    scales : ndarray, shape (S,)
    """
    sd = priors.moments("bias")[1]
    width = np.maximum(scales, NARROWEST * step[..., None] / sd)
    density = priors.log_density("bias", bias[..., None] / width) - np.log(width)
    return np.asarray(density + np.log(step)[..., None])


def likely_scales(models: Sequence[WeberModel], draws: Sequence[Draws], prior: Any) -> BiasScales:
    """Nodes over the scales that the members, each fitted alone, do not exclude.

    Their biases are taken for normal here, which decides where the nodes lie and nothing else.

    Parameters
    ----------
    models, draws
        Of every member.
    prior : frozen distribution
        Of the scale.
    """
    priors = models[0].priors
    if not any(model.free_bias for model in models):
        return AS_BELIEVED
    mean, sd = priors.moments("bias")
    own = np.concatenate([d.bias.mean(axis=0) for d in draws])
    variance = np.concatenate([d.bias.var(axis=0) for d in draws])
    # A posterior no narrower than the prior says nothing.
    precision = np.maximum(1 / variance - sd**-2, 1e-6 * sd**-2)
    seen, noise = (own / variance - mean / sd**2) / precision, np.sqrt(1 / precision)
    last = float(prior.isf(FAR))
    unit = float(np.sqrt(variance.min()) / sd)
    scales = BiasScales.between(0.0, last, unit, STEP / 4).nodes
    log_density = norm.logpdf(seen, scales[:, None] * mean, np.hypot(scales[:, None] * sd, noise))
    total = np.sum(log_density, axis=1)
    kept = scales[total > total.max() - LIKELY]
    return BiasScales.between(kept[0] / MARGIN, min(kept[-1] * MARGIN, last), unit)
