"""The paper's figure 3: the balance of moments between a muscle and a whisker.

The muscle is equation (2.2) with the arctangent of the full circle, its peak scaled to 1
(*normalised*) or as it is (*printed*), each on its own gain: with which the whisker flicks past
from 0.697 L on, for the "around 70 per cent" of the text. The two differ in their unit alone.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..mechanics import flick_past, press
from ..mechanics.muscle import WHISKING, Balance, MuscleCurve, moment_balance
from ..surveys import WHISKER

Array = NDArray[np.float64]

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


def check(b: pd.DataFrame, c: pd.DataFrame) -> pd.DataFrame:
    """What caption and text say of the figure, a row a claim, with the paper's numbers."""
    rows: list[tuple[str, float, float]] = []
    for curve in MuscleCurve:
        end = b.loc[(b["curve"] == curve.value) & (b["outcome"] == "BALANCED"), "radial_distance"]
        rows.append((f"b: end of the curve, {curve.value}, r/L", end.max(), 0.7))
    past = moment_balance(WHISKER, np.array(SHOWN) * WHISKER.length, IMPACT).outcome
    rows.append(("a: distances of four that flick past", int(np.sum(past != 0)), 2))
    falling = b.groupby("curve")["balance_angle_deg"].apply(lambda t: np.sum(np.diff(t) <= 0))
    rows.append(("b: falls of θ_b with distance, all curves", int(falling.sum()), 0))
    grid = c[c["curve"] == MuscleCurve.NORMALISED.value]
    below = _below_the_line(grid)
    early = grid["outcome"].isin(["FLICKED_PAST", "SLIPPED_OFF_TIP"])
    late = grid["outcome"] == "END_OF_WHISKING"
    rows.append(("c: flicked past, but above the dashed line", int(np.sum(early & ~below)), 0))
    rows.append(("c: range of whisking ended, but below it", int(np.sum(late & below)), 0))
    return pd.DataFrame(rows, columns=["claim", "found", "paper"])


def _below_the_line(grid: pd.DataFrame) -> NDArray[np.bool_]:
    share, angle = dashed_line()
    limit = np.interp(grid["radial_distance"], share, angle)
    return np.asarray(grid["impact_angle_deg"] <= limit + 1e-9)
