"""The beta-binomial likelihood on a grid, where log-gammas at every node would take minutes.

Sessions at one pair of stimuli share its P, so that their log-likelihood is one function of P for
each ρ: it is tabulated over logit P, and read off at the nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import expit

if TYPE_CHECKING:
    from .likelihood import WeberModel

Array = NDArray[np.float64]

FAR = 40.0  # logits beyond which a P is as good as 0 or 1
KNOTS = np.linspace(-FAR, FAR, 1601)
SHARE = 0.1  # of the logit's own sd between table entries: errors of 3e-4 a pair, mostly common


class DispersedAnswers:
    """Log-likelihood of overdispersed answers by group, for lapses on a sheet of nodes (S,).

    Parameters
    ----------
    model : WeberModel
        With the effect `Overdispersion`.
    low, high : ndarray, shape (S,)
        Lapses as the task sees them.
    """

    def __init__(self, model: WeberModel, low: Array, high: Array) -> None:
        self.model = model
        self.slope, self.low = np.maximum(1 - low - high, 0.0), np.maximum(low, 1e-300)
        self.high = np.maximum(high, 1e-300)
        columns = np.delete(model.columns, model.dispersed or 0, axis=0)
        felt = [np.broadcast_to(a, model.group.shape) for a in model.percepts]
        keys = np.column_stack([model.group, *felt, *columns])
        _, self.first, self.pair = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.pair = self.pair.reshape(-1)
        answers = max(float(np.bincount(self.pair, model.cells.n).max(initial=1.0)), 1.0)
        count = int(np.ceil(2 * FAR * max(np.sqrt(answers) / SHARE / 2, 50.0)))
        self.fine = np.linspace(-FAR, FAR, count + 1)
        self.start = np.arange(self.first.size)[:, None] * self.fine.size
        self.tables: dict[float, Array] = {}

    def __call__(self, d: Array, pushed: Array, effects: Array) -> Array:
        """Shape (r, B, G, S) from decision variables (r, 1, C, 1) and biases (r, B, C, X)."""
        up, down = self.model.task.chance(d[:, :, self.first], pushed[:, :, self.first])
        # log P − log(1 − P), neither of them by subtraction.
        place = np.log((self.slope * up + self.low) / (self.slope * down + self.high))
        place = (np.clip(place, -FAR, FAR) + FAR) * ((self.fine.size - 1) / (2 * FAR))
        left = np.minimum(place.astype(np.intp), self.fine.size - 2)
        place -= left
        left += self.start
        out = np.empty(place.shape)
        for row, rho in enumerate(effects[:, self.model.dispersed]):
            table = self._table(float(rho))
            below = np.take(table, left[row])
            out[row] = below + place[row] * (np.take(table, left[row] + 1) - below)
        return np.asarray(self.model.membership[self.first].T @ out)

    def _table(self, rho: float) -> Array:
        """Log-likelihood of every pair's answers over the logits, one pair after another."""
        if rho not in self.tables:
            # A pair's P at the knots, (K, C), each cell with the answers of its session.
            p, q = expit(KNOTS)[:, None], expit(-KNOTS)[:, None]
            cells = self.model.beta_binomial(p, q, np.array(rho))
            pairs = np.zeros((KNOTS.size, self.first.size))
            np.add.at(pairs.T, self.pair, cells.T)
            self.tables[rho] = CubicSpline(KNOTS, pairs)(self.fine).T.ravel()
        return self.tables[rho]
