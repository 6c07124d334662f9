"""Posteriors summed over tiles of all unknowns but the last, which is summed at every node."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.interpolate import make_interp_spline

from .._values import Array, Index
from .result import among
from .scale_table import Likelihoods, ScaleTable
from .summed import LastCurve, LastSummed
from .tiled import TiledObserver, Weighed, last_moments
from .tiling import ORDER, rule


class SummedTiles(TiledObserver):
    """As `TiledObserver`, for the nodes of `LastSummed`."""

    together = 32

    def __init__(self, likelihood: LastSummed, *args: object, **kwargs: object) -> None:
        self.likelihood, self.scales = likelihood, likelihood.scales
        super().__init__(likelihood.observer, *args, **kwargs)  # type: ignore[arg-type]

    def _prepare(self, signals: Array) -> None:
        likelihood = self.likelihood
        self._parts = signals
        self._centre = np.array([(ORDER**self.dim + ORDER ** (self.dim - 1)) // 2])
        if likelihood.table:
            unit = likelihood.middle(signals)
            # Where there is no contact numbers stay finite: such nodes are left out in the end.
            self._known_weight = np.maximum(self.log_weight, -1e3)
            unit = unit.reshape(-1, unit.shape[-1])
            self._told = likelihood.table.prepared(unit, self._known_weight.ravel())
        else:
            self._width = likelihood.widths(signals[:, self._centre])[:, 0]
        # Linear between the few nodes along each axis, and on to the tile's ends.
        x = rule(1)[0][:, 0]
        part = (x - x[1]) / (x[ORDER - 2] - x[1])
        line = np.stack([1 - part, part])
        self._between = line
        for _ in range(self.dim - 1):
            self._between = np.kron(self._between, line)
        self._bulge = np.ones(1)
        for _ in range(self.dim):
            self._bulge = np.kron(self._bulge, 1 - ((2 * x - 1) / (1 - 2 * x[1])) ** 2)

    def _curve(self, reading: Array, tile: Index, nodes: Index | slice = slice(None)) -> LastCurve:
        """Curves (n, N) of pairs of a reading (n, R) and a tile: of some nodes, or all."""
        return self.likelihood.curve(reading, self._parts[tile][:, nodes])

    def found(self, reading: Array) -> tuple[Index, Index, Index, Index]:
        """Pairs of a reading (B, R) and a tile, and the first and the last panel of each."""
        panels = self.likelihood.panels
        first = np.full((len(reading), self.count), panels, dtype=np.int16)
        last = np.full_like(first, -1)
        for panel in range(panels):
            pair = self.find(reading, panel)
            first[pair] = np.minimum(first[pair], panel)
            last[pair] = panel
        row, tile = np.nonzero(last >= 0)
        return row, tile, first[row, tile].astype(np.intp), last[row, tile].astype(np.intp)

    def weigh(self, reading: Array, *, whole: bool = False, most: int = 4) -> Weighed:
        likelihood = self.likelihood
        if likelihood.table:
            return self._looked_up(likelihood.table, reading, whole)
        row, tile, low, high = self.found(reading)
        curve = self._curve(reading[row], tile, self._centre)
        first = likelihood.search(curve, low, high, self._width[tile], 1)
        centre = (first.height + np.log(first.width))[:, 0]
        log = centre[:, None] + self.log_weight[tile][:, self._centre]
        # The best place of a tile is up to four sds from its centre.
        live = self._matters(row, tile, log, self.negligible + 8.0)
        row, tile, centre = row[live], tile[live], centre[live]
        first = among(first, live)
        curve = self._curve(reading[row], tile, self._few)
        start = np.repeat(first.place, len(self._few), axis=1)
        peak = likelihood.climb(curve, start, self._width[tile], 3)
        peak = peak._replace(reach=np.maximum(peak.reach, first.reach))
        ends = peak.height + np.log(peak.width)
        log = ends + self._few_weight[tile]
        live = self._matters(row, tile, log)
        row, tile, log, ends, centre = (c[live] for c in (row, tile, log, ends, centre))
        index, width, _, reach = (column[live] for column in peak)
        # One stride for each reading: 1.2 of its narrowest bumps, at which sums are exact to 1e-6.
        best = np.full(len(reading), -np.inf)
        np.maximum.at(best, row, log.max(axis=1, initial=-np.inf))
        narrow = np.where(log > best[row, None] - 8, width, np.inf).min(axis=1, initial=np.inf)
        narrowest = np.full(len(reading), likelihood.reach)
        np.minimum.at(narrowest, row, narrow)
        stride = np.maximum((1.2 * narrowest / likelihood.step).astype(np.intp), 1)
        about = self._about(np.asarray(ends, float), np.asarray(centre, float), tile)
        pair, node = np.nonzero((about > best[row, None] - self.negligible) | whole)
        points = np.ceil(reach.max(axis=1, initial=0.0) / (stride[row] * likelihood.step)).astype(
            int
        )
        middle = np.einsum("pc,cp->p", index[pair], self._between[:, node])
        step = np.rint((middle - likelihood.half - 1) / stride[row[pair]]).astype(np.intp)
        curve = self._curve(reading[row], tile)
        return self._summed(row, tile, stride, pair, node, step, points[pair], curve, most)

    def _about(self, few: Array, centre: Array, tile: Index) -> Array:
        """About the weights of all nodes, in ln, by those of the few and the centre of tiles.

        Nodes of none are left out, but not where the density along a tile is asked for.
        """
        about = few @ self._between + (centre - few.mean(axis=1))[:, None] * self._bulge
        about += self.log_weight[tile]
        return np.asarray(about)

    def _looked_up(self, table: ScaleTable, reading: Array, whole: bool) -> Weighed:
        """`weigh` where a table knows the sums over the last unknown."""
        row, tile = self.find(reading)
        centre = table.integral(self._likelihoods(table, reading, row, tile, self._centre))
        top = np.full(len(reading), -np.inf)
        np.maximum.at(top, row, centre)
        # The best place of a tile is up to four sds from its centre, and may add to a variance.
        live = centre > top[row] - self.negligible - 10.0
        row, tile, centre = row[live], tile[live], centre[live]
        corner = [np.repeat(row, len(self._few)), np.repeat(tile, len(self._few))]
        corner.append(np.tile(self._few, len(row)))
        log = table.integral(self._likelihoods(table, reading, *corner))
        log = log.reshape(-1, len(self._few))
        live = self._matters(row, tile, log)
        row, tile, log, centre = row[live], tile[live], log[live], centre[live]
        few = log - self._known_weight[tile[:, None], self._few]
        centre = centre - self._known_weight[tile, self._centre]
        best = np.full(len(reading), -np.inf)
        np.maximum.at(best, row, log.max(axis=1, initial=-np.inf))
        about = self._about(few, centre, tile)
        pair, node = np.nonzero((about > best[row, None] - self.negligible) | whole)
        whose = row[pair]
        found = self._likelihoods(table, reading, whose, tile[pair], node)
        log, mean, variance = table.summed(found)
        top = np.full(len(reading), -np.inf)
        np.maximum.at(top, whose, log)
        log -= np.where(np.isfinite(top), top, 0.0)[whose]
        weight = np.exp(log, out=log)
        weights = np.zeros((len(row), self.log_weight.shape[1]))
        weights[pair, node] = weight
        total = np.bincount(whose, weight, len(reading))
        with np.errstate(invalid="ignore"):
            first = np.bincount(whose, weight * mean, len(reading)) / total
            variance += (mean - first[whose]) ** 2
            sd = np.sqrt(np.bincount(whose, weight * variance, len(reading)) / total)
        highest = np.flatnonzero(weight == 1.0)
        place = np.zeros(len(reading))
        place[whose[highest]] = table.scores(among(found, highest))[0]
        return Weighed(row, tile, weights, top, (table.middle * first, table.middle * sd), place)

    def _likelihoods(
        self, table: ScaleTable, reading: Array, row: Index, tile: Index, node: Index
    ) -> Likelihoods:
        """Of readings (B, R), rows (n,) of them, and nodes (n,) of tiles (n,)."""
        index = tile * self.log_weight.shape[1] + node
        return table.likelihoods(self._told(reading, row, index))

    def _with_masses(self, reading: Array, weighed: Weighed, *, spacing: float = 0.8) -> Weighed:
        """With the mass on the last unknown, as where it is summed.

        Bumps at the nodes of a tile lie close together: all are seen at the same steps, of which
        0.8 of the narrowest bump's width leave quantiles 4e-4 sd off, a fifth of what they claim.
        """
        table = self.likelihood.table
        if weighed.last_mass is not None or not table:
            return weighed
        some = np.flatnonzero(weighed.weight.max(axis=1, initial=0.0) > 1e-8)
        row, tile = weighed.row[some], weighed.tile[some]
        nodes = np.arange(weighed.weight.shape[1])
        index = tile[:, None] * len(nodes) + nodes
        told = self._told(reading, np.repeat(row, len(nodes)), index.ravel())
        level, slope, bend = (column.reshape(index.shape) for column in told)
        few = level[:, self._few], slope[:, self._few], bend[:, self._few]
        found = table.likelihoods(few)
        place, width = table.scores(found)
        step = np.full(len(reading), 1.0)
        np.minimum.at(step, row, spacing * width.min(axis=1))
        half = int(np.ceil(8.0 / step.min(initial=1.0)))
        lattice = np.arange(-half, half + 1) * step[:, None]
        at, beside = table.density(np.clip(lattice, -8.0, 8.0))
        beside[np.abs(lattice) > 8.0] = -np.inf
        # The few nodes lie a fifth of their distance within a tile's ends. Wide bumps are skewed.
        apart = np.ptp(place, axis=1)
        beyond = 6 * (width * (1 + 3 * found.width)).max(axis=1) + 0.25 * apart
        points = 4 * np.ceil((apart + 2 * beyond) / step[row] / 4 + 0.25).astype(np.intp)
        points = np.minimum(points, lattice.shape[1])
        start = np.floor((place.min(axis=1) - beyond) / step[row]).astype(np.intp) + half
        start = np.clip(start, 0, lattice.shape[1] - points) + row * lattice.shape[1]
        powers = np.stack([level - weighed.top[row, None], slope, bend], axis=-1)
        mass = np.zeros(lattice.size)
        for pairs in _blocks(np.arange(len(row)), points, size=128):
            into = start[pairs, None] + np.arange(points[pairs[0]])
            x = at.take(into)
            log = powers[pairs] @ np.stack([np.ones_like(x), x, x * x], axis=1)
            # Seven digits do, in less than half the time.
            of_tile = np.exp(log, dtype="f4", casting="unsafe").sum(axis=1)
            of_tile = of_tile * np.exp(beside.take(into))
            mass += np.bincount(into.ravel(), of_tile.ravel(), minlength=len(mass))
        of_last = np.asarray(mass.reshape(lattice.shape), dtype=np.float64)
        return weighed._replace(last_mass=of_last, last_step=step)

    def _summed(
        self,
        row: Index,
        tile: Index,
        stride: Index,
        pair: Index,
        node: Index,
        centre: Index,
        points: Index,
        curve: LastCurve,
        most: int,
        *,
        lost: float = 1e-6,
    ) -> Weighed:
        """The sums at nodes of pairs (m,), so many points to either side of their centres.

        And again with twice as many where a share that is `lost` beyond the last may count.
        """
        likelihood, count = self.likelihood, len(stride)
        whose, own = row[pair], stride[row[pair]]
        weight_of = self.log_weight[tile[pair], node]
        logs = np.full(len(pair), -np.inf)
        top = np.full(count, -np.inf)
        turn = np.ones((2, len(pair))) if likelihood.turns else None
        size = 2 * (int(np.ceil(likelihood.half / stride.min())) + 1) + 1
        kept: list[tuple[Index, Array, Array]] = []
        left: Index = np.arange(len(pair))
        first: Index = centre * own + (likelihood.half + 1)
        for attempt in range(most):
            again: list[Index] = []
            for some in _blocks(left, points):
                about: Index = np.arange(-points[some[0]], points[some[0]] + 1)
                steps = first[some, None] + about * own[some, None]
                index = likelihood.at(steps)
                share = curve.at(pair[some], node[some], index)
                high = share.max(axis=1)
                share -= np.where(np.isfinite(high), high, 0.0)[:, None]
                np.exp(share, out=share)
                total = share.sum(axis=1)
                with np.errstate(divide="ignore", invalid="ignore"):
                    logs[some] = np.log(total) + high + weight_of[some]
                    np.maximum.at(top, whose[some], logs[some])
                    edge = (share[:, 0] + share[:, -1]) * np.exp(logs[some] - top[whose[some]])
                    if turn is not None:
                        ratio = curve.turn(pair[some], node[some], index)
                        turn[0, some] = (share * ratio).sum(axis=1) / total
                        turn[1, some] = (share * ratio**2).sum(axis=1) / total
                off = (edge > lost * total) & (attempt + 1 < most)
                if off.any():
                    again.append(some[off])
                    some, share, total = some[~off], share[~off], total[~off]
                kept.append((some, share, total))
            left = np.concatenate(again) if again else left[:0]
            points[left] *= 2
        weight_of = np.exp(logs - np.where(np.isfinite(top), top, 0.0)[whose])
        mass = np.zeros(count * size)
        first = whose * size + np.clip(centre + size // 2, 0, size - 1)
        for some, share, total in kept:
            share *= (weight_of[some] / np.where(total > 0, total, 1.0))[:, None]
            number = share.shape[1] // 2
            into = first[some, None] + np.arange(-number, number + 1)
            np.clip(into, 0, len(mass) - 1, out=into)
            mass += np.bincount(into.ravel(), share.ravel(), minlength=len(mass))
        weight = np.zeros((len(row), self.log_weight.shape[1]))
        weight[pair, node] = weight_of
        steps = (np.arange(size) - size // 2) * stride[:, None]
        value = likelihood.value[likelihood.at(likelihood.half + 1 + steps)]
        place = np.zeros(count, dtype=np.intp)
        highest = np.flatnonzero(weight_of == 1.0)
        place[whose[highest]] = centre[highest]
        best = likelihood.z[likelihood.at(likelihood.half + 1 + place * stride)].astype(np.float64)
        top = top + np.log(stride * likelihood.step)
        of_last = np.asarray(mass.reshape(count, size), dtype=np.float64)
        last = last_moments(value, of_last)
        turned: tuple[Array, Array] | None = None
        if turn is not None:
            turned = np.zeros_like(weight), np.zeros_like(weight)
            for into_, of_node in zip(turned, np.nan_to_num(turn), strict=True):
                into_[pair, node] = of_node
        apart = np.asarray(stride * likelihood.step, dtype=np.float64)
        return Weighed(row, tile, weight, top, last, best, of_last, apart, turned)

    def last_quantiles(
        self,
        reading: Array,
        weighed: Weighed,
        probability: Array,
        lost: Array,
        *,
        finer: int = 16,
    ) -> tuple[Array, Array]:
        """Quantiles (B, Q) of the last unknown, and their errors.

        Its density is known at even steps of its coordinate, narrower than any bump: a spline
        through it is integrated, and one of a lower degree tells the error.
        """
        weighed = self._with_masses(reading, weighed)
        assert weighed.last_mass is not None
        assert weighed.last_step is not None
        mass, middle = weighed.last_mass, weighed.last_mass.shape[1] // 2
        rows = len(mass)
        held = np.flatnonzero((mass > 1e-12 * mass.max(axis=1, keepdims=True)).any(axis=0))
        if not held.size:
            none = np.full((rows, len(probability)), np.nan)
            return none, none
        knots = np.arange(max(held[0] - 5, 0), min(held[-1] + 6, mass.shape[1]))
        place = np.linspace(knots[0], knots[-1], finer * (len(knots) - 1) + 1)
        rising = []
        for degree in (5, 3):
            density = make_interp_spline(knots, mass.T[knots], k=degree)
            rise = np.maximum.accumulate(density.antiderivative()(place).T, axis=1)
            rising.append(rise / np.maximum(rise[:, -1:], 1e-300))
        sure = np.zeros(rows)
        sought = [(rising[0], sure), (rising[1], sure), (rising[0], lost), (rising[0], -lost)]
        out = np.full((len(sought), rows, len(probability)), np.nan)
        step = weighed.last_step
        for i in np.flatnonzero(mass.sum(axis=1) > 0):
            z = (place - middle) * step[i]
            inside = np.diff(rising[0][i], append=2.0) > 0
            for found, (rise, by) in zip(out, sought, strict=True):
                p = np.clip(probability + by[i], 0.0, 1.0)
                found[i] = np.clip(np.interp(p, rise[i][inside], z[inside]), -8, 8)
        value, other, above, below = self.observer.last_unknown(out)
        return value, np.abs(value - other) + np.abs(above - below) / 2

    def completed(
        self, reading: Array, x: Array, rng: np.random.Generator, *, points: int = 161
    ) -> Array:
        """Contacts (B, n, U): the last unknown is drawn where the others (B, n, d) have been.

        Of its density at each, by points in the range that it has at all, and straight between.
        """
        likelihood, size = self.likelihood, self.likelihood.size
        first = self.likelihood.contact(x)[0]
        drawn = np.full(first.shape[:2], np.nan)
        for i, y in enumerate(reading):
            weighed = self._with_masses(y[None], self.weigh(y[None]))
            assert weighed.last_mass is not None
            assert weighed.last_step is not None
            held = np.flatnonzero(weighed.last_mass[0] > 1e-9 * weighed.last_mass[0].max())
            if not held.size or np.isnan(first[i]).any():
                continue
            middle = weighed.last_mass.shape[1] // 2
            step = weighed.last_step[0]
            low, high = (held[0] - 1 - middle) * step, (held[-1] + 1 - middle) * step
            points_here = max(points, 4 * (held[-1] - held[0]))
            z = np.linspace(low, high, points_here)
            parts, _ = self.likelihood.signals(x[i], first[i])
            log = np.empty((len(first[i]), points_here))
            for j, functions in enumerate(
                likelihood.basis(np.clip(z, -likelihood.reach, likelihood.reach))
            ):
                seen = parts @ functions
                log[:, j] = self.observer.noise.log_likelihood(y, seen[:, :size]) - 0.5 * z[j] ** 2
                if likelihood.turns:
                    log[:, j] += seen[:, size]
            rise = np.cumsum(np.exp(log - log.max(axis=1, keepdims=True)), axis=1)
            wanted = rng.random(len(rise)) * rise[:, -1]
            above = np.minimum((rise < wanted[:, None]).sum(axis=1), points_here - 1)
            drawn[i] = z[above] + (rng.random(len(rise)) - 0.5) * (z[1] - z[0])
        if likelihood.turns:
            return likelihood.with_z(x, drawn)[0]
        return np.concatenate([first, self.observer.last_unknown(drawn)[..., None]], axis=-1)

    def _misfit(self, tile: Index) -> Array:
        if not self.likelihood.turns:
            return super()._misfit(tile)
        return np.asarray(self._parts[tile, :, -1, 0])

    def _at_best(self, tile: Index, node: Index, weighed: Weighed) -> tuple[Array, Array]:
        if not self.count:
            return (
                np.full((len(tile), self.dim + 1), np.nan),
                np.full((len(tile), len(self.observer.cue.signal_names)), np.nan),
            )
        assert weighed.last_best is not None
        first = self.tiles.nodes.contact[tile, node]
        contact = self.likelihood.with_last(first, weighed.last_best)
        signals, _ = self.observer.signals(contact)
        return contact, np.nan_to_num(signals, nan=1.0)


def _blocks(rows: Index, points: Index, *, size: int = 2048) -> Iterator[Index]:
    """The rows, those with as many points together, in blocks that stay in the cache."""
    for number in np.unique(points[rows]):
        some = rows[points[rows] == number]
        for start in range(0, len(some), size):
            yield some[start : start + size]
