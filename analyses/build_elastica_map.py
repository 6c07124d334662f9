"""Compute the dimensionless elastica map and write ``elastica_map.npz``.

    python analyses/build_elastica_map.py [folder]

Writes the file that the package ships, into its folder by default; it takes a few seconds.

With p the contact-to-base coordinate for which z = 1 − u p is the contact's distance from the
apex over that of the running point, the elastica of a linear taper in the contact's frame is

    φ' = −g η z,   η' = (cos φ − u η)/z,   g = 6ℓ/(3 − 2u),   φ(0) = η(0) = 0,

η the scaled lever arm: analytic for 0 ≤ u ≤ 1, hence spectral collocation. Contact angle, height
and shortening follow by quadrature, after one integration by parts that removes the 1/z².
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from command import options
from numpy.polynomial import legendre

import weberwhisk
from weberwhisk.mechanics.elastica import (
    Array,
    ChebyshevTable,
    Curve,
    fit,
    load_cap,
    nodes,
    unfold,
)

COLLOCATION = 60


def solve(u: Array, loads: Array) -> Array:
    """Contact angle, height y/(s(1−u)) and shortening (1−x/s)/(1−u): (m, k, 3).

    `u` (m,); `loads` (m, k), ascending along the second axis: each load starts Newton's method
    for the next, so that the solution stays on the first branch.
    """
    x, w = legendre.leggauss(COLLOCATION)
    p, w = (x + 1) / 2, w / 2
    rise = [legendre.legint(np.eye(n + 1)[n], lbnd=-1) for n in range(COLLOCATION)]
    integrate = np.stack([legendre.legval(x, c) for c in rise], axis=1) / 2
    integrate = integrate @ np.linalg.inv(legendre.legvander(x, COLLOCATION - 1))
    identity = np.eye(COLLOCATION)

    z = 1 - u[:, None] * p
    lever = np.linalg.solve(
        identity * z[:, None, :] + 2 * u[:, None, None] * integrate,
        np.broadcast_to(integrate, (u.size, *integrate.shape)),
    )
    turn = integrate @ (z[:, :, None] * lever)
    phi = np.zeros_like(z)
    out = np.empty((*loads.shape, 3))
    for j in range(loads.shape[1]):
        g = (6 * loads[:, j] / (3 - 2 * u))[:, None]
        for _ in range(60):
            residual = phi + g * np.einsum("mij,mj->mi", turn, np.cos(phi))
            slope = identity - g[:, :, None] * turn * np.sin(phi)[:, None, :]
            step = np.linalg.solve(slope, residual[..., None])[..., 0]
            phi = phi - step
            if np.max(np.abs(step)) < 3e-14 * max(1.0, float(np.max(np.abs(phi)))):
                break
        else:
            raise RuntimeError(f"Newton's method stalled at load {loads[:, j].max():g}")
        bend = g * np.einsum("mij,mj->mi", lever, np.cos(phi))
        angle = (bend * z) @ w
        tangent = angle[:, None] - (bend * z) @ integrate.T
        out[:, j, 0] = angle
        out[:, j, 1] = (p * np.cos(tangent) * bend) @ w
        out[:, j, 2] = (p * np.sin(tangent) * bend) @ w
    return out


def force_table(nu: int, nq: int) -> ChebyshevTable:
    """The face of the map with the force given."""
    u, load = nodes(nu), load_cap(nodes(nu))[:, None] * np.sqrt(nodes(nq))
    angle, height, shortening = np.moveaxis(solve(u, load), 2, 0)
    height_lin = 2 * load / (3 - 2 * u[:, None])
    values = np.stack([angle / load, height / height_lin, shortening / load**2], axis=-1)
    by_u = fit(np.log(values))
    return ChebyshevTable(fit(by_u.transpose(1, 0, 2)).transpose(1, 0, 2))


def place(table: ChebyshevTable, u: Array, w: Array) -> tuple[Array, Array, Array]:
    """v = r/A, θ_d and their Jacobian (2, 2, n) at u and relative load w = ℓ/ℓ_cap."""
    values, d_u, d_q = np.split(table.gradient(u, w**2), 3)
    load, load_u, load_w = load_cap(u) * w, -2.6 * w, load_cap(u)
    height = 2 * load / (3 - 2 * u) * np.exp(values[1])
    height_u = height * (load_u / load + 2 / (3 - 2 * u) + d_u[1])
    height_w = height * (1 / w + 2 * w * d_q[1])
    short = load**2 * np.exp(values[2])
    short_u = short * (2 * load_u / load + d_u[2])
    short_w = short * (2 / w + 2 * w * d_q[2])
    x, x_u, x_w = 1 - (1 - u) * short, short - (1 - u) * short_u, -(1 - u) * short_w
    y, y_u, y_w = (1 - u) * height, (1 - u) * height_u - height, (1 - u) * height_w
    rho = np.hypot(x, y)
    v_u, v_w = rho + u * (x * x_u + y * y_u) / rho, u * (x * x_w + y * y_w) / rho
    theta_u, theta_w = (x * y_u - y * x_u) / rho**2, (x * y_w - y * x_w) / rho**2
    assert load_w.shape == u.shape
    return u * rho, np.arctan2(y, x), np.array([[v_u, v_w], [theta_u, theta_w]])


def fold_curve(table: ChebyshevTable, n: int) -> Curve:
    """Relative load of the fold at fixed r against u: where the Jacobian of (r, θ_d) vanishes."""

    def determinant(w: Array) -> Array:
        (a, b), (c, d) = place(table, u, w)[2]
        return (a * d - b * c) / (1 - u)

    u, h = nodes(n), 1e-6
    w = 0.936 - 0.52 * u  # close enough for Newton's method at every u
    for _ in range(40):
        slope = (determinant(w + h) - determinant(w - h)) / (2 * h)
        step = determinant(w) / slope
        w = w - step
        if np.max(np.abs(step)) < 1e-13:
            return Curve(fit(w[:, None]))
    raise RuntimeError("the fold was not found")


def at_fold(table: ChebyshevTable, fold_load: Curve, v: Array) -> tuple[Array, Array, Array]:
    """u, relative load and θ_d of the fold at r = vA."""
    u = unfold(v)
    for _ in range(60):
        w = fold_load(u)[0]
        v_now, theta, ((v_u, v_w), _) = place(table, u, w)
        step = (v_now - v) / (v_u + v_w * fold_load.derivative(u)[0])
        u = u - step
        if np.max(np.abs(step)) < 1e-15:
            break
    return u, fold_load(u)[0], theta


def contact_table(
    table: ChebyshevTable, fold_load: Curve, nv: int, nc: int
) -> tuple[ChebyshevTable, Curve]:
    """The face of the map with the contact given, and the curve of the fold angle."""
    v = nodes(nv) * (1 + nodes(nv)) / 2
    _, _, fold_angle = at_fold(table, fold_load, v)
    u, w = v * (1 + 1e-6), None
    path: list[tuple[float, Array, Array]] = []
    values = np.empty((nv, nc, 3))
    for k in range(nc - 1, -1, -1):  # from no load (c → 1) down to the fold (c → 0)
        c = nodes(nc)[k]
        theta = fold_angle * np.sqrt(1 - c**2)
        if w is None:
            w = (3 - 2 * v) / (2 * (1 - v)) * theta / load_cap(v)
        elif len(path) > 1:
            (c1, u1, w1), (c2, u2, w2) = path[-2:]
            t = (c - c2) / (c2 - c1)
            u, w = u2 + t * (u2 - u1), w2 + t * (w2 - w1)
        for _ in range(40):
            v_now, theta_now, ((v_u, v_w), (t_u, t_w)) = place(table, u, w)
            dv, dt, det = v_now - v, theta_now - theta, v_u * t_w - v_w * t_u
            step_u, step_w = (dv * t_w - dt * v_w) / det, (v_u * dt - t_u * dv) / det
            u, w = u - step_u, w - step_w
            if max(np.max(np.abs(step_u)), np.max(np.abs(step_w))) < 1e-14 / c:
                break
        path.append((c, u, w))
        load = load_cap(u) * w
        force = 2 * load * ((1 - u) * v / u) ** 2 / ((3 - 2 * u) * theta * (1 - v))
        angle = load * np.exp(table(u, w**2)[0]) * 2 * (1 - v) / (theta * (3 - 2 * v))
        extra = (u - v) * (1 - v) / (v * theta**2)
        values[:, k] = np.log(np.stack([force, angle, extra], axis=-1))
    by_v = fit(values)
    contact = ChebyshevTable(fit(by_v.transpose(1, 0, 2)).transpose(1, 0, 2))
    return contact, Curve(fit((fold_angle / (1 - v))[:, None]))


def moment_peak(contact: ChebyshevTable, fold: Curve, n: int) -> Curve:
    """c at the largest moment on the way to the fold, against x(v)."""
    x = nodes(n)
    v = x * (1 + x) / 2
    fold_angle = (1 - v) * fold(x)[0]

    def slope(c: Array) -> Array:
        """d ln M/dc."""
        theta = fold_angle * np.sqrt(1 - c**2)
        theta_c = -(fold_angle**2) * c / theta
        values, _, d_c = np.split(contact.gradient(x, c), 3)
        alpha = theta * (3 - 2 * v) / (2 * (1 - v)) * np.exp(values[1])
        alpha_c = alpha * (theta_c / theta + d_c[1])
        return d_c[0] + theta_c / theta - np.tan(alpha - theta) * (alpha_c - theta_c)

    low, high = np.full(n, 1e-6), np.full(n, 0.999)
    for _ in range(54):
        middle = (low + high) / 2
        rising = slope(middle) < 0  # the moment still rises as c falls
        low, high = np.where(rising, low, middle), np.where(rising, middle, high)
    return Curve(fit(((low + high) / 2)[:, None]))


def build() -> dict[str, Array]:
    """All coefficients of the map.

    The faces are computed on more nodes than are kept: the coefficients left out are below the
    tables' accuracy, which the tests measure against an independent integrator.
    """
    fine = force_table(64, 40)
    fold_load = fold_curve(fine, 40)
    contact, fold = contact_table(fine, fold_load, 48, 20)
    peak = moment_peak(contact, fold, 48)
    return {
        "force_given": fine.coefficients[:30, :24],
        "contact_given": contact.coefficients[:32, :18],
        "fold_load": fold_load.coefficients[:30],
        "fold": np.hstack([fold.coefficients, peak.coefficients])[:36],
    }


if __name__ == "__main__":
    home = Path(weberwhisk.__file__).parent / "mechanics"
    asked = options(__file__, __doc__, folder=home)
    target = asked.folder / "elastica_map.npz"
    np.savez(target, **build())  # type: ignore[arg-type]
    print(f"wrote {target.name}, {target.stat().st_size} bytes")
