"""Every model of bending against every referee: errors and CPU times, in one table.

    python analyses/referees.py [folder] [--short]

Writes referees.csv (a row for each scene, what is given, and method: relative errors of the moment,
axial force and radial distance, error of the deflection angle in rad, CPU seconds for one solution)
and referees.md (the largest error of M and the time of every method). The truth of each scene is
the beam's equations by mpmath's Taylor series at 20 digits, started from the contact; for the
uniform beam it is held to the exact elliptic integrals, and for a dead load to those of Bisshopp
and Drucker (1945), which are methods of the table as well.

PyElastica and mpmath come with ``pip install weberwhisk[referees]``. PyElastica simulates dynamics;
here it is given what makes it a good static solver: mass, rotary inertia and shear stiffness in
proportion to the bending stiffness, and damping near critical, until nothing moves. ``--short``
leaves it out.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
import pandas as pd
from command import options
from numpy.typing import NDArray
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.optimize import root
from scipy.special import ellipeinc, ellipkinc

import weberwhisk as ww
from weberwhisk.mechanics import closed_form, elastica, profile, rod

Array = NDArray[np.float64]

NOT_INSTALLED = "not installed: pip install weberwhisk[referees]"
WHISKER = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6, youngs_modulus=3e9)


@dataclass(frozen=True)
class Scene:
    """A whisker loaded at an arc length (m) by a force (N), tilted by friction (rad)."""

    name: str
    whisker: ww.Whisker
    arc: float
    force: float
    friction: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether the straight models without friction can take it."""
        return self.friction == 0 and self.whisker.curvature == 0


@dataclass(frozen=True)
class Found:
    """What every method returns: N m, N, m, rad."""

    moment: float
    axial_force: float
    radial_distance: float
    deflection_angle: float


Method = Callable[[Scene], Found]


def scenes() -> list[Scene]:
    """Easy, middling and hard ones of a tapered whisker, a uniform one, a curved one."""
    uniform, curved = WHISKER.cylinder(), ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=-8.0)
    near = ww.press(WHISKER, 35e-3, 0.999 * ww.flick_past(WHISKER, 35e-3).deflection_angle)
    # Uniform, α = 90°: F a²/EI = ϖ²/2 with the lemniscate constant ϖ.
    lemniscate = 2.622057554292119
    dead, slope = bisshopp_drucker_load(5.0)
    arc = 45e-3
    scale = float(uniform.stiffness) / arc**2
    return [
        Scene("easy: s = 0.4 L, α = 10°", WHISKER, 20e-3, 1.06e-4),
        Scene("middling: s = 0.6 L, α = 45°", WHISKER, 30e-3, 1.2716e-4),
        Scene("P70: s = 0.7 L, α = 60°", WHISKER, 35e-3, 8.755567343e-5),
        Scene("hard: r = 0.7 L, 0.999 of the fold", WHISKER, near.arc_length, near.force),
        Scene("uniform, α = 90°", uniform, arc, scale * lemniscate**2 / 2),
        Scene("curved, friction", curved, 30e-3, 6e-5, -0.2),
        Scene("uniform, dead load Ps²/EI = 5", uniform, arc, scale * dead, -slope),
    ]


def bisshopp_drucker_load(load: float) -> tuple[float, float]:
    """The load and the tip slope under it, by bisection in the elliptic modulus."""

    def excess(slope: float) -> float:
        square, corner = (1 + np.sin(slope)) / 2, np.arcsin(1 / np.sqrt(1 + np.sin(slope)))
        return float((ellipkinc(np.pi / 2, square) - ellipkinc(corner, square)) ** 2 - load)

    low, high = 0.0, 1.57
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return load, low


# -- the truth -----------------------------------------------------------------------------------


@cache
def truth(scene: Scene) -> Found:
    """From the contact to the base by Taylor series of high order, 20 digits."""
    w = scene.whisker
    with mp.workdps(20):
        length, base, tip, modulus, kappa, psi, arc, force = (
            mp.mpf(float(v))
            for v in (
                w.length, w.base_radius, w.tip_radius, w.youngs_modulus, w.curvature,
                scene.friction, scene.arc, scene.force,
            )
        )  # fmt: skip

        def rates(v: Any, state: list[Any]) -> list[Any]:
            angle, x, y = state  # of the point at v·s before the contact, in units of s
            lever = arc * (x * mp.cos(psi) + y * mp.sin(psi))
            radius = base - (base - tip) / length * arc * (1 - v)
            bend = kappa + force * lever / (modulus * mp.pi / 4 * radius**4)
            return [-arc * bend, mp.cos(angle), mp.sin(angle)]

        angle, x, y = mp.odefun(rates, 0, [mp.mpf(0)] * 3)(1)
        moment = force * arc * (x * mp.cos(psi) + y * mp.sin(psi))
        toward = mp.atan2(y, x) - angle
        return Found(
            float(moment),
            float(force * mp.sin(psi - angle)),
            float(arc * mp.sqrt(x * x + y * y)),
            float(toward),
        )


# -- the package ---------------------------------------------------------------------------------


def _bending(b: Any) -> Found:
    if not np.isfinite(b.moment):
        return Found(*[np.nan] * 4)
    return Found(b.moment, b.axial_force, b.radial_distance, b.deflection_angle)


def _rod(b: Any) -> Found:
    angle = np.arctan2(b.contact[1], b.contact[0])
    return Found(b.moment[2], b.axial_force, float(b.radial_distance), angle)


def _planar_beam(scene: Scene) -> Found:
    return _bending(profile.bend(scene.whisker, scene.arc, scene.force, scene.friction))


def _rod_bend(scene: Scene) -> Found:
    return _rod(rod.bend(scene.whisker, scene.arc, scene.force, 0.0, scene.friction))


def _planar_beam_press(scene: Scene) -> Found:
    t = truth(scene)
    return _bending(
        profile.press(scene.whisker, t.radial_distance, t.deflection_angle, scene.friction)
    )


def _rod_press(scene: Scene) -> Found:
    t = truth(scene)
    at = t.radial_distance * np.array([np.cos(t.deflection_angle), np.sin(t.deflection_angle), 0])
    return _rod(rod.press(scene.whisker, at, scene.friction))


def _straight(model: Any, scene: Scene) -> Found:
    return _bending(model.bend(scene.whisker, scene.arc, scene.force))


def _straight_press(model: Any, scene: Scene) -> Found:
    t = truth(scene)
    return _bending(model.press(scene.whisker, t.radial_distance, t.deflection_angle))


# -- SciPy ---------------------------------------------------------------------------------------


def _stiffness(whisker: ww.Whisker, s: Any) -> Any:
    return whisker.stiffness * (1 - s * whisker.taper / whisker.length) ** 4


def initial_value(rtol: float, scene: Scene) -> Found:
    """DOP853 from the contact to the base."""
    w, psi, force = scene.whisker, scene.friction, scene.force
    c, q = np.cos(psi), np.sin(psi)

    def rates(u: float, state: Array) -> list[float]:
        angle, x, y = state
        bend = w.curvature + force * (x * c + y * q) / _stiffness(w, scene.arc - u)
        return [-bend, np.cos(angle), np.sin(angle)]

    tiny = rtol * 1e-3 * np.array([1.0, scene.arc, scene.arc])
    end = solve_ivp(rates, (0, scene.arc), [0.0, 0.0, 0.0], "DOP853", rtol=rtol, atol=tiny).y[:, -1]
    angle, x, y = end
    return Found(
        force * (x * c + y * q),
        force * np.sin(psi - angle),
        float(np.hypot(x, y)),
        float(np.arctan2(y, x) - angle),
    )


def rooted(scene: Scene) -> Found:
    """Contact given: MINPACK's hybrid method over DOP853, from the closed form."""
    t = truth(scene)

    def at(v: Array) -> Found:
        arc, force = v[0] * t.radial_distance, np.exp(v[1])
        return initial_value(
            1e-10, Scene("", scene.whisker, float(arc), float(force), scene.friction)
        )

    def miss(v: Array) -> list[float]:
        found = at(v)
        return [
            found.radial_distance / t.radial_distance - 1,
            found.deflection_angle - t.deflection_angle,
        ]

    solved = root(miss, [1.02, np.log(_guess(scene))], tol=1e-13)
    return at(solved.x) if np.max(np.abs(solved.fun)) < 1e-9 else Found(*[np.nan] * 4)


def _guess(scene: Scene) -> float:
    """A force to start from, by the closed form of the straight whisker."""
    t, w = truth(scene), scene.whisker
    angle = t.deflection_angle - 0.5 * w.curvature * t.radial_distance
    straight = ww.Whisker(w.length, w.base_radius, w.tip_radius, w.youngs_modulus)
    return float(closed_form.press(straight, t.radial_distance, max(angle, 0.01)).force)


def boundary_value(tolerance: float, contact_given: bool, scene: Scene) -> Found:
    """solve_bvp in the base frame: the contact's angle unknown, and for a contact given arc and
    force too."""
    w, psi, t = scene.whisker, scene.friction, truth(scene)
    r, theta, start = t.radial_distance, t.deflection_angle, scene.force
    x_end, y_end = r * np.cos(theta), r * np.sin(theta)
    unit = float(w.stiffness) / r
    if contact_given:
        start = _guess(scene)

    def loads(p: Array) -> tuple[float, float, float]:
        arc, force = (p[1] * r, np.exp(p[2])) if contact_given else (scene.arc, scene.force)
        lean = p[0] + psi
        return arc, -force * np.sin(lean), force * np.cos(lean)

    def rates(v: Array, state: Array, p: Array) -> Array:
        angle, moment = state[:2]
        arc, fx, fy = loads(p)
        along = np.cos(angle), np.sin(angle)
        bend = w.curvature + moment * unit / _stiffness(w, v * arc)
        turn = -(along[0] * fy - along[1] * fx) / unit
        return arc * np.stack([bend, turn, along[0] / r, along[1] / r])

    def ends(a: Array, b: Array, p: Array) -> Array:
        conditions = [a[0], a[2], a[3], b[1], b[0] - p[0]]
        if contact_given:
            conditions += [b[2] - x_end / r, b[3] - y_end / r]
        return np.array(conditions)

    v = np.linspace(0, 1, 30)
    alpha = 1.5 * theta
    arc = scene.arc if not contact_given else r
    guess = np.stack([alpha * v, start * arc * (1 - v) / unit, v * x_end / r, v**2 * y_end / r])
    p = [alpha, 1.02, np.log(start)] if contact_given else [alpha]
    solved = solve_bvp(rates, ends, v, guess, p, tol=tolerance, max_nodes=20000)
    if not solved.success:
        return Found(*[np.nan] * 4)
    _, fx, _ = loads(solved.p)
    x, y = solved.y[2:, -1] * r
    return Found(solved.y[1, 0] * unit, -float(fx), float(np.hypot(x, y)), float(np.arctan2(y, x)))


# -- exact results -------------------------------------------------------------------------------


def uniform_exact(scene: Scene) -> Found:
    """The uniform beam at α = 90°: J = ∫ du/√sin u and S = ∫ √sin u du, u = v² to tame the root."""
    top = np.sqrt(np.pi / 2)
    j = quad(lambda v: 2 * v / np.sqrt(np.sin(v * v)) if v else 2.0, 0, top, epsabs=0)[0]
    s = quad(lambda v: 2 * v * np.sqrt(np.sin(v * v)), 0, top, epsabs=0)[0]
    arc, stiffness = scene.arc, float(scene.whisker.stiffness)
    x, y = arc * s / j, arc * 2 / j
    force = j**2 / 2 * stiffness / arc**2
    return Found(j * stiffness / arc, force, float(np.hypot(x, y)), float(np.arctan2(y, x)))


def bisshopp_drucker(scene: Scene) -> Found:
    """The dead transverse load, by elliptic integrals."""
    w = scene.whisker
    load, slope = bisshopp_drucker_load(scene.force * scene.arc**2 / float(w.stiffness))
    square, corner = (1 + np.sin(slope)) / 2, np.arcsin(1 / np.sqrt(1 + np.sin(slope)))
    x = np.sqrt(2 * np.sin(slope) / load)
    y = 1 - 2 * (ellipeinc(np.pi / 2, square) - ellipeinc(corner, square)) / np.sqrt(load)
    moment = load * x * float(w.stiffness) / scene.arc
    return Found(moment, 0.0, float(np.hypot(x, y) * scene.arc), float(np.arctan2(y, x)))


# -- PyElastica ----------------------------------------------------------------------------------


def pyelastica(elements: int, scene: Scene) -> Found:
    """A Cosserat rod cut at the contact, a force that follows its end, damped until at rest."""
    import elastica as ea  # type: ignore[import-not-found]

    class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):  # type: ignore[misc]
        pass

    class Follower(ea.NoForces):  # type: ignore[misc]
        def __init__(self, force: float, ramp: float) -> None:
            super().__init__()
            self.force, self.ramp = force, ramp

        def apply_forces(self, system: Any, time: float = 0.0) -> None:
            fx, fy = pushed(system)
            share = min(1.0, time / self.ramp)
            system.external_forces[0, -1] += share * fx
            system.external_forces[1, -1] += share * fy

    # Units in which the arc to the contact and the base's stiffness are 1.
    w, arc = scene.whisker, scene.arc
    force = scene.force * arc**2 / float(w.stiffness)
    c, q = force * np.cos(scene.friction), force * np.sin(scene.friction)

    def pushed(system: Any) -> tuple[float, float]:
        along = system.tangents[:, -1]
        return -q * along[0] - c * along[1], -q * along[1] + c * along[0]

    shear, spin, h = 1e5, 1e-3, 1 / elements
    s = np.linspace(0, 1, elements + 1)
    middle = (s[1:] + s[:-1]) / 2

    def stiff(at: Array) -> Array:
        return np.asarray(_stiffness(w, at * arc) / w.stiffness)

    x_axis, z_axis = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    beam = ea.CosseratRod.straight_rod(
        elements, np.zeros(3), x_axis, z_axis, 1.0, 0.1, 1.0, youngs_modulus=1.0, shear_modulus=1.0
    )
    beam.mass[:] = stiff(s) * h * np.where((s == 0) | (s == 1), 0.5, 1.0)
    for i in range(3):
        beam.mass_second_moment_of_inertia[i, i, :] = spin * h * stiff(middle)
        beam.inv_mass_second_moment_of_inertia[i, i, :] = 1 / (spin * h * stiff(middle))
        beam.shear_matrix[i, i, :] = shear * stiff(middle)
        beam.bend_matrix[i, i, :] = stiff(s[1:-1])
    beam.rest_kappa[0, :] = float(w.curvature) * arc
    # The lowest frequency is about 3.5 for a uniform beam and rises with the taper.
    pace = 3.5 / (1 - arc * float(w.taper / w.length)) ** 0.5
    step, ramp = 0.8 * h / np.sqrt(shear), 3 / pace
    simulator = Simulator()
    simulator.append(beam)
    simulator.constrain(beam).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    simulator.add_forcing_to(beam).using(Follower, force=force, ramp=ramp)
    simulator.dampen(beam).using(
        ea.AnalyticalLinearDamper, uniform_damping_constant=2 * pace, time_step=step
    )
    simulator.finalize()
    stepper, now = ea.PositionVerlet(), 0.0
    while True:
        for _ in range(500):
            now = stepper.step(simulator, now, step)
        if now > ramp and np.abs(beam.velocity_collection).max() < 1e-4:
            break
        if not np.isfinite(now) or now > 100 / pace:
            return Found(*[np.nan] * 4)
    x, y = beam.position_collection[:2, -1]
    fx, fy = pushed(beam)
    unit = float(w.stiffness) / arc
    return Found(
        (x * fy - y * fx) * unit,
        -fx * unit / arc,
        float(np.hypot(x, y)) * arc,
        float(np.arctan2(y, x)),
    )


# -- the table -----------------------------------------------------------------------------------


def methods(scene: Scene, short: bool) -> Iterator[tuple[str, str, Method | None]]:
    """What is given, name and method for each row of a scene; None: it is not installed."""
    for name, model in (("closed form", closed_form), ("elastica", elastica)):
        if scene.plain:
            yield "force", name, partial(_straight, model)
            yield "contact", name, partial(_straight_press, model)
    yield "force", "planar beam", _planar_beam
    yield "contact", "planar beam", _planar_beam_press
    yield "force", "rod", _rod_bend
    yield "contact", "rod", _rod_press
    for rtol in (1e-6, 1e-10):
        yield "force", f"SciPy DOP853, rtol {rtol:.0e}", partial(initial_value, rtol)
    yield "contact", "SciPy root over DOP853", rooted
    for tolerance in (1e-3, 1e-9):
        for given in ("force", "contact"):
            solver = partial(boundary_value, tolerance, given == "contact")
            yield given, f"SciPy solve_bvp, tol {tolerance:.0e}", solver
    if scene.name.startswith("uniform, α"):
        yield "force", "elliptic integrals", uniform_exact
    if "dead" in scene.name:
        yield "force", "elliptic integrals", bisshopp_drucker
    for elements in () if short else (60, 120):
        solver = partial(pyelastica, elements)
        name = f"PyElastica, {elements} elements"
        yield "force", name, solver if _version("pyelastica") else None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def compare(*, short: bool = False) -> pd.DataFrame:
    """The table: a row for each scene, what is given, and method."""
    rows = []
    for scene in scenes():
        exact = truth(scene)
        for given, name, method in methods(scene, short):
            row: dict[str, Any] = {"scene": scene.name, "given": given, "method": name}
            if method is None:
                rows.append(row | {"note": NOT_INSTALLED})
                continue
            repeats = 1 if name.startswith("PyElastica") or short else 5
            found, seconds = _timed(method, scene, repeats)
            row |= {
                "error_moment": abs(found.moment / exact.moment - 1),
                "error_axial_force": abs(found.axial_force - exact.axial_force) / scene.force,
                "error_radial_distance": abs(found.radial_distance / exact.radial_distance - 1),
                "error_deflection_angle": abs(found.deflection_angle - exact.deflection_angle),
                "cpu_seconds": seconds,
                "note": "" if np.isfinite(found.moment) else "found no solution",
            }
            rows.append(row)
    return pd.DataFrame(rows)


def _timed(method: Method, scene: Scene, repeats: int) -> tuple[Found, float]:
    """The result and the shortest CPU time of a few after a first call, or that call's of one."""
    begun = time.process_time()
    found, times = method(scene), []
    if repeats == 1:
        times.append(time.process_time() - begun)
    for _ in range(repeats if repeats > 1 else 0):
        start, n = time.process_time(), 0
        while n == 0 or time.process_time() - start < 2e-3:
            found, n = method(scene), n + 1
        times.append((time.process_time() - start) / n)
    return found, min(times)


def summary(table: pd.DataFrame) -> str:
    """Markdown: error of M and milliseconds, a row for each method, a column for each scene."""
    names = list(dict.fromkeys(table["scene"]))
    lines = ["| given | method | " + " | ".join(names) + " |", "|---" * (len(names) + 2) + "|"]
    for (given, method), rows in table.groupby(["given", "method"], sort=False):
        cells = {
            row.scene: f"{row.error_moment:.0e}, {row.cpu_seconds * 1e3:.3g} ms"
            if np.isfinite(row.error_moment)
            else row.note
            for row in rows.itertuples()
        }
        line = " | ".join(cells.get(name, "–") for name in names)
        lines.append(f"| {given} | {method} | {line} |")
    return "\n".join(lines)


def versions() -> str:
    """The line that says with what and on what kind of machine."""
    packages = ("numpy", "scipy", "mpmath", "pyelastica", "numba")
    listed = ", ".join(f"{name} {_version(name) or 'not installed'}" for name in packages)
    system = f"{platform.system()} {platform.machine()}"
    python = f"Python {platform.python_version()}, weberwhisk {ww.__version__}"
    return f"{python}, {listed}; {system}, one core"


def make(folder: Path, *, short: bool = False) -> pd.DataFrame:
    """Both files into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    table = compare(short=short)
    table["versions"] = ""
    table.loc[0, "versions"] = versions()
    table.to_csv(folder / "referees.csv", index=False, float_format="%.3g")
    text = (
        f"Error of M relative to the truth, and CPU time of one solution.\n\n{summary(table)}\n\n"
    )
    (folder / "referees.md").write_text(f"{text}{versions()}\n", encoding="utf-8")
    return table


if __name__ == "__main__":
    chosen = options(__file__, __doc__, short="without PyElastica, each timed once")
    print(summary(make(chosen.folder, short=chosen.short)))
    print(versions())
