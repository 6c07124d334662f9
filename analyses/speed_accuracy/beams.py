"""Error against time of a bent whisker: models, SciPy's solvers, the paper's interpolation.

The contact is given, as an observer's posterior needs it. The truth is Runge–Kutta in extended
precision, extrapolated. An error of the moment is, at a known angle and under Weber noise, k times
the error of the distance in JNDs, so that one axis serves for both, and for the paper's way (§2f)
too, which goes from signals to distance: a cubic through scattered (M, Fx).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from scipy.integrate import solve_bvp, solve_ivp
from scipy.interpolate import CloughTocher2DInterpolator
from scipy.optimize import root

from weberwhisk import Whisker, flick_past
from weberwhisk.mechanics import closed_form, elastica, profile, rod

T = TypeVar("T")
Row = dict[str, Any]
Array = np.ndarray
WHISKER = Whisker(50e-3, 100e-6, 5e-6, 3e9)


def timed(call: Callable[[], T], *, least: float = 5e-3, repeats: int = 3) -> tuple[T, float]:
    """The result of a call and the CPU seconds that it takes: the least of a few, caches warm.

    A call of more than `least` seconds is made once more and no further.
    """
    result = call()
    times = []
    for _ in range(repeats):
        start, count = time.process_time(), 0
        while count == 0 or time.process_time() - start < least:
            result, count = call(), count + 1
        times.append((time.process_time() - start) / count)
        if times[-1] > least:
            break
    return result, min(times)


@dataclass(frozen=True)
class Scene:
    """A contact: radial distance over the length, and deflection over that of the flick-past."""

    name: str
    distance: float
    share: float

    @property
    def contact(self) -> tuple[float, float]:
        """Radial distance, m, and deflection angle, rad."""
        r = self.distance * WHISKER.length
        return r, self.share * float(flick_past(WHISKER, r).deflection_angle)


SCENES = (
    Scene("easy: 0.4 L, 0.1 of flick-past", 0.4, 0.1),
    Scene("middling: 0.6 L, 0.5 of flick-past", 0.6, 0.5),
    Scene("hard: 0.7 L, 0.999 of flick-past", 0.7, 0.999),
)


def follow(arc: Any, force: Any, steps: int, kind: type = float) -> tuple[Any, Any, Any, Any]:
    """Moment, axial force, distance and deflection of a load at an arc, by Runge–Kutta of order 4.

    From the contact to the base: there the moment vanishes and the force is along the normal.
    """
    w = WHISKER
    length, base, tip = (kind(v) for v in (w.length, w.base_radius, w.tip_radius))
    h = kind(arc) / steps
    modulus = kind(w.youngs_modulus) * np.arctan(kind(1))  # E π/4

    def rates(s: Any, y: Any) -> Any:
        radius = base - (base - tip) / length * s
        return np.stack([-force * y[1] / (modulus * radius**4), np.cos(y[0]), np.sin(y[0])])

    y: Any = np.zeros(3, dtype=kind)
    for i in range(steps):
        s = kind(arc) - i * h
        k1 = rates(s, y)
        k2 = rates(s - h / 2, y + h / 2 * k1)
        k3 = rates(s - h / 2, y + h / 2 * k2)
        k4 = rates(s - h, y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    angle, lever, across = y
    return (
        force * lever,
        force * np.sin(-angle),
        np.hypot(lever, across),
        np.arctan2(across, lever) - angle,
    )


@cache
def truth(scene: Scene) -> float:
    """Moment of the contact: extended precision, extrapolated, solved by Newton's method."""
    start = elastica.press(WHISKER, *scene.contact)
    r, theta = (np.longdouble(v) for v in scene.contact)
    arc, force = np.longdouble(start.arc_length), np.longdouble(start.force)

    def fine(a: Any, f: Any, steps: int) -> Array:
        one, two = (
            np.array(follow(a, f, n, np.longdouble), dtype=np.longdouble)
            for n in (steps, 2 * steps)
        )
        return np.asarray(two + (two - one) / 15)

    da, df = arc * np.longdouble(1e-6), force * np.longdouble(1e-6)
    by_arc, by_force = (  # a secant will do, as the start is good to ten digits
        (fine(arc + u, force + v, 200) - fine(arc - u, force - v, 200))[2:] / 2
        for u, v in ((da, 0), (0, df))
    )
    slopes = np.stack([by_arc / da, by_force / df], axis=1).astype(float)
    for _ in range(2):
        miss = (fine(arc, force, 1000)[2:] - np.array([r, theta])).astype(float)
        move = np.linalg.solve(slopes, miss)
        arc, force = arc - move[0], force - move[1]
    return float(fine(arc, force, 1000)[0])


# -- SciPy ---------------------------------------------------------------------------------------


def initial_value(scene: Scene, rtol: float) -> float:
    """MINPACK over DOP853 from the contact to the base, from the closed form."""
    r, theta = scene.contact
    base = float(WHISKER.stiffness)
    taper = float(WHISKER.taper / WHISKER.length)

    def at(arc: float, force: float) -> tuple[float, float, float]:
        def rates(u: float, y: Array) -> list[float]:
            stiffness = base * (1 - (arc - u) * taper) ** 4
            return [-force * y[1] / stiffness, np.cos(y[0]), np.sin(y[0])]

        tiny = rtol * 1e-3 * np.array([1.0, arc, arc])
        end = solve_ivp(rates, (0, arc), [0.0, 0.0, 0.0], "DOP853", rtol=rtol, atol=tiny)
        angle, x, y = end.y[:, -1]
        return force * x, float(np.hypot(x, y)), float(np.arctan2(y, x) - angle)

    def miss(v: Array) -> list[float]:
        _, distance, deflection = at(v[0] * r, np.exp(v[1]))
        return [distance / r - 1, deflection - theta]

    guess = float(closed_form.press(WHISKER, r, theta).force)
    solved = root(miss, [1.02, np.log(guess)], tol=rtol)
    if not np.max(np.abs(solved.fun)) < max(100 * rtol, 1e-9):
        return float("nan")
    return at(solved.x[0] * r, float(np.exp(solved.x[1])))[0]


def boundary_value(scene: Scene, tolerance: float) -> float:
    """solve_bvp in the base's frame: contact angle, arc and force unknown, from the closed form."""
    r, theta = scene.contact
    x_end, y_end = np.cos(theta), np.sin(theta)
    base, taper = float(WHISKER.stiffness), float(WHISKER.taper / WHISKER.length)
    unit = base / r

    def rates(v: Array, state: Array, p: Array) -> Array:
        angle, moment = state[:2]
        arc, force = p[1] * r, np.exp(p[2])
        along = np.cos(angle), np.sin(angle)
        bend = moment * unit / (base * (1 - v * arc * taper) ** 4)
        turn = -force * (along[0] * np.cos(p[0]) + along[1] * np.sin(p[0])) / unit
        return arc * np.stack([bend, turn, along[0] / r, along[1] / r])

    def ends(a: Array, b: Array, p: Array) -> Array:
        return np.array([a[0], a[2], a[3], b[1], b[0] - p[0], b[2] - x_end, b[3] - y_end])

    v = np.linspace(0, 1, 30)
    force = float(closed_form.press(WHISKER, r, theta).force)
    guess = np.stack([1.5 * theta * v, force * r * (1 - v) / unit, v * x_end, v**2 * y_end])
    p = [1.5 * theta, 1.02, np.log(force)]
    solved = solve_bvp(rates, ends, v, guess, p, tol=tolerance, max_nodes=20_000)
    return float(solved.y[1, 0] * unit) if solved.success else float("nan")


# -- the paper's interpolation ---------------------------------------------------------------------


@cache
def scattered(points: int, logarithmic: bool) -> CloughTocher2DInterpolator:
    """A cubic for r, m, through scattered (M, Fx) of contacts to the fold or to 90° (§2f)."""
    side = int(np.sqrt(points))
    r = np.linspace(0.02, 0.99, side)[:, None] * WHISKER.length
    theta = flick_past(WHISKER, r).deflection_angle * np.linspace(0.01, 1 - 1e-9, side)
    bent = elastica.press(WHISKER, r, theta)
    kept = bent.contact_angle <= np.pi / 2
    signals = np.stack([bent.moment[kept], bent.axial_force[kept]], axis=-1)
    signals = np.log(signals) if logarithmic else signals
    return CloughTocher2DInterpolator(signals, bent.radial_distance[kept], rescale=True)


def interpolated(scene: Scene, points: int, logarithmic: bool, count: int) -> Array:
    """The moment that differs from the true one as the distance found does; of many alike."""
    r, theta = scene.contact
    bent = elastica.press(WHISKER, r, theta)
    signals = np.array([[bent.moment, bent.axial_force]])
    signals = np.log(signals) if logarithmic else signals
    found = scattered(points, logarithmic)(np.repeat(signals, count, axis=0))
    slope = elastica.signal_jacobian(WHISKER, r, theta)[0, 0]
    return np.asarray(truth(scene) + slope * (found - r))


# -- the table -----------------------------------------------------------------------------------


def _calls(scene: Scene, full: bool) -> Iterator[tuple[str, float, int, Callable[[], Any]]]:
    """Method, knob, contacts in a call, and the call, which returns moments."""
    r, theta = scene.contact
    for name, model in (("closed form", closed_form), ("elastica", elastica)):
        for count in (1, 10, 100, 1000, 10_000) if full else (1, 100, 10_000):
            yield name, count, count, partial(_moment, model, np.full(count, r), theta)
    few = (1e-3, 1e-6, 1e-9, 1e-12) if full else (1e-3, 1e-9)
    point = r * np.array([np.cos(theta), np.sin(theta), 0.0])
    for tolerance in few:
        for name, many in (("300 at once", 300), ("one", 1)):
            call = partial(_moment, profile, np.full(many, r), theta, tolerance=tolerance)
            yield f"planar beam, {name}", tolerance, many, call
        yield "rod, one", tolerance, 1, partial(_rod_moment, point, tolerance)
    for tolerance in (1e-3, 1e-5, 1e-7, 1e-9, 1e-11) if full else (1e-3, 1e-9):
        for name, solver in (
            ("SciPy, root over DOP853", initial_value), ("SciPy, solve_bvp", boundary_value)
        ):  # fmt: skip
            yield name, tolerance, 1, partial(solver, scene, tolerance)
    for points in (100, 1000, 10_000) if full else (100, 1000):
        for name, logarithmic in (("linear", False), ("logarithmic", True)):
            call = partial(interpolated, scene, points, logarithmic, 1000)
            yield f"cubic through (M, Fx), {name}", points, 1000, call


def _moment(model: Any, r: Array, theta: float, **options: float) -> Any:
    return model.press(WHISKER, r, theta, **options).moment


def _rod_moment(point: Array, tolerance: float) -> Any:
    return rod.press(WHISKER, point, tolerance=tolerance).moment[..., 2]


def beam_row(
    scene: Scene, method: str, knob: float, moment: Any, seconds: float, count: int = 1
) -> Row:
    """A row of the table, from the moment that a method found."""
    found = float(np.ravel(moment)[-1])
    error = abs(found / truth(scene) - 1)
    return {
        "part": "beams",
        "scene": scene.name,
        "method": method,
        "knob": knob,
        "count": count,
        "seconds": seconds / count,
        "error": error,
        "failed": float(not np.isfinite(found)),
    }


def measure(*, full: bool = False) -> pd.DataFrame:
    """Relative error of the moment, and CPU seconds a contact, of every model and of SciPy."""
    rows = []
    for scene in SCENES:
        truth(scene)
        for method, knob, count, call in _calls(scene, full):
            moment, seconds = timed(call)
            rows.append(beam_row(scene, method, knob, moment, seconds, count))
    return pd.DataFrame(rows)
