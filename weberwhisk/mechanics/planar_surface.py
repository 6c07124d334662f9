"""The base signals of a curved or rubbing whisker as a surface over contacts, for posteriors.

What `surface` is to the straight elastica, this is to the planar beam: the equations are solved
once, at Chebyshev nodes, and interpolated from then on. Contacts are those that push the whisker
towards positive angles: positive curvature is contact on the convex side, negative on the concave.

At a radial distance the branch of equilibria runs from rest to the fold, or to the tip where that
comes first (from the distance r* on). Signals go as the square root of what is left to the fold.
Let P be the push at the fold, and beyond r* a curve that leaves it smoothly; the coordinate across
is then c = √(1 − push/P), from 1 at rest to the end of the branch. Along, it is r/r* below r*, and
above it √(r_turn − r), where r_turn is the largest distance that a loaded tip gets to: there the
last push has its own square root. Signals are tabled over the small-angle lateral force of the
straight taper. Whatever may be uncertain (friction, curvature) is one more Chebyshev axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..whisker import Whisker
from . import profile as planar
from .branches import (
    LAST,
    Grid,
    NotFound,
    branch,
    folds,
    grid_of,
    on_tip,
    reach_of,
    rise_of,
    tip_folds,
    turns,
)
from .chebyshev import Array, ChebyshevTable, basis, fit, nodes, product
from .contact import Outcome
from .continuation import zero_load
from .shape import Profile, Spiral

#: Nodes along each axis of what is uncertain.
UNCERTAIN = 7


class PlanarSurface:
    """Moment, axial and transverse force of one curved or rubbing whisker at any contact.

    Parameters
    ----------
    whisker : Whisker or Profile
        One whisker.
    friction : (float, float)
        Friction angles that it is made for, rad; twice the same where it is known.
    offset : (float, float)
        As much, 1/m, may the curvature differ from the whisker's along its whole length.
    """

    def __init__(
        self,
        whisker: Whisker | Profile,
        friction: tuple[float, float] = (0.0, 0.0),
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.whisker = whisker
        self.profile = whisker if isinstance(whisker, Profile) else Profile.of(whisker)
        base = self.profile.whisker
        self.length, self.stiffness = float(base.length), float(base.stiffness)
        self._ends = (friction, offset)
        axes = [nodes(UNCERTAIN) if high > low else np.zeros(1) for low, high in self._ends]
        shape = [len(axis) for axis in axes]
        psi, kappa = (
            low + (high - low) * axis.ravel()
            for (low, high), axis in zip(self._ends, np.meshgrid(*axes, indexing="ij"), strict=True)
        )
        grid = grid_of(self.profile, psi, kappa)
        law = grid.rows.law
        assert law is not None
        turn = np.max(np.abs([law.turn(np.full(psi.size, x)) for x in (0.25, 0.5, 0.75, 1.0)]))
        if turn > 2.0:  # tables are made for whiskers that do not wind
            raise ValueError(
                f"Observers take whiskers that turn by up to 2 rad from base to tip, "
                f"got {turn:.3g}; give a smaller curvature."
            )
        self.taper = grid.taper
        try:
            with np.errstate(all="ignore"):
                # Nodes along and across, more where the error over the lateral force is more than
                # a thousandth of a Weber fraction of 0.01.
                for self._along, self._across in ((20, 14), (32, 18)):
                    self._build(grid, shape)
                    self.error = self._certified()
                    if self.error < 1e-5:
                        break
        except NotFound:
            low, high = offset
            remedy = (
                'curvature or friction, or model="profile", which solves each contact by itself'
            )
            if high > low:
                remedy = f"spread to the curvature, whose 7 sd are {low:.3g} to {high:.3g} 1/m more"
            raise ValueError(
                f"The folds of {whisker} were not found; give less {remedy}."
            ) from None

    def _build(self, grid: Grid, shape: list[int]) -> None:
        count = grid.friction.size
        reach = reach_of(grid)

        def table(values: Array, axes: int) -> Array:
            """Coefficients of values (n, …) whose first axis is what is uncertain, that axis last.

            `axes` more are those of nodes.
            """
            out = values.reshape(*shape, *values.shape[1:])
            for axis in (0, 1):
                out = np.moveaxis(fit(np.moveaxis(out, axis, 0)), 0, axis)
            for axis in range(2, 2 + axes):
                out = np.moveaxis(fit(np.moveaxis(out, axis, 0)), 0, axis)
            return out.reshape(count, *values.shape[1:])

        f_star, r_star = tip_folds(grid)
        # Up to the distance at which the tip is at the fold.
        along = nodes(self._along)
        r = (r_star[:, None] * along).ravel()
        wide = grid.repeated(self._along)
        rest = zero_load(wide.rows, r)[1]
        s, f = folds(wide, r, self._along)
        fold = wide.path(s, f).deflection - rest
        inner = branch(wide, r, (s, f), fold, fold, np.zeros_like(r), self._across)
        v = grid.taper * r / np.repeat(reach, self._along)
        tables = [(fold / (1 - v), rest, inner)]
        # From there on, the tip.
        r_turn, rise = reach, np.zeros(count)
        if np.all(reach - r_star > 1e-9):
            f_turn, r_turn = turns(grid, f_star)
            r_turn = np.maximum(np.minimum(r_turn, 2 * reach - r_star), reach)
            first = np.sqrt((r_turn - reach) / (r_turn - r_star))
            t = first[:, None] + (1 - first[:, None]) * along
            r = (r_turn[:, None] - t**2 * (r_turn - r_star)[:, None]).ravel()
            f = (f_turn[:, None] + t * (f_star - f_turn)[:, None]).ravel()
            one, f = np.ones_like(r), on_tip(wide, r, f, np.repeat(f_star, self._along))
            rest = zero_load(wide.rows, r)[1]
            tip = wide.path(one, f).deflection - rest
            rise = rise_of(grid, f_star, r_star, r_turn, first)
            floor = (rise[:, None] * (1 - along)).ravel()
            outer = branch(wide, r, (one, f), tip, tip / (1 - floor**2), floor, self._across)
            tables.append((tip, rest, outer))
        self._marks = table(np.stack([reach, r_star, r_turn, rise], axis=-1), 0)
        self._curves = [
            table(np.stack([last, rest], axis=-1).reshape(count, self._along, 2), 1)
            for last, rest, _ in tables
        ]
        self._tables = [
            table(values.reshape(self._across, count, self._along, 3).transpose(1, 2, 0, 3), 2)
            for *_, values in tables
        ]

    # -- evaluation ----------------------------------------------------------------------------

    def _polynomials(self, friction: Array, offset: Array) -> Array:
        """Those (count, n or 1) at what is uncertain; beyond its range, those of its end."""
        parts = []
        for (low, high), value in zip(self._ends, (friction, offset), strict=True):
            known = not high > low
            share = np.zeros(1) if known else np.clip((value - low) / (high - low), 0.0, 1.0)
            parts.append(basis(1 if known else UNCERTAIN, share))
        a, b = parts
        return np.asarray((a[:, None] * b).reshape(len(a) * len(b), -1))

    def _placed(self, r: Array, friction: Array, offset: Array) -> _Placed:
        poly = self._polynomials(friction, offset)
        reach, r_star, r_turn, rise = np.broadcast_to(self._marks.T @ poly, (4, r.size))
        known = (r > 0) & (r <= reach)
        outer = known & (r > r_star)
        x = np.clip(r / r_star, 0.0, 1.0)
        if outer.any():
            first, t = (
                np.sqrt(np.maximum(r_turn - d, 0.0)[outer] / (r_turn - r_star)[outer])
                for d in (reach, r)
            )
            x[outer] = (t - first) / (1 - first)
        last, rest = np.empty((2, r.size))
        for which, curves in zip((~outer, outer), self._curves, strict=False):
            along = basis(self._along, x[which])
            if poly.shape[1] == 1:
                values = np.tensordot(curves, poly[:, 0], (0, 0)).T @ along
            else:
                terms = curves.reshape(len(curves), -1).T @ poly[:, which]
                values = np.einsum("ikn,in->kn", terms.reshape(self._along, 2, -1), along)
            last[which], rest[which] = values
        v = 1 - self.taper * np.minimum(r / reach, 1.0)
        last = np.where(outer, last, last * v)
        floor = np.where(outer, rise * (1 - x), 0.0)
        return _Placed(poly, known, outer, x, last, rest, floor, v)

    def limit(self, r: Array, friction: Any = 0.0, offset: Any = 0.0) -> Array:
        """Largest push, from rest, at each distance (n,), rad; NaN out of reach."""
        place = self._placed(r / self.length, *np.atleast_1d(friction, offset))
        return np.where(place.known, place.last, np.nan)

    def reach(self, offset: float = 0.0) -> float:
        """Distance of the tip at rest, m."""
        poly = self._polynomials(np.array([self._ends[0][0]]), np.atleast_1d(offset))
        return self.length * float(self._marks[:, 0] @ poly[:, 0])

    def rest(self, r: Array, friction: Any = 0.0, offset: Any = 0.0) -> Array:
        """Deflection angle at each distance (n,) at which the whisker at rest just touches, rad."""
        place = self._placed(r / self.length, *np.atleast_1d(friction, offset))
        return np.where(place.known, place.rest, np.nan)

    def __call__(
        self, r: Array, push: Array, friction: Any = 0.0, offset: Any = 0.0
    ) -> tuple[Array, NDArray[np.int8]]:
        """Signals (n, 3), NaN where not held, and outcomes (n,) at distances and pushes (n,).

        The push is the angle from the one at which the whisker at rest touches.
        """
        distance = np.asarray(r, dtype=float) / self.length
        place = self._placed(distance, *np.atleast_1d(friction, offset))
        held = place.known & (push >= 0) & (push <= place.last)
        with np.errstate(all="ignore"):
            c = np.sqrt(np.maximum(1 - push * (1 - place.floor**2) / place.last, 0.0))
            w = np.clip((c - place.floor) / (1 - place.floor), 0.0, 1.0)
            ratio = self._ratios(place, np.where(held, w, 0.0))
            lateral = 3 * push * place.room / distance**2 * (self.stiffness / self.length**2)
            out = lateral[:, None] * ratio
            out[:, 0] *= r
        out[~held] = np.nan
        lost = np.where(place.outer, Outcome.SLIPPED_OFF_TIP, Outcome.FLICKED_PAST)
        lost = np.where(push < 0, Outcome.NO_TOUCH, lost)
        lost = np.where(place.known, lost, Outcome.OUT_OF_REACH)
        return out, np.where(held, Outcome.HELD, lost).astype(np.int8)

    def _ratios(self, place: _Placed, w: Array) -> Array:
        out = np.empty((w.size, 3))
        for which, table in zip((~place.outer, place.outer), self._tables, strict=False):
            some = np.flatnonzero(which)
            if place.poly.shape[1] == 1:
                whole = ChebyshevTable(np.asarray(np.tensordot(table, place.poly[:, 0], (0, 0))))
                out[some] = whole(place.x[some], w[some]).T
                continue
            rows = np.ascontiguousarray(table.reshape(len(table), -1).T)
            for i in range(0, some.size, 1024):
                at = some[i : i + 1024]
                terms = product(rows, place.poly[:, at]).reshape(self._along, self._across, 3, -1)
                across = np.einsum("xckn,cn->xkn", terms, basis(self._across, w[at]))
                out[at] = np.einsum("xkn,xn->nk", across, basis(self._along, place.x[at]))
        return out

    def _certified(self, count: int = 60) -> float:
        """The largest error of contacts all over, beside the planar beam's own solution."""
        rng = np.random.default_rng(20261122)
        friction, offset = (low + (high - low) * rng.random(count) for low, high in self._ends)
        reach = self._marks[:, 0] @ self._polynomials(friction, offset) * np.ones(count)
        r = reach * self.length * rng.uniform(0.01, 0.999, count)
        rest, limit = self.rest(r, friction, offset), self.limit(r, friction, offset)
        push = limit * rng.uniform(0.001, 0.998, count)
        whisker: Whisker | Profile = self.whisker
        if np.any(offset):
            law = self.profile.law
            assert isinstance(law, Spiral)
            bent = Spiral(law.base + offset, np.broadcast_to(law.rate, count))
            whisker = self.profile.curved(bent)
        true = planar.press(whisker, r, rest + push, friction)
        found = self(r, push, friction, offset)[0]
        room = 1 - self.taper * r / (reach * self.length)
        lateral = 3 * push * room * self.stiffness / r**2
        exact = np.stack([true.moment / r, true.axial_force, true.transverse_force], axis=-1)
        found[:, 0] /= r
        off = np.abs(found - exact) / lateral[:, None]
        beyond = (true.outcome == Outcome.SLIPPED_OFF_TIP) & (r > LAST * reach * self.length)
        off[beyond & (len(self._tables) == 1)] = 0.0
        return float(np.max(np.where(np.isnan(off), np.inf, off)))


@dataclass(frozen=True)
class _Placed:
    """Where contacts lie on the tables: see `PlanarSurface`."""

    poly: Array
    known: NDArray[np.bool_]
    outer: NDArray[np.bool_]
    x: Array
    last: Array
    rest: Array
    floor: Array
    room: Array
