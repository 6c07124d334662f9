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

from enum import IntEnum
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from gallery.surveys import WHISKER
from scipy.integrate import solve_ivp

from weberwhisk import Outcome, Whisker, bend, flick_past, press
from weberwhisk.cues import BalanceOfMoments, Compliance
from weberwhisk.cues.balance_of_moments import MuscleCurve
from weberwhisk.mechanics import Bending

Array = np.ndarray
WHISKING = BalanceOfMoments().whisking
CONE = Whisker(WHISKER.length, WHISKER.base_radius, 0.0, WHISKER.youngs_modulus)


def moment_rates() -> pd.DataFrame:
    """Figure 1d: dM/dθ in units of EI/L against r/L, for a cone, R = 20 and a cylinder."""
    share, tables = np.linspace(0.02, 0.995, 200), []
    for name, whisker in (
        ("cone", CONE), ("tapered, R = 20", WHISKER), ("cylinder", WHISKER.cylinder())
    ):  # fmt: skip
        rate = Compliance().signals(whisker, share[:, None] * whisker.length)[0][:, 0]
        rate = rate / whisker.moment_scale
        tables.append(_table(radial_distance=share, rate=rate, whisker=name))
    return pd.concat(tables, ignore_index=True)


def _table(**columns: Any) -> pd.DataFrame:
    """Columns of shapes that broadcast to one, a row an element."""
    arrays = np.broadcast_arrays(*columns.values())
    return pd.DataFrame({name: a.ravel() for name, a in zip(columns, arrays, strict=True)})


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
        table = _table(
            whisker=name,
            arc_length=bent.arc_length / whisker.length,
            contact_angle_deg=np.degrees(bent.contact_angle),
            force=bent.force / whisker.force_scale,
            moment=bent.normalised_moment,
            axial_force=bent.normalised_axial_force,
            transverse_force=bent.transverse_force / whisker.force_scale,
            radial_distance=bent.radial_distance / whisker.length,
            deflection_angle_deg=np.degrees(bent.deflection_angle),
        )
        tables.append(table.assign(outcome=_names(Outcome, bent.outcome)))
    return pd.concat(tables, ignore_index=True)


def _names(kind: type[IntEnum], codes: Any) -> list[str]:
    return [kind(int(code)).name for code in np.ravel(codes)]


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
    arc, angle = (np.linspace(ends[0], ends[-1], points) for ends in (ARCS, DEGREES))
    sides, round_it = [], ((arc, angle[:1]), (arc[-1:], angle), (arc[::-1], angle[-1:]),
                           (arc[:1], angle[::-1]))  # fmt: skip
    for s, alpha in round_it:
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

    parted = side(a, b, a) * side(a, b, b) < 0
    return int(np.sum(parted & parted.T)) // 2


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


def examples() -> pd.DataFrame:
    """Panel a: the three whiskers as they are loaded to 90°, points (x/L, y/L) of each."""
    tables = []
    for share, degrees in product((0.3, 0.6, 0.9), range(0, 91, 15)):
        angle = np.array(np.radians(max(degrees, 1e-3)))
        bent = loaded(WHISKER, np.array(share * WHISKER.length), angle)
        x, y = shape(WHISKER, bent) / WHISKER.length
        tables.append(_table(x=x, y=y, arc_length=share, contact_angle_deg=degrees))
    return pd.concat(tables, ignore_index=True)


def lines() -> pd.DataFrame:
    """Panels b and c: moment against contact force at ten arc lengths, up to 90°."""
    arcs, tables = np.linspace(0.1, 1.0, 10), []
    angle = np.radians(np.linspace(0.3, 90, 120))[:, None]
    for name, whisker in WHISKERS.items():
        bent = loaded(whisker, arcs * whisker.length, angle)
        force = bent.force / whisker.force_scale
        tables.append(
            _table(arc_length=arcs, force=force, moment=bent.normalised_moment, whisker=name)
        )
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
        moment = MuscleCurve.NORMALISED.gain() * press(WHISKER, r, past).normalised_moment
        angle = np.degrees(IMPACT + past)
        tables.append(_table(radial_distance=share, angle_deg=angle, moment=moment))
    return pd.concat(tables, ignore_index=True)


def muscle() -> pd.DataFrame:
    """Panel a: the muscle's largest moment, equation (2.2) with its peak scaled to 1."""
    theta = np.linspace(*WHISKING, 300)
    return _table(angle_deg=np.degrees(theta), moment=MuscleCurve.NORMALISED.moment(theta))


def balance_angles() -> pd.DataFrame:
    """Panel b: θ_b at the impact angle of 60°, on either scale, and where each curve ends."""
    tables = []
    for curve in MuscleCurve:
        share = np.sort(np.append(np.linspace(0.3, 1.0, 141), curve_end(curve)))
        tables.append(_balances(curve, share, np.degrees(IMPACT)).drop(columns="impact_angle_deg"))
    return pd.concat(tables, ignore_index=True)


@cache
def curve_end(curve: MuscleCurve) -> float:
    """The largest distance over L at which muscle and whisker still balance, by finer grids."""
    low, high = 0.3, 1.0
    for _ in range(5):
        share = np.linspace(low, high, 33)
        outcome = _balances(curve, share, np.degrees(IMPACT))["outcome"]
        last = int(np.flatnonzero(outcome == "HELD")[-1])
        low, high = share[last], share[last + 1]
    return float(low)


def surface(
    curve: MuscleCurve, distances: Array = DISTANCES, impacts: Array = IMPACTS
) -> pd.DataFrame:
    """Panel c: θ_b and the outcome over distance and impact angle."""
    return _balances(curve, distances, impacts[:, None])


def _balances(curve: MuscleCurve, share: Array, degrees: float | Array) -> pd.DataFrame:
    """θ_b and the outcome at distances over L and impact angles."""
    tables = []
    for impact in np.ravel(degrees):
        # An impact where whisking ends leaves no room to push: one just before stands for it.
        angle = min(np.radians(impact), WHISKING[1] - 1e-9)
        cue = BalanceOfMoments(angle, curve=curve)
        theta, outcome = cue.signals(WHISKER, (share * WHISKER.length)[:, None])
        table = _table(
            curve=curve.value,
            radial_distance=share,
            impact_angle_deg=impact,
            balance_angle_deg=np.degrees(theta[:, 0]),
        )
        tables.append(table.assign(outcome=_names(Outcome, outcome)))
    return pd.concat(tables, ignore_index=True)


def dashed_line() -> tuple[Array, Array]:
    """Distance over L and impact angle (degrees) between the two white areas.

    From an impact there, the whisker would flick past just as its range of motion ends.
    """
    flick = flick_past(WHISKER, DISTANCES * WHISKER.length).deflection_angle
    return DISTANCES, np.degrees(WHISKING[1] - flick)
