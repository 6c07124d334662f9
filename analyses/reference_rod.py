"""Whiskers pressed in space, by SciPy's DOP853 alone, in raw SI units: referee of `stability`.

From the base outwards, as no rung goes: place x and a quaternion for the frame (t, d₁, d₂) along
the arc, with the moment of the contact force n about there, m = (point − x) × n, and

    Ω = (1 + ν)(m·t)/EI t + (m·d₁/EI + κ₁) d₁ + (m·d₂/EI + κ₂) d₂,  x′ = t.

Unknown are n (3) and the contact arc; at it x is the point (3), and n·t = −|n| sin ψ. Many
whiskers are one system of equations; steps are even in the logarithm of the local radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from reference_beam import Beams
from scipy.integrate import solve_ivp

Array = np.ndarray
POISSON_RATIO = 0.38
#: Most whiskers in one system, whose steps are common, and most evaluations of one.
TOGETHER, PATIENCE = 64, 4_000
#: Relative tolerance of a walk; nudge of difference quotients.
COARSE, NUDGE = 1e-8, 1e-5
#: Steps, in units of r, of the force that turns a contact by a radian and of radians: the first,
#: the longest, and one short enough for an end of the branch to be called one.
FIRST, LONGEST, SHORTEST = 1e-3, 0.25, 1e-4
#: Share of a step that its correction may be, lest it lead to another branch.
STRAYED = 0.15
REACHED, FOLD, TIP, NEVER, LOST = range(5)


def _solve(matrix: Array, right: Array) -> Array:
    """Solutions (k, n) of n systems (k, k, n); not a number where there is none."""
    matrix = np.moveaxis(matrix, -1, 0).copy()
    with np.errstate(all="ignore"):
        bad = ~np.isfinite(matrix).all(axis=(1, 2)) | (np.linalg.det(matrix) == 0)
        matrix[bad] = np.eye(matrix.shape[1])
        found = np.linalg.solve(matrix, right.T[..., None])[..., 0].T
    return np.where(bad, np.nan, found)


@dataclass(frozen=True)
class Rods:
    """n whiskers, each with the great circle that its point is moved on: arrays (n,), (3, n).

    The point is at ``distance`` from the base, from ``rest``, where the whisker lies, towards
    ``across``, both unit vectors in the base frame; ``roll`` is that of the plane of curvature.
    """

    beams: Beams
    distance: Array
    roll: Array
    start: Array
    rest: Array
    across: Array

    @classmethod
    def pushed(cls, beams: Beams, distance: Array, roll: Array, bearing: Array) -> Rods:
        """Pushed from rest by `bearing` off the plane of curvature."""
        start, angle = beams.at_rest(distance)
        zero = 0 * angle
        rest = np.stack([np.cos(angle), np.sin(angle), zero])
        aside = np.stack([-np.sin(angle), np.cos(angle), zero]) * np.cos(bearing)
        aside[2] = np.sin(bearing)
        c, s = np.cos(roll), np.sin(roll)
        rest, aside = (np.stack([v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]])
                       for v in (rest, aside))  # fmt: skip
        return cls(beams, distance, roll, start, rest, aside)

    def take(self, which: Array) -> Rods:
        """Some of them."""
        some = {k: v[..., which] for k, v in vars(self).items() if k != "beams"}
        return replace(self, beams=self.beams.take(which), **some)

    @property
    def unit(self) -> Array:
        """The force that turns a contact by about a radian, N."""
        return self.beams.scale(self.distance)

    def point(self, angle: Array) -> Array:
        """The point pushed by an angle along its circle, m."""
        return self.distance * (self.rest * np.cos(angle) + self.across * np.sin(angle))

    def follow(self, point: Array, force: Array, arc: Array, rtol: float) -> tuple[Array, ...]:
        """Place and tangent at the arc, and the tangent's slope there, (3, n)."""
        found = self._follow(point, force, arc, rtol)
        if arc.size == 1 or np.isfinite(found[0]).any():
            return found
        # One that winds up for ever ends the integration for all: it is sought by halves.
        halves = np.array_split(np.arange(arc.size), 2)
        parts = [self.take(h).follow(point[:, h], force[:, h], arc[h], rtol) for h in halves]
        return tuple(np.concatenate(pair, axis=1) for pair in zip(*parts, strict=True))

    def _follow(self, point: Array, force: Array, arc: Array, rtol: float) -> tuple[Array, ...]:
        n, b = arc.size, self.beams
        slope = (b.base_radius - b.tip_radius) / b.length
        lost = np.minimum(slope * arc / b.base_radius, 1 - 1e-12)
        growth = -np.log1p(-lost)
        stiff = b.modulus * np.pi / 4
        bow_1, bow_2 = -b.curvature * np.sin(self.roll), b.curvature * np.cos(self.roll)
        left = iter(range(PATIENCE))
        f_x, f_y, f_z = force
        p_x, p_y, p_z = point
        thin = lost > 1e-9
        per = np.where(thin, growth / np.where(thin, slope, 1.0), 0.0)

        def turning(radius: Array, state: Array) -> tuple[Array, ...]:
            w, i, j, k, x, y, z = state
            a, b, c = p_x - x, p_y - y, p_z - z
            m_x, m_y, m_z = b * f_z - c * f_y, c * f_x - a * f_z, a * f_y - b * f_x
            ww, ii, jj, kk = w * w, i * i, j * j, k * k
            t = (ww + ii - jj - kk, 2 * (i * j + w * k), 2 * (i * k - w * j))
            d_1 = (2 * (i * j - w * k), ww - ii + jj - kk, 2 * (j * k + w * i))
            d_2 = (2 * (i * k + w * j), 2 * (j * k - w * i), ww - ii - jj + kk)
            size = ww + ii + jj + kk
            give = 1 / (stiff * radius**4 * size)
            twist = (1 + POISSON_RATIO) * give * (m_x * t[0] + m_y * t[1] + m_z * t[2])
            u_1 = give * (m_x * d_1[0] + m_y * d_1[1] + m_z * d_1[2]) + bow_1
            u_2 = give * (m_x * d_2[0] + m_y * d_2[1] + m_z * d_2[2]) + bow_2
            return t, d_1, d_2, size, twist, u_1, u_2

        def rates(tau: float, flat: Array) -> Array:
            if next(left, None) is None:
                return np.full(7 * n, np.nan)  # which ends the integration
            state = flat.reshape(7, n)
            w, i, j, k = state[:4]
            radius = b.base_radius * np.exp(-growth * tau)
            t, _, _, size, u, v, s = turning(radius, state)
            pace = np.where(thin, radius * per, arc)
            half, along = pace / 2, pace / size
            return np.concatenate([
                -half * (i * u + j * v + k * s), half * (w * u + j * s - k * v),
                half * (w * v + k * u - i * s), half * (w * s + i * v - j * u),
                along * t[0], along * t[1], along * t[2],
            ])  # fmt: skip

        state = np.concatenate([np.ones(n), np.zeros(6 * n)])
        tiny = np.concatenate([np.full(4 * n, 1e-2 * rtol), np.tile(1e-2 * rtol * arc, 3)])
        run = solve_ivp(rates, (0.0, 1.0), state, method="DOP853", rtol=rtol, atol=tiny)
        end = run.y[:, -1].reshape(7, n) if run.success else np.full((7, n), np.nan)
        t, d_1, d_2, size, _, u_1, u_2 = turning(b.base_radius * (1 - lost), end)
        t, d_1, d_2 = (np.stack(v) / size for v in (t, d_1, d_2))
        return end[4:], t, u_2 * d_1 - u_1 * d_2

    def equations(self, force: Array, arc: Array, angle: Array, rtol: float) -> tuple[Array, Array]:
        """What is left (4, n), and its slopes (4, 5, n) to force, arc and angle, in their units."""
        parts = [(np.empty((4, 0)), np.empty((4, 5, 0)))]
        for start in range(0, arc.size, TOGETHER):
            part = np.arange(start, min(start + TOGETHER, arc.size))
            some = self.take(part)
            parts.append(some._equations(force[:, part], arc[part], angle[part], rtol))
        return tuple(np.concatenate(found, axis=-1) for found in zip(*parts, strict=True))

    def _equations(
        self, force: Array, arc: Array, angle: Array, rtol: float
    ) -> tuple[Array, Array]:
        n, r, unit = arc.size, self.distance, self.unit
        arc, angle = np.maximum(np.nan_to_num(arc), 1e-3 * r), np.nan_to_num(angle)
        size = np.sqrt((force**2).sum(axis=0))
        force = np.nan_to_num(force * np.minimum(1, self.beams._most(arc) / (size + 1e-300)))
        forces = np.tile(force[:, None], (1, 5, 1))
        forces[range(3), range(1, 4)] += NUDGE * unit
        angles = np.stack([angle, angle, angle, angle, angle + NUDGE])
        five = self.take(np.tile(np.arange(n), 5))
        points = five.point(angles.ravel())
        place, tangent, bow = five.follow(points, forces.reshape(3, -1), np.tile(arc, 5), rtol)
        off = ((place - points) / five.distance).reshape(3, 5, n)
        tangent, bow = tangent.reshape(3, 5, n), bow.reshape(3, 5, n)[:, 0]
        sine, size = np.sin(self.beams.friction), np.sqrt((force**2).sum(axis=0))
        lean = (forces * tangent).sum(axis=0) / unit + sine * np.sqrt((forces**2).sum(0)) / unit
        left = np.concatenate([off[:, 0], lean[:1]])
        slopes = np.empty((4, 5, n))
        for column, at in ((0, 1), (1, 2), (2, 3), (4, 4)):
            slopes[:3, column] = (off[:, at] - off[:, 0]) / NUDGE
            # The friction's size has a cusp at no force: by hand.
            turned = (force * (tangent[:, at] - tangent[:, 0])).sum(axis=0) / unit
            slopes[3, column] = turned / NUDGE
        slopes[3, :3] += tangent[:, 0] + sine * force / np.maximum(size, 1e-300)
        slopes[:3, 3], slopes[3, 3] = tangent[:, 0], (force * bow).sum(axis=0) * r / unit
        return left, slopes

    def first(self, angle: Array) -> tuple[Array, Array, Array]:
        """Force and arc at a small angle, linearised about rest; the sign of stability there."""
        n = angle.size
        _, slopes = self.equations(np.zeros((3, n)), self.start, 0 * angle, 1e-10)
        t = slopes[:3, 3]
        give, aim = slopes[:3, :3], -slopes[:3, 4] * angle
        # n = along·t + across it, with along = −tan ψ |across|: its size solves a quadratic.
        frictionless = np.concatenate([np.concatenate([give, t[:, None]], axis=1),
                                       np.concatenate([t, 0 * t[:1]])[None]])  # fmt: skip
        nothing = np.zeros((1, n))
        pure = _solve(frictionless, np.concatenate([aim, nothing]))
        leaning = _solve(frictionless, np.concatenate([(give * t).sum(axis=1), nothing])) * np.tan(
            self.beams.friction
        )
        a = 1 - (leaning[:3] ** 2).sum(axis=0)
        b, c = (pure[:3] * leaning[:3]).sum(axis=0), (pure[:3] ** 2).sum(axis=0)
        size = (b + np.sqrt(np.maximum(b * b + a * c, 0))) / a
        found = pure + size * leaning
        force = found[:3] - size * np.tan(self.beams.friction) * t
        sign = np.sign(np.linalg.det(np.moveaxis(frictionless, -1, 0)))
        force[:, a <= 0] = np.nan
        return force * self.unit, self.start + found[3] * self.distance, sign

    def polish(
        self, angle: Array, force: Array, arc: Array, steps: int = 6, rtol: float = 3e-14
    ) -> dict[str, Array]:
        """Newton's method to the contact at an angle; the last residual is taken off as well.

        With the determinant (its sign is that of stability), and the reference's own error of the
        force, N, by what a looser tolerance makes of it.
        """
        r, unit = self.distance, self.unit
        force, arc = force.copy(), arc.copy()
        for k in range(steps + 1):
            left, slopes = self.equations(force, arc, angle, rtol)
            move = np.nan_to_num(_solve(slopes[:, :4], -left))
            if k < steps:
                force = force + np.clip(move[:3], -0.3, 0.3) * unit
                arc = np.clip(arc + np.clip(move[3], -0.1, 0.1) * r, 1e-3 * r, self.beams.length)
        loose, _ = self.equations(force, arc, angle, 30 * rtol)
        drift = np.nan_to_num(_solve(slopes[:, :4], left - loose), nan=np.inf)
        inverse = [_solve(slopes[:, :4], np.eye(4)[:, [k]] + 0 * left) for k in range(4)]
        own = 1e-13 * np.abs(np.stack(inverse)).sum(axis=0) + 0.1 * np.abs(drift)
        det = np.linalg.det(np.moveaxis(np.nan_to_num(slopes[:, :4]), -1, 0))
        lost = ~np.isfinite(left).all(axis=0)
        return {
            "force": np.where(lost, np.nan, force + move[:3] * unit),
            "arc": arc + move[3] * r,
            "left": np.where(lost, np.inf, np.abs(move).max(axis=0)),
            "own": np.sqrt((own[:3] ** 2).sum(axis=0)) * unit,
            "det": det,
        }

    def walk(self, angle: Array, most: int = 250) -> dict[str, Array]:
        """Follow each contact from rest to its angle, or to where its branch ends.

        Pseudo-arclength continuation in force, arc and angle. Returns the last angle, how it ended,
        the determinant's sign at rest, and the trail: at each step force, arc, angle, in their
        units, and the least determinant met so far over that at rest, (steps, 6, n).
        """
        n, length = angle.size, self.beams.length
        end = np.where(np.isnan(self.start), NEVER, LOST)
        u = np.zeros((5, n))
        u[3] = np.nan_to_num(self.start / self.distance, nan=1.0)
        way, jump = np.zeros((5, n)), np.full(n, FIRST)
        sign, least, rest_det = np.ones(n), np.ones(n), np.ones(n)
        active = np.flatnonzero(end == LOST)
        if active.size:
            some = self.take(active)
            small = np.minimum(1e-3, angle[active])
            force, arc, sign[active] = some.first(small)
            to = np.stack([*(force / some.unit), arc / some.distance, small]) - u[:, active]
            size = np.sqrt((to**2).sum(axis=0))
            way[:, active], jump[active] = to / size, size
            active = active[np.isfinite(size)]
        began = np.zeros(n, dtype=bool)
        trail = [np.concatenate([u, least[None]])]
        for _ in range(most):
            if not active.size:
                break
            some, goal = self.take(active), angle[active]
            here, tau = u[:, active], way[:, active]
            want = np.maximum(goal - here[4], 0)
            h = np.minimum(jump[active], np.maximum(1.05 * want / np.maximum(tau[4], 1e-3), 1e-9))
            guess = here + h * tau
            v = guess.copy()
            tip = length[active] / some.distance
            for _ in range(3):
                arc = np.minimum(v[3], tip)
                left, slopes = some.equations(v[:3] * some.unit, arc * some.distance, v[4], COARSE)
                left = left + slopes[:, 3] * (v[3] - arc)  # beyond the tip in a straight line
                full = np.concatenate([slopes, tau[None]])
                on = ((v - guess) * tau).sum(axis=0)
                move = _solve(full, -np.concatenate([left, on[None]]))
                v = v + move
            det = np.linalg.det(np.moveaxis(np.nan_to_num(slopes[:, :4]), -1, 0)) * sign[active]
            next_way = _solve(full, np.eye(5)[:, [4]] + 0 * v)
            next_way = next_way / np.sqrt((next_way**2).sum(axis=0))
            correction = np.sqrt(((v - guess) ** 2).sum(axis=0))
            astray = ~(correction < STRAYED * h) | ~(np.abs(move).max(axis=0) < 1e-3 * h + 1e-7)
            astray &= ~(began[active] & (correction < 1e-7))
            astray |= ~np.isfinite(next_way).all(axis=0)
            short = h <= SHORTEST * np.where(began[active], 1.0, 1e-4)
            past_tip = (v[3] > tip * (1 + 1e-12)) & ~astray
            turned = ((det <= 0) | (v[4] <= here[4])) & ~past_tip & ~astray
            again = (past_tip | turned) & ~short
            past_tip, turned = past_tip & ~again, turned & ~again
            moved = ~(astray | again | past_tip | turned)
            there = moved & (v[4] >= goal)
            bent = (next_way * tau).sum(axis=0)
            again |= moved & (bent < 0.9) & ~short & ~there
            moved &= ~again
            at = active[moved]
            u[:, at], way[:, at] = v[:, moved], next_way[:, moved]
            fresh = at[~began[at]]
            rest_det[fresh] = det[moved][~began[at]]
            began[at] = True
            least[at] = np.minimum(least[at], det[moved] / rest_det[at])
            trail.append(np.concatenate([u, least[None]]))
            grow = np.where((correction < 0.02 * h) & (bent > 0.98), 2.0, 1.2)
            jump[at] = np.minimum(np.maximum(h, jump[active])[moved] * grow[moved], LONGEST)
            jump[active[again]] = h[again] / 5
            jump[active[astray]] = h[astray] / 3
            done = [(there & moved, REACHED), (turned, FOLD), (past_tip, TIP)]
            stop = astray & (h < 1e-7)
            for which, what in done:
                end[active[which]] = what
                stop |= which
            active = active[~stop]
        return {"angle": u[4], "end": end, "sign": sign, "trail": np.stack(trail)}

    def at(self, trail: Array, angle: Array) -> tuple[Array, Array, Array]:
        """Force, arc and the least determinant where a walk came by an angle; its last beyond."""
        after = np.minimum((trail[:, 4] <= angle).sum(axis=0), len(trail) - 1)
        before, every = np.maximum(after - 1, 0), np.arange(angle.size)
        one, other = trail[before, :, every].T, trail[after, :, every].T
        share = np.clip(
            (angle - one[4]) / np.where(other[4] > one[4], other[4] - one[4], np.inf), 0, 1
        )
        u = one + share * (other - one)
        return u[:3] * self.unit, np.minimum(u[3] * self.distance, self.beams.length), other[5]
