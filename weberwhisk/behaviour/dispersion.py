"""The beta-binomial likelihood on a grid, where log-gammas at every node would take minutes.

Sessions at one pair of stimuli share its P, so that their log-likelihood is one function of P for
each ρ: it is tabulated over logit P, and read off at the nodes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import expit

if TYPE_CHECKING:
    from .likelihood import WeberModel

Array = NDArray[np.float64]

FAR = 40.0  # logits beyond which a P is as good as 0 or 1
KNOTS = np.linspace(-FAR, FAR, 1601)


def lines(chance: Array, low: Array, high: Array, lapse: Array, dtype: Any = float) -> Array:
    """lapse + (1 − low − high) chance for every chance (N,) and pair of lapses (L,), (N, L): as a
    matrix product, which is five times as fast as broadcasting."""
    slope = np.maximum(1 - low - high, 0.0)
    factors = np.ones((chance.size, 2), dtype=dtype)
    factors[:, 0] = chance.ravel()
    return factors @ np.array([slope.ravel(), lapse.ravel()], dtype=dtype)


class BetaBinomial:
    """Log-likelihood of overdispersed answers of the cells of one bias.

    Parameters
    ----------
    model : WeberModel
        With the effect `Overdispersion`.
    cells : ndarray of int, shape (C,)
    share : float
        Of the logit's own sd between table entries: at 0.1 errors are 3e-4 a pair, mostly common.
    """

    def __init__(self, model: WeberModel, cells: NDArray[np.intp], share: float = 0.1) -> None:
        self.model, self.cells = model, cells
        columns = np.delete(model.columns, model.dispersed or 0, axis=0)
        encoded = [np.broadcast_to(a, model.group.shape) for a in model.encodings]
        keys = np.column_stack([*encoded, *columns])[cells]
        _, self.first, pair = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.pair = pair.reshape(-1)
        answers = max(float(np.bincount(self.pair, model.cells.n[cells]).max(initial=1.0)), 1.0)
        count = int(np.ceil(2 * FAR * max(np.sqrt(answers) / share / 2, 50.0)))
        self.fine = np.linspace(-FAR, FAR, count + 1)
        self.tables: dict[float, Array] = {}

    def __call__(self, up: Array, down: Array, low: Array, high: Array, rho: Array) -> Array:
        """At chances without lapses (C, P, B), lapses (Lo, Hi), and ρ (P,): (P, B, Lo, Hi)."""
        shape = self.first.size, *up.shape[1:], *low.shape
        # log P − log(1 − P), neither of them by subtraction.
        place = lines(up[self.first], low, high, np.maximum(low, 1e-300))
        place /= lines(down[self.first], low, high, np.maximum(high, 1e-300))
        np.clip(np.log(place, out=place), -FAR, FAR, out=place)
        place += FAR
        place *= (self.fine.size - 1) / (2 * FAR)
        place = place.reshape(shape)
        left = np.minimum(place.astype(np.intp), self.fine.size - 2)
        place -= left
        left += (np.arange(self.first.size) * self.fine.size)[:, None, None, None, None]
        out = np.empty(place.shape[1:])
        for row, one in enumerate(rho):
            table = self._table(float(one))
            below = np.take(table, left[:, row])
            out[row] = (below + place[:, row] * (np.take(table, left[:, row] + 1) - below)).sum(0)
        return out

    def _table(self, rho: float) -> Array:
        """Log-likelihood of every pair's answers over the logits, one pair after another."""
        if rho not in self.tables:
            # A pair's P at the knots, (K, C), each cell with the answers of its session.
            p, q = expit(KNOTS)[:, None], expit(-KNOTS)[:, None]
            cells = self.model.beta_binomial(p, q, np.array(rho))[:, self.cells]
            pairs = np.zeros((KNOTS.size, self.first.size))
            np.add.at(pairs.T, self.pair, cells.T)
            self.tables[rho] = CubicSpline(KNOTS, pairs)(self.fine).T.ravel()
        return self.tables[rho]
