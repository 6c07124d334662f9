"""Contacts of a curved whisker in space with an unknown friction or curvature: nodes of that.

Where it is known, `azimuths` has the posterior of all else, whose evidence and moments are smooth
in the unknown's normal coordinate z: as in `nodes`, they are summed by the trapezoid rule. One
table serves all nodes.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr, ndtri

from .._values import Array
from .azimuths import FULL, AroundGrid, around, starts
from .coordinates import from_normal
from .grid import OwnGrids, weighted_quantiles
from .nodes import conditional
from .observer import Observer
from .tiled import Moments


class AroundNodes(OwnGrids):
    """The posterior of a reading (R,) over nodes of the last unknown.

    At each node it is that of an `AroundGrid`. Steps are halved, where there is mass, until sums
    over every other node are those over all.
    """

    parts = 16

    def __init__(self, observer: Observer, reading: Array, wanted: float) -> None:
        self.observer, name = observer, observer.unknowns[-1]
        self.value = from_normal(observer.prior[name])
        self.grids: dict[int, AroundGrid] = {}
        self.error = np.full((1, len(observer.unknowns)), np.inf)
        log: dict[int, float] = {}
        stride, left = self.parts, set(range(-4 * self.parts, 4 * self.parts + 1, self.parts))
        while left:
            for k in left:
                log[k], z = -np.inf, k / self.parts
                frame = around(conditional(observer, name, z))
                assert frame is not None
                start = next(starts(frame, reading[None]))
                if np.isfinite(start.height.max()):
                    self.grids[k] = grid = AroundGrid(frame, start)
                    log[k] = float(grid.moments.log_evidence[0]) - 0.5 * z**2
            top = max(log.values())
            if not np.isfinite(top):
                break
            self._sum({k: log[k] for k in sorted(self.grids)}, stride)
            # At four sds the prior alone is e^-8 below its top.
            whole = max(log[min(log)], log[max(log)]) < top - 7
            if (whole and (self.error <= wanted / 2).all()) or stride == 1:
                break
            heavy = [k for k in log if log[k] > top - 20]
            stride //= 2
            left = {k + side * stride for k in heavy for side in (-1, 1)} - set(log)

    def _sum(self, log: dict[int, float], stride: int) -> None:
        at, grids = np.array(list(log)), [self.grids[k] for k in log]
        self.z, self.step = at / self.parts, stride / self.parts
        weight = np.exp(np.array(list(log.values())) - max(log.values()))
        self.weight = weight / weight.sum()
        mean, sd = (np.array([getattr(g.moments, of)[0] for g in grids]) for of in ("mean", "sd"))
        best = int(weight.argmax())
        self.turned = FULL * np.round((mean[best, 2] - mean[:, 2]) / FULL)
        mean[:, 2] += self.turned
        mean, sd = np.column_stack([mean, self.value(self.z)]), np.column_stack([sd, 0 * self.z])

        def sums(some: Array) -> tuple[Array, Array]:
            share = some / some.sum()
            first = share @ mean
            return first, np.sqrt(share @ (sd**2 + (mean - first) ** 2))

        first, width = sums(self.weight)
        off = np.zeros(len(first))
        for side in (0, 1):
            half = self.weight * (at // stride % 2 == side)
            other, wide = sums(half) if half.any() else (first + np.inf, width)
            off = np.maximum(off, np.maximum(np.abs(other - first), np.abs(wide - width)) / width)
        own = self.weight @ np.array([g.error[0].max() for g in grids])
        self.error = (np.where(off < 0.1, off**1.5, off) + own)[None]
        contact = np.append(grids[best].moments.contact[0], self.value(self.z[[best]]))[None]
        signals = np.nan_to_num(self.observer.signals(contact)[0], nan=1.0)
        total = max(log.values()) + np.log(weight.sum() * self.step / np.sqrt(FULL))
        none = np.zeros(1)
        self.moments = Moments(
            first[None], width[None], np.array([total]), self.weight.max(keepdims=True), contact,
            signals, none, none,
        )  # fmt: skip

    def quantiles(self, p: Array, unknown: int) -> tuple[Array, Array]:
        """Quantiles (1, Q) and their errors: of the mixture, and between nodes of the last."""
        if unknown == 3:
            z = np.linspace(self.z[0], self.z[-1], 16 * len(self.z))
            log = make_interp_spline(
                self.z, np.log(self.weight + 1e-300), k=min(3, len(self.z) - 1)
            )
            value, mass = self.value(z), np.exp(log(z))
            found, error = weighted_quantiles(value, mass, p)
            return found[None], error[None]
        parts = [self.grids[int(k)].marginals[unknown] for k in np.rint(self.z * self.parts)]
        turned = self.turned if unknown == 2 else 0 * self.turned
        parts = [(value + turn, mass) for (value, mass), turn in zip(parts, turned, strict=True)]
        ends = [value[[0, -1]] for value, _ in parts]
        value = np.linspace(np.min(ends), np.max(ends), 4001)
        # Normal scores of cumulative probabilities are next to straight between values.
        below = np.zeros(value.shape)
        for (own, mass), share in zip(parts, self.weight, strict=True):
            rise = (np.cumsum(mass) - mass / 2) / mass.sum()
            below += share * ndtr(np.interp(value, own, ndtri(np.clip(rise, 1e-15, 1 - 1e-15))))
        found, other = (np.interp(p, below[::k], value[::k])[None] for k in (1, 2))
        return found, np.abs(found - other)

    def draws(self, count: int, rng: np.random.Generator) -> Array:
        """Contacts (1, count, U) of nodes drawn, the last unknown up to half a step about them."""
        node = rng.choice(len(self.z), count, p=self.weight)
        out = np.empty((1, count, 4))
        for i in np.unique(node):
            here = node == i
            out[0, here, :3] = self.grids[int(np.rint(self.z[i] * self.parts))].draws(
                here.sum(), rng
            )
        out[0, :, 2] += self.turned[node]
        out[0, :, 3] = self.value(self.z[node] + self.step * (rng.random(count) - 0.5))
        return out
