"""Referees for the mechanics that share no code with the package."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp


def follow(length, base_radius, tip_radius, modulus, arc_length, force):
    """A straight taper followed from the contact to the base by DOP853, in SI units.

    The contact is the origin, the force the unit of M = F·X; nothing is made dimensionless and no
    apex distance is used. Returns moment, Fx, Fy, r, θ_d, α.
    """
    slope = (base_radius - tip_radius) / length

    def rates(s, y):  # s runs from the base; integrate downwards from the contact
        angle, lever, _ = y
        radius = base_radius - slope * s
        bend = force * lever / (modulus * np.pi / 4 * radius**4)
        return [bend, -np.cos(angle), -np.sin(angle)]

    # Near a sharp tip the curvature changes over the local distance to the apex: let the steps be
    # even in its logarithm.
    if slope * arc_length > 0.05 * base_radius:
        apex = base_radius / slope

        def in_log(q, y):
            return [-np.exp(q) * v for v in rates(apex - np.exp(q), y)]

        span, fun = (np.log(apex - arc_length), np.log(apex)), in_log
    else:
        span, fun = (arc_length, 0.0), rates
    # Near the contact angle and lever are small: absolute tolerances far below both.
    tiny = [1e-18, 1e-18 * length, 1e-18 * length]
    end = solve_ivp(fun, span, [0.0, 0.0, 0.0], method="DOP853", rtol=3e-14, atol=tiny).y[:, -1]
    alpha, x, y = -end[0], end[1], end[2]
    # Turn the frame of the contact into that of the base.
    along = x * np.cos(alpha) - y * np.sin(alpha)
    across = x * np.sin(alpha) + y * np.cos(alpha)
    return (
        force * x,
        force * np.sin(alpha),
        force * np.cos(alpha),
        np.hypot(x, y),
        np.arctan2(across, along),
        alpha,
    )
