"""Solomon & Hartmann (2011) remade: the numbers of its figures; `claims` has its sentences.

Figure 2, large bending of a tapered whisker (radius ratio 20) and a cylinder: each is loaded at
many arc lengths until the contact angle is 90°, as in the paper; some of those contacts an object
fixed in space could no longer hold (outcome PAST_FOLD), and the map is one-to-one there as well.
All in the paper's normalised units.

Figure 3, the balance of moments between a muscle and a whisker: the muscle is equation (2.2) with
the arctangent of the full circle, its peak scaled to 1 (*normalised*) or as it is (*printed*), each
on its own gain: with which the whisker flicks past from 0.697 L on, for the "around 70 per cent" of
the text. The two differ in their unit alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ..cues import Compliance
from ..mechanics import Bending, Outcome, bend, flick_past, press
from ..mechanics.muscle import WHISKING, Balance, MuscleCurve, moment_balance
from ..surveys import WHISKER
from ..whisker import Whisker

Array = NDArray[np.float64]

CONE = Whisker(WHISKER.length, WHISKER.base_radius, 0.0, WHISKER.youngs_modulus)


def moment_rates() -> pd.DataFrame:
    """Figure 1d: dM/dθ in units of EI/L against r/L, for a cone, R = 20 and a cylinder."""
    share, tables = np.linspace(0.02, 0.995, 200), []
    for name, whisker in (
        ("cone", CONE), ("tapered, R = 20", WHISKER), ("cylinder", WHISKER.cylinder())
    ):  # fmt: skip
        rate = Compliance().signals(whisker, share[:, None] * whisker.length)[0][:, 0]
        columns = {"radial_distance": share, "rate": rate / whisker.moment_scale}
        tables.append(pd.DataFrame(columns).assign(whisker=name))
    return pd.concat(tables, ignore_index=True)


# -- figure 2 --------------------------------------------------------------------------------------

WHISKERS = {"tapered": WHISKER, "cylinder": WHISKER.cylinder()}
#: Contacts: arc lengths over L, and the angles up to which the paper loads them.
ARCS = np.linspace(0.05, 1.0, 96)
DEGREES = np.linspace(0.5, 90.0, 90)


def loaded(whisker: Whisker, arc: Array, contact_angle: Array) -> Bending:
    """The whisker loaded at arc lengths (m) to given contact angles (rad), by bisection in ln F."""
    shape = np.broadcast_shapes(np.shape(arc), np.shape(contact_angle))
    low, high = np.full(shape, -40.0), np.full(shape, 12.0)
    for _ in range(70):
        middle = (low + high) / 2
        angle = bend(whisker, arc, np.exp(middle) * whisker.force_scale).contact_angle
        under = angle < contact_angle  # NaN, a load beyond the map, is over
        low, high = np.where(under, middle, low), np.where(under, high, middle)
    return bend(whisker, arc, np.exp(low) * whisker.force_scale)


def contacts(arcs: Array = ARCS, degrees: Array = DEGREES) -> pd.DataFrame:
    """Every contact of panels b to f, a row each, normalised as in the paper."""
    tables = []
    for name, whisker in WHISKERS.items():
        bent = loaded(whisker, arcs * whisker.length, np.radians(degrees)[:, None])
        columns = {
            "whisker": np.full(bent.moment.shape, name),
            "arc_length": bent.arc_length / whisker.length,
            "contact_angle_deg": np.degrees(bent.contact_angle),
            "force": bent.force / whisker.force_scale,
            "moment": bent.normalised_moment,
            "axial_force": bent.normalised_axial_force,
            "transverse_force": bent.transverse_force / whisker.force_scale,
            "radial_distance": bent.radial_distance / whisker.length,
            "deflection_angle_deg": np.degrees(bent.deflection_angle),
        }
        named = [Outcome(int(k)).name for k in np.ravel(bent.outcome)]
        tables.append(
            pd.DataFrame({key: np.ravel(value) for key, value in columns.items()}).assign(
                outcome=named
            )
        )
    return pd.concat(tables, ignore_index=True)


def map_jacobian(whisker: Whisker) -> Array:
    """Determinant of ∂(ln M, ln Fx)/∂(ln s, ln F) over the contacts, by central differences.

    In arc length and force, unlike in r and θ_d, nothing is singular at a fold.
    """
    step = 1e-4
    arc = np.minimum(ARCS, 1 - 2 * step) * whisker.length
    force = loaded(whisker, arc, np.radians(DEGREES)[:, None]).force * (1 - 4 * step)

    def signals(along: float, push: float) -> Array:
        bent = bend(whisker, arc * np.exp(along), force * np.exp(push))
        return np.log([bent.moment, bent.axial_force])

    by_arc = (signals(step, 0) - signals(-step, 0)) / (2 * step)
    by_force = (signals(0, step) - signals(0, -step)) / (2 * step)
    return np.asarray(by_arc[0] * by_force[1] - by_arc[1] * by_force[0])


def map_boundary(whisker: Whisker, points: int = 200) -> Array:
    """The image of the domain's edge in (ln M, ln M²/(2EI₀Fx)), a closed polygon (n, 2).

    A map without singular points that takes the edge of a disc to a curve that does not cross
    itself is one-to-one: no two contacts of the domain share signals.
    """
    arc, angle = (
        np.linspace(ARCS[0], ARCS[-1], points),
        np.linspace(DEGREES[0], DEGREES[-1], points),
    )
    edges = [
        (arc, angle[:1]),
        (arc[-1:], angle),
        (arc[::-1], angle[-1:]),
        (arc[:1], angle[::-1]),
    ]
    sides = []
    for s, alpha in edges:
        bent = loaded(whisker, s * whisker.length, np.radians(alpha))
        ratio = bent.moment**2 / (2 * whisker.stiffness * bent.axial_force)
        sides.append(np.stack([np.log(bent.normalised_moment), np.log(ratio)], axis=-1)[:-1])
    return np.concatenate(sides)


def crossings(polygon: Array) -> int:
    """How often the sides of a closed polygon (n, 2) cross one another."""
    a, b = polygon, np.roll(polygon, -1, axis=0)

    def side(p: Array, q: Array, x: Array) -> Array:
        """On which side of each line p → q each point x lies, (n, n)."""
        along, out = (q - p)[:, None], x[None] - p[:, None]
        return np.asarray(np.sign(along[..., 0] * out[..., 1] - along[..., 1] * out[..., 0]))

    crossed = (side(a, b, a) * side(a, b, b) < 0) & (side(a, b, a) * side(a, b, b) < 0).T
    return int(np.sum(crossed)) // 2


def shape(whisker: Whisker, bent: Bending) -> Array:
    """Points (2, n) of one bent whisker, straight past the contact, from the signals at its base.

    The base's moment and force are all that is used: that the moment comes out as zero at the
    contact is a check.
    """
    taper = float(whisker.taper / whisker.length)

    def rates(s: float, state: Array) -> list[float]:
        angle, x, y = state
        moment = bent.moment - x * bent.transverse_force - y * bent.axial_force
        curvature = moment / (whisker.stiffness * (1 - taper * s) ** 4)
        return [curvature, np.cos(angle), np.sin(angle)]

    at = np.linspace(0, bent.arc_length, 100)
    end = (0.0, float(bent.arc_length))
    path = solve_ivp(rates, end, [0.0, 0.0, 0.0], t_eval=at, rtol=1e-9, atol=1e-12).y
    rest = (whisker.length - bent.arc_length) * np.array([np.cos(path[0, -1]), np.sin(path[0, -1])])
    return np.column_stack([path[1:], path[1:, -1] + rest])


def examples(shares: Sequence[float] = (0.3, 0.6, 0.9)) -> pd.DataFrame:
    """Panel a: the three whiskers as they are loaded to 90°, points (x/L, y/L) of each."""
    tables = []
    for share in shares:
        for degrees in range(0, 91, 15):
            angle = np.array(np.radians(max(degrees, 1e-3)))
            x, y = shape(WHISKER, loaded(WHISKER, np.array(share * WHISKER.length), angle))
            columns = {"x": x / WHISKER.length, "y": y / WHISKER.length}
            columns |= {"arc_length": np.full(x.size, share)}
            columns |= {"contact_angle_deg": np.full(x.size, degrees)}
            tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def lines() -> pd.DataFrame:
    """Panels b and c: moment against contact force at ten arc lengths, up to 90°."""
    arcs, tables = np.linspace(0.1, 1.0, 10), []
    angle = np.radians(np.linspace(0.3, 90, 120))[:, None]
    for name, whisker in WHISKERS.items():
        bent = loaded(whisker, arcs * whisker.length, angle)
        columns = {
            "arc_length": np.broadcast_to(arcs, bent.force.shape),
            "force": bent.force / whisker.force_scale,
            "moment": bent.normalised_moment,
        }
        table = pd.DataFrame({key: np.ravel(value) for key, value in columns.items()})
        tables.append(table.assign(whisker=name))
    return pd.concat(tables, ignore_index=True)


# -- figure 3 --------------------------------------------------------------------------------------

IMPACT = float(np.radians(60.0))
#: Distances over L of panel a.
SHOWN = (0.3, 0.5, 0.7, 0.9)
#: Panel c: distances over L and impact angles in degrees.
DISTANCES, IMPACTS = np.linspace(0.3, 1.0, 211), np.linspace(30.0, 150.0, 121)


def moments() -> pd.DataFrame:
    """Panel a: the whisker's scaled moment at four distances, up to flick-past."""
    tables = []
    for share in SHOWN:
        r = share * WHISKER.length
        end = float(flick_past(WHISKER, r).deflection_angle)
        past = end * (1 - np.linspace(1, 0, 200) ** 2)
        bent = press(WHISKER, r, past)
        columns = {
            "radial_distance": np.full(past.size, share),
            "angle_deg": np.degrees(IMPACT + past),
            "moment": MuscleCurve.NORMALISED.gain() * bent.normalised_moment,
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def muscle() -> pd.DataFrame:
    """Panel a: the muscle's largest moment, equation (2.2) with its peak scaled to 1."""
    theta = np.linspace(*WHISKING, 300)
    moment = MuscleCurve.NORMALISED.moment(theta)
    return pd.DataFrame({"angle_deg": np.degrees(theta), "moment": moment})


def balance_angles() -> pd.DataFrame:
    """Panel b: θ_b at the impact angle of 60°, on either scale, and where each curve ends."""
    tables = []
    for curve in MuscleCurve:
        share = np.append(np.linspace(0.3, 1.0, 141), curve_end(curve))
        b = moment_balance(WHISKER, np.sort(share) * WHISKER.length, IMPACT, curve=curve)
        columns = {
            "curve": np.full(share.size, curve.value),
            "radial_distance": np.sort(share),
            "balance_angle_deg": np.degrees(b.balance_angle),
            "outcome": [Balance(k).name for k in b.outcome],
        }
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


@cache
def curve_end(curve: MuscleCurve, impact: float = IMPACT) -> float:
    """The largest distance over L at which muscle and whisker still balance, by finer grids."""
    low, high = 0.3, 1.0
    for _ in range(5):
        share = np.linspace(low, high, 33)
        b = moment_balance(WHISKER, share * WHISKER.length, impact, curve=curve)
        last = int(np.flatnonzero(b.outcome == Balance.BALANCED)[-1])
        low, high = share[last], share[last + 1]
    return float(low)


def surface(
    curve: MuscleCurve, distances: Array = DISTANCES, impacts: Array = IMPACTS
) -> pd.DataFrame:
    """Panel c: θ_b and the outcome over distance and impact angle."""
    b = moment_balance(
        WHISKER, distances * WHISKER.length, np.radians(impacts)[:, None], curve=curve
    )
    share, impact = np.meshgrid(distances, impacts)
    columns = {
        "curve": np.full(share.size, curve.value),
        "radial_distance": share.ravel(),
        "impact_angle_deg": impact.ravel(),
        "balance_angle_deg": np.degrees(b.balance_angle).ravel(),
        "outcome": [Balance(int(k)).name for k in b.outcome.ravel()],
    }
    return pd.DataFrame(columns)


def dashed_line() -> tuple[Array, Array]:
    """Distance over L and impact angle (degrees) between the two white areas.

    From an impact there, the whisker would flick past just as its range of motion ends.
    """
    flick = flick_past(WHISKER, DISTANCES * WHISKER.length).deflection_angle
    return DISTANCES, np.degrees(WHISKING[1] - flick)
