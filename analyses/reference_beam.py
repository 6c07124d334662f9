"""Whiskers bent against a point, by SciPy's DOP853 alone, in raw SI units: referee of `stability`.

The whisker is followed from its contact to its base: dp/ds = (cos φ, sin φ), dφ/ds = κ₀ + m/EI(s),
m = (contact − p) × F. Nothing is made dimensionless, tabulated or shared with the package. Many
whiskers are one system of equations; steps are even in the logarithm of the local radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray
#: Most whiskers in one system: their steps are common.
TOGETHER = 64
#: Most evaluations of one system: one that winds up for ever is given up.
PATIENCE = 100_000
#: Small-angle contact angle, rad, past which no trial is followed: folds lie below 5.
MOST = 12.0
#: Share of a step that its correction may be, as a curved whisker has three contacts at one
#: distance and angle, and a longer correction may lead to another; and a step that is short enough.
STRAYED, SHORTEST = 0.2, 1e-4


@dataclass(frozen=True)
class Beams:
    """n whiskers with Coulomb friction: arrays (n,)."""

    length: Array
    base_radius: Array
    tip_radius: Array
    modulus: Array
    curvature: Array
    friction: Array

    def take(self, which: Array) -> Beams:
        """Some of them."""
        return replace(self, **{k: v[which] for k, v in vars(self).items()})

    def follow(self, arc: Array, force: Array, rtol: float = 3e-14) -> dict[str, Array]:
        """Signals at the base and the contact's place, given contact arc and force."""
        parts = []
        for start in range(0, arc.size, TOGETHER):
            part = slice(start, start + TOGETHER)
            parts.append(self.take(part)._follow(arc[part], force[part], rtol))
        return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}

    def _follow(self, arc: Array, force: Array, rtol: float) -> dict[str, Array]:
        n = arc.size
        arc, force = np.nan_to_num(arc, nan=1e-3), np.nan_to_num(force)
        slope = (self.base_radius - self.tip_radius) / self.length
        # s = arc·(1 − e)/(…) with the radius geometric in t: even steps in its logarithm.
        lost = np.minimum(slope * arc / self.base_radius, 1 - 1e-12)
        at_contact = self.base_radius * (1 - lost)
        growth = -np.log1p(-lost)  # ln of base radius over the radius at the contact
        side = np.where(force < 0, -1.0, 1.0)
        push = np.abs(force)
        force_x, force_y = -push * np.sin(self.friction), side * push * np.cos(self.friction)
        stiff = self.modulus * np.pi / 4
        left = iter(range(PATIENCE))

        def rates(t: float, state: Array) -> Array:
            if next(left, None) is None:
                return np.full(3 * n, np.nan)  # which ends the integration
            angle, x, y = state.reshape(3, n)
            radius = at_contact * np.exp(growth * t)
            # ds/dt < 0: radius = base − slope·s, and where nothing tapers s = arc·(1 − t).
            pace = np.where(lost > 1e-9, radius * growth / np.where(lost > 1e-9, slope, 1.0), arc)
            moment = -x * force_y + y * force_x
            turn = self.curvature + moment / (stiff * radius**4)
            return np.concatenate([-turn * pace, -np.cos(angle) * pace, -np.sin(angle) * pace])

        tiny = np.concatenate([np.full(n, 1e-18), 1e-18 * self.length, 1e-18 * self.length])
        state = np.zeros(3 * n)
        run = solve_ivp(rates, (0.0, 1.0), state, method="DOP853", rtol=rtol, atol=tiny)
        angle, x, y = run.y[:, -1].reshape(3, n) if run.success else np.full((3, n), np.nan)
        # Turn the contact's frame into the base's.
        c, s = np.cos(angle), -np.sin(angle)
        along, across = -(c * x - s * y), -(s * x + c * y)
        axial, transverse = -(c * force_x - s * force_y), s * force_x + c * force_y
        return {
            "moment": along * transverse + across * axial,
            "axial_force": axial,
            "transverse_force": transverse,
            "radial_distance": np.hypot(along, across),
            # Counted on past half a turn.
            "deflection_angle": np.arctan2(-y, -x) - angle,
            "contact_angle": -angle,
        }

    def sideways(self, arc: Array, force: Array, poisson_ratio: float = 0.38) -> Array:
        """How far a unit of force out of the plane moves the contact out of it, m/N.

        Positive at rest; where it is no longer, the whisker leaves the plane by itself. By the
        equations of a rod linearised about the planar one: rotations ω of its cross-sections about
        axes in the plane and z out of it, ω' = (1 + ν) t(t·q)/EI + n(n·q)/EI, q = δm − ω × m.
        """
        parts = [np.empty(0)]  # of no contacts there is none
        for start in range(0, arc.size, TOGETHER):
            part = slice(start, start + TOGETHER)
            parts.append(self.take(part)._sideways(arc[part], force[part], poisson_ratio))
        return np.concatenate(parts)

    def _sideways(self, arc: Array, force: Array, poisson_ratio: float) -> Array:
        n = arc.size
        push, side = np.abs(force), np.where(force < 0, -1.0, 1.0)
        force_x, force_y = -push * np.sin(self.friction), side * push * np.cos(self.friction)
        aside = np.cos(self.friction)

        def rates(t: float, state: Array) -> Array:
            angle, x, y, turn_x, turn_y, z = state.reshape(6, n)
            slope = (self.base_radius - self.tip_radius) / self.length
            stiff = self.modulus * np.pi / 4 * (self.base_radius - slope * arc * (1 - t)) ** 4
            moment = -x * force_y + y * force_x
            q_x = z * force_y - y * aside - turn_y * moment
            q_y = x * aside - z * force_x + turn_x * moment
            c, s = np.cos(angle), np.sin(angle)
            twist, bend = (1 + poisson_ratio) * (q_x * c + q_y * s), q_y * c - q_x * s
            rise = [
                self.curvature + moment / stiff, c, s,
                (twist * c - bend * s) / stiff, (twist * s + bend * c) / stiff,
                turn_x * s - turn_y * c,
            ]  # fmt: skip
            return -np.concatenate(rise).reshape(6, n).ravel() * np.tile(arc, 6)

        end = solve_ivp(rates, (0.0, 1.0), np.zeros(6 * n), method="DOP853", rtol=1e-9, atol=1e-14)
        _, x, y, turn_x, turn_y, z = end.y[:, -1].reshape(6, n)
        return -z + turn_x * y - turn_y * x

    # -- the contact given in space -----------------------------------------------------------

    def scale(self, r: Array) -> Array:
        """The force that turns a contact by about a radian, N."""
        inner = self.base_radius - (self.base_radius - self.tip_radius) * r / self.length
        stiff = self.modulus * np.pi / 4 * self.base_radius**3 * np.maximum(inner, 1e-12)
        return 3 * stiff / r**2

    def _most(self, arc: Array) -> Array:
        """Forces beyond which a contact at this arc would only be wound up."""
        inner = 1 - (1 - self.tip_radius / self.base_radius) * arc / self.length
        inner = np.clip(inner, 1e-12, 1.0)
        stiff = self.modulus * np.pi / 4 * self.base_radius**4
        return MOST * 6 * stiff * inner**2 / (arc**2 * (1 + 2 * inner))

    def _tamed(self, arc: Array, force: Array) -> Array:
        most = self._most(arc)
        return np.clip(force, -most, most)

    def slopes(self, arc: Array, force: Array, unit: Array, rtol: float) -> tuple[Array, ...]:
        """Values and derivatives (to arc, to force in units) by differences, of all results."""
        h = 1e-5
        n = arc.size
        inside = np.where(arc * (1 + h) > self.length, -h, h)
        # Away from zero, where friction turns round.
        more = h * np.minimum(unit, self._most(arc)) * np.where(force < 0, -1.0, 1.0)
        all_three = self.take(np.tile(np.arange(n), 3))
        found = all_three.follow(
            np.concatenate([arc, arc * (1 + inside), arc]),
            np.concatenate([force, force, force + more]),
            rtol,
        )
        rows = np.stack(list(found.values())).reshape(6, 3, n)
        here = rows[:, 0]
        return here, (rows[:, 1] - here) / (arc * inside), (rows[:, 2] - here) / more

    def contact_slopes(self, arc: Array, force: Array) -> tuple[Array, Array]:
        """Results (6, n) and their slopes (6, 2, n) to distance and angle: central differences."""
        h, n = 1e-5, arc.size
        scale = np.array([[1 + h, 1, 1 - h, 1, 1], [1, 1 + h, 1, 1 - h, 1]])
        arcs, forces = (scale[0, :, None] * arc).ravel(), (scale[1, :, None] * force).ravel()
        # At the tip itself the whisker is taken to go on: its taper is a line.
        rows = np.stack(list(self.take(np.tile(np.arange(n), 5)).follow(arcs, forces).values()))
        up_arc, up_force, down_arc, down_force, here = np.moveaxis(rows.reshape(6, 5, n), 1, 0)
        by_arc, by_force = (up_arc - down_arc) / (2 * h), (up_force - down_force) / (2 * h)
        det = by_arc[3] * by_force[4] - by_arc[4] * by_force[3]
        to_r = (by_arc * by_force[4] - by_force * by_arc[4]) / det
        to_angle = (by_force * by_arc[3] - by_arc * by_force[3]) / det
        return here, np.stack([to_r, to_angle], axis=1)

    def polish(
        self, r: Array, theta: Array, arc: Array, force: Array, steps: int = 4, rtol: float = 3e-14
    ) -> dict[str, Array]:
        """Newton's method to the contact (r, θ); the last residual is taken off to first order.

        With the determinant of the contact's slopes (its sign is that of stability) and the
        reference's own relative error of the signals.
        """
        unit = self.scale(r)
        arc, force = arc.copy(), self._tamed(arc, force)
        for k in range(steps + 1):
            here, by_arc, by_force = self.slopes(arc, force, unit, rtol)
            miss = np.stack([r - here[3], theta - here[4]])
            det = by_arc[3] * by_force[4] - by_arc[4] * by_force[3]
            with np.errstate(all="ignore"):
                d_arc = (miss[0] * by_force[4] - miss[1] * by_force[3]) / det
                d_force = (miss[1] * by_arc[3] - miss[0] * by_arc[4]) / det
            d_arc, d_force = np.nan_to_num(d_arc), np.nan_to_num(d_force)
            if k < steps:
                arc = np.clip(arc + np.clip(d_arc, -0.1 * r, 0.1 * r), 1e-3 * r, self.length)
                force = self._tamed(arc, force + np.clip(d_force, -0.3 * unit, 0.3 * unit))
        signals = here + by_arc * d_arc + by_force * d_force
        with np.errstate(all="ignore"):
            # What 1e-13 of r and of θ do to the signals.
            to_r = (by_arc * by_force[4] - by_force * by_arc[4]) / det
            to_angle = (by_force * by_arc[3] - by_arc * by_force[3]) / det
        own = 1e-13 * (
            np.abs(to_r[:3]) * r + np.abs(to_angle[:3]) * np.maximum(np.abs(theta), 1e-6)
        )
        left = np.maximum(np.abs(d_arc) / r, np.abs(d_force) / unit)
        values = zip(("moment", "axial_force", "transverse_force"), signals[:3], strict=True)
        return {**dict(values), "arc": arc, "force": force, "own": own, "left": left, "det": det}

    def at_rest(self, r: Array) -> tuple[Array, Array]:
        """Arc and angle at which the resting whisker first is at the distance r; NaN if never."""
        share = np.linspace(0, 1, 2001)[:, None]
        half = self.curvature * self.length * share / 2
        chord = self.length * share * np.sinc(half / np.pi)
        beyond = (chord >= r * (1 - 1e-12)).argmax(axis=0)
        never = chord.max(axis=0) < r * (1 - 1e-12)
        low, high = (share[np.maximum(beyond - k, 0), 0] * self.length for k in (1, 0))
        for _ in range(60):
            middle = (low + high) / 2
            short = middle * np.sinc(self.curvature * middle / 2 / np.pi) < r
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.where(never, np.nan, high), self.curvature * high / 2

    def walk(self, r: Array, theta: Array, step: float = 0.05, most: int = 220) -> dict[str, Array]:
        """Follow each contact at distance r from rest to its angle, or to where its branch ends.

        Pseudo-arclength continuation in contact arc and force. Returns the arc and force reached,
        the last angle, and ``end``: 0 reached, 1 a fold, 2 the tip, 3 never in reach, 4 lost.
        """
        n = r.size
        start, rest = self.at_rest(r)
        end = np.where(np.isnan(start), 3, 4)
        arc, angle = np.where(np.isnan(start), r, start), rest.copy()
        force = np.zeros(n)
        side = np.where(theta < rest, -1.0, 1.0)
        unit = self.scale(r)
        way = np.stack([np.zeros(n), side])
        active = np.flatnonzero((end == 4) & (np.abs(theta - rest) > 0))
        end[(end == 4) & (theta == rest)] = 0
        force_last, arc_last = force.copy(), arc.copy()
        steps, trust = np.full(n, step), np.full(n, np.inf)
        for _ in range(most):
            if not active.size:
                break
            at = active
            some, u, d = self.take(at), unit[at], r[at]
            tiny = 1e-9 * u * side[at]
            push = some._tamed(arc[at], force[at] + tiny)
            here, by_arc, by_force = some.slopes(arc[at], push, u, 1e-9)
            tangent = np.stack([-by_force[3] * u, by_arc[3] * d])
            tangent /= np.hypot(*tangent)
            tangent *= np.where((tangent * way[:, at]).sum(axis=0) < 0, -1.0, 1.0)
            rise = (by_arc[4] * d * tangent[0] + by_force[4] * u * tangent[1]) * side[at]
            way[:, at] = tangent
            # No farther than the angle asked for, and never past a radian.
            want = np.abs(theta[at] - angle[at])
            size = np.minimum(steps[at], np.maximum(1.05 * want / np.maximum(rise, 1e-3), 1e-9))
            size = np.minimum(size, trust[at])
            a, f = arc[at] / d + size * tangent[0], force[at] / u + size * tangent[1]
            p = np.stack([a, f])
            for _ in range(3):
                held = np.minimum(a * d, some.length)
                f = some._tamed(held, f * u) / u
                here, by_arc, by_force = some.slopes(held, f * u, u, 1e-9)
                # Beyond the tip the whisker is taken to end at it: the walk ends there anyway.
                miss = d - here[3] - np.maximum(a * d - some.length, 0) * by_arc[3]
                off = -((a - p[0]) * tangent[0] + (f - p[1]) * tangent[1])
                j_a, j_f = by_arc[3] * d, by_force[3] * u
                det = j_a * tangent[1] - j_f * tangent[0]
                a = a + (miss * tangent[1] - off * j_f) / det
                f = f + (off * j_a - miss * tangent[0]) / det
            strayed = (np.hypot(*(np.stack([a, f]) - p)) > STRAYED * size) & (size > SHORTEST)
            trust[at] = np.where(strayed, size / 3, 1.5 * trust[at])
            tip = (a * d > some.length * (1 + 1e-12)) & ~strayed
            new = here[4]
            reached = ((new - theta[at]) * side[at] >= 0) & ~tip & ~strayed
            fold = ((new - angle[at]) * side[at] <= 0) & ~reached & ~tip & ~strayed
            arc_last[at], force_last[at] = np.minimum(a * d, some.length), f * u
            # An end is come up to in ever smaller steps, which leave 1e-8 of the angle and less.
            again = (fold | tip) & (steps[at] > SHORTEST)
            steps[at[again]] /= 5
            fold, tip = fold & ~again, tip & ~again
            moved = ~(fold | tip | again | strayed)
            arc[at[moved]], force[at[moved]], angle[at[moved]] = (
                (a * d)[moved], (f * u)[moved], new[moved],
            )  # fmt: skip
            for what, which in ((0, reached), (1, fold), (2, tip)):
                end[at[which]] = what
            active = at[~(reached | fold | tip) & np.isfinite(a)]
        return {"arc": arc_last, "force": force_last, "angle": angle, "end": end, "rest": rest}
