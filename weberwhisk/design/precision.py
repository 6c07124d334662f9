"""How well a scheme will tell the Weber fraction of animals like the expected ones.

The expected information of every answer about k, both lapses and the bias of its standard, all of
them unknown, with the priors' precision added; its inverse is the variance of ln k that a fit will
have, where posteriors are normal (Chaloner & Verdinelli 1995, Statist. Sci. 10:273, §4). Each
position is worth the same wherever it is used, so it is tabulated once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..behaviour.trials import Cells
from .goals import SubjectPopulation
from .hypotheses import Hypothesis

Array = NDArray[np.float64]

ANIMALS = 64  # drawn to stand for all
SEED = 20
STEP = 1e-3  # of central differences
LEAST_LAPSE = 3e-3  # an animal that never lapses does not tell so


class Precision:
    """Expected intervals of k from any choice of positions.

    Parameters
    ----------
    hypothesis : Hypothesis
        True, and fitted.
    standards, comparisons : array_like, shape (C,)
        All positions there are to choose from, m.
    animals : SubjectPopulation
        So many are drawn from them, the same for every choice.

    Examples
    --------
    >>> from weberwhisk.behaviour import IdentityEncoding
    >>> weber = Hypothesis("Weber", IdentityEncoding())
    >>> told = Precision(weber, [1.0, 1.0, 1.0], [0.8, 1.0, 1.2], SubjectPopulation())
    >>> middle, sides = (np.median(told.half_widths(at, 50)) for at in ([1], [0, 2]))
    >>> bool(sides < middle)
    True
    """

    def __init__(
        self,
        hypothesis: Hypothesis,
        standards: ArrayLike,
        comparisons: ArrayLike,
        animals: SubjectPopulation,
    ) -> None:
        s1, s2 = (np.asarray(a, dtype=float) for a in (standards, comparisons))
        model = hypothesis.model(Cells(s1, s2, s1, np.ones(s1.size), np.zeros(s1.size)))
        drawn = animals.draw(ANIMALS, SEED)
        middle = model.fixed_bias()
        if model.free_bias and model.task.bias_name == "criterion":
            middle = float(hypothesis.priors.value("bias", 0.0))
        lapses = (
            np.maximum(drawn[name].to_numpy(), LEAST_LAPSE) for name in ("lapse_low", "lapse_high")
        )
        # ln k, either lapse and the bias of every animal, (4, A)
        at = np.stack([np.log(drawn["weber_fraction"]), *lapses, middle + drawn["bias"]])

        def chance(there: Array) -> Array:
            k, low, high, bias = there
            biases = np.repeat(bias[:, None], model.n_groups, axis=1)
            return model.probability(np.exp(k), low, high, biases)[0]

        p = chance(at)
        slopes = [
            (chance(at + d) - chance(at - d)) / (2 * STEP) for d in STEP * np.eye(4)[..., None]
        ]
        self._free = [*model.free[:1], *model.free[-2:], model.free_bias]
        slope = np.stack(slopes, axis=-1) * self._free  # (A, C, 4)
        self._information = slope[..., :, None] * (slope / (p * (1 - p))[..., None])[..., None, :]
        self._group = model.group
        low, high = np.log(model.value("weber_fraction", np.array([-0.5, 0.5])))
        sds = [
            high - low if name == "weber_fraction" else model.priors.moments(name)[1]
            for name in ("weber_fraction", "lapse_low", "lapse_high", "bias")
        ]
        # What is known has no slope, and any precision will do.
        pairs = zip(sds, self._free, strict=True)
        self._prior = np.diag([sd**-2.0 if free else 1.0 for sd, free in pairs])

    def half_widths(self, chosen: ArrayLike, each: float) -> Array:
        """1.96 sds of ln k of every animal, (A,), from so many trials of each chosen position."""
        at = np.asarray(chosen)
        total = np.broadcast_to(self._prior[:3, :3], (ANIMALS, 3, 3)).copy()
        for group in np.unique(self._group[at]):
            own = each * self._information[:, at[self._group[at] == group]].sum(axis=1)
            # The bias integrated out: the Schur complement of its information.
            mixed, bias = own[:, :3, 3], own[:, 3, 3] + self._prior[3, 3]
            total += own[:, :3, :3] - mixed[:, :, None] * mixed[:, None, :] / bias[:, None, None]
        if not self._free[0]:
            return np.zeros(ANIMALS)
        return np.asarray(1.96 * np.sqrt(np.linalg.inv(total)[:, 0, 0]))
