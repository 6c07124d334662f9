"""A hierarchical model of choices walked by Metropolis steps: an independent reference.

The likelihood is written anew, for 2AFC with Weber's noise, lapses, a bias and contraction. Animals
and the population are moved in turn, and means and spreads also together with all animals, without
which narrow populations would hold the walk fast.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import betaincinv, expit, logit, ndtr, ndtri

Array = NDArray[np.float64]

MEANS = ("weber_fraction", "contraction", "lapse_low", "lapse_high", "bias")
SPREADS = ("spread", "contraction_spread", "lapse_spread", "bias_spread")
OF = np.array([0, 1, 2, 2, 3])  # which spread each mean has
RHO = 0.7


class Walk:
    """Chains of a population, `chains` at once; `scales` are of the half-normal priors of spreads.

    Means are moved as normal scores of their priors, and so are spreads.
    """

    def __init__(
        self, frame: pd.DataFrame, scales: Mapping[str, float], chains: int, seed: int
    ) -> None:
        self.rng, self.scales = np.random.default_rng(seed), np.array([scales[n] for n in SPREADS])
        frame = frame[frame["count"].notna()]
        tables = [
            g.groupby(["stimulus_1", "stimulus_2"])[["n", "count"]].sum().reset_index()
            for _, g in frame.groupby("subject")
        ]
        cells = max(map(len, tables))
        pads = {"stimulus_1": 1.0, "stimulus_2": 2.0, "n": 0.0, "count": 0.0}
        self.s1, self.s2, self.n, self.x = (
            np.array([np.r_[t[c].to_numpy(float), np.full(cells - len(t), pad)] for t in tables])
            for c, pad in pads.items()
        )
        both = (self.n * (self.s1 + self.s2)).sum(axis=1) / 2 / self.n.sum(axis=1)
        self.centre = both[:, None]
        precision = np.eye(9)
        precision[2, 3] = precision[3, 2] = RHO
        self.precision = np.linalg.inv(precision)
        self.of_animals = self.precision[:5, :5]
        self.z = self.rng.normal(0, 0.3, (chains, 9))
        shape = (chains, len(tables), 5)
        self.at = self.means(self.z)[:, None] + self.rng.normal(0, 0.2, shape)
        self.like = self.log_likelihood(self.at)

    def means(self, z: Array) -> Array:
        lapses = logit(np.clip(betaincinv(0.7, 20.0, ndtr(z[..., 2:4])), 1e-290, 1 - 1e-12))
        rest = np.log(0.1) + np.log(3.0) * z[..., :1], 0.3 * z[..., 1:2]
        return np.concatenate([*rest, lapses, z[..., 4:5]], axis=-1)

    def sds(self, z: Array) -> Array:
        return np.asarray(self.scales * -ndtri(0.5 * ndtr(-z[..., 5:])))

    def log_likelihood(self, at: Array) -> Array:
        k, drawn, low, high, bias = (at[..., i, None] for i in range(5))
        first = self.s1 + drawn * (self.centre - self.s1)
        low, high = expit(low), expit(high)
        up = ndtr((self.s2 - first) / (np.exp(k) * np.hypot(self.s1, self.s2)) + bias)
        p = np.clip(low + (1 - low - high) * up, 1e-300, 1)
        q = np.clip(high + (1 - low - high) * (1 - up), 1e-300, 1)
        log = (self.x * np.log(p) + (self.n - self.x) * np.log(q)).sum(axis=-1)
        return np.where((low + high)[..., 0] < 1, log, -np.inf)

    def log_prior(self, z: Array) -> Array:
        return np.asarray(-0.5 * np.einsum("ci,ij,cj->c", z, self.precision, z))

    def log_animals(self, at: Array, z: Array) -> Array:
        sd = self.sds(z)[:, OF]
        off = (at - self.means(z)[:, None]) / sd[:, None]
        square = np.einsum("cai,ij,caj->ca", off, self.of_animals, off)
        return np.asarray(-0.5 * square - np.log(sd).sum(axis=1)[:, None])

    def accepted(self, log_ratio: Array) -> NDArray[np.bool_]:
        return np.asarray(np.log(self.rng.random(log_ratio.shape)) < log_ratio)

    def run(self, steps: int, burn: int) -> dict[str, Array]:
        """Draws of the population by name, (chains, N): ln k, logits of lapses, sds."""
        chains, animals, _ = self.at.shape
        own = np.full((animals, 5), 0.3)
        step, along = np.full(9, 0.3), np.full(9, 0.2)
        kept = []
        for number in range(steps):
            i, adapt = number % 5, number < burn
            new = self.at.copy()
            new[..., i] += own[:, i] * self.rng.normal(size=(chains, animals))
            like = self.log_likelihood(new)
            change = like + self.log_animals(new, self.z)
            yes = self.accepted(change - self.like - self.log_animals(self.at, self.z))
            self.at = np.where(yes[..., None], new, self.at)
            self.like = np.where(yes, like, self.like)
            own[:, i] *= np.exp(adapt * 0.05 * (yes.mean(axis=0) - 0.44))
            for j in range(9):
                z = self.z.copy()
                z[:, j] += step[j] * self.rng.normal(size=chains)
                change = self.log_prior(z) + self.log_animals(self.at, z).sum(axis=1)
                before = self.log_prior(self.z) + self.log_animals(self.at, self.z).sum(axis=1)
                yes = self.accepted(change - before)
                self.z = np.where(yes[:, None], z, self.z)
                step[j] *= np.exp(adapt * 0.05 * (yes.mean() - 0.44))
            self._along(number % 9, along, adapt)
            if number >= burn and number % 5 == 0:
                kept.append(np.concatenate([self.means(self.z), self.sds(self.z)], axis=1))
        draws = np.array(kept)
        return {n: draws[..., i].T for i, n in enumerate((*MEANS, *SPREADS))}

    def _along(self, j: int, along: Array, adapt: bool) -> None:
        """Move a mean or a spread, and all animals with it."""
        z = self.z.copy()
        z[:, j] += along[j] * self.rng.normal(size=len(z))
        scale = (self.sds(z) / self.sds(self.z))[:, None, OF]
        at = self.means(z)[:, None] + (self.at - self.means(self.z)[:, None]) * scale
        like = self.log_likelihood(at)
        change = self.log_prior(z) - self.log_prior(self.z) + (like - self.like).sum(axis=1)
        yes = self.accepted(change)
        self.z = np.where(yes[:, None], z, self.z)
        self.at = np.where(yes[:, None, None], at, self.at)
        self.like = np.where(yes[:, None], like, self.like)
        along[j] *= np.exp(adapt * 0.1 * (yes.mean() - 0.44))
