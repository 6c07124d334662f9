"""Which three of the six base signals locate a contact in space (Huet, Rudnicki & Hartmann 2017).

    python analyses/triplets.py [folder] [--short]

Writes triplets.csv: for each of the 20 triplets and all six, of a straight and a curved taper and
of such cylinders, the share of contacts that another contact has the same signals as
(at the least: those that Newton's method finds from twelve parts of the reach), the share at which
the signals leave a direction open (the smallest singular value of their slopes below 1e-6 of the
largest), and the median JND of the radial distance. Contacts are draws from the prior: flat over
all that the whisker holds, without friction.

Signals as they have them: axial force FX, size and direction of the transverse force FT and FD,
torsion MX, size and direction of the bending moment MB and MD. Noise for the JND: a tenth of each
size, 0.1 rad of each direction, and a hundredth of force or moment as a floor of FX and MX, which
pass through zero.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from command import options

import weberwhisk as ww
from weberwhisk.mechanics.curved_surface import SIX, CurvedSurface
from weberwhisk.sensitivity import prior_draws

NAMES = ("FX", "FT", "FD", "MX", "MB", "MD")
WHISKERS = {
    f"{kind} {shape}": ww.Whisker(50e-3, 100e-6, tip, 3e9, curvature)
    for shape, tip in (("taper", 5e-6), ("cylinder", 100e-6))
    for kind, curvature in (("straight", 1e-6), ("curved", 8.0))
}
NUDGE = 1e-6


class Contacts:
    """Signals of one whisker at places q (..., 3): distance, share of the largest push, azimuth."""

    def __init__(self, whisker: ww.Whisker) -> None:
        self.surface = CurvedSurface(whisker, in_space=True)
        self.reach = self.surface.reach

    def signals(self, q: Any) -> Any:
        """FX, FT, FD, MX, MB, MD (n, 6) at places (n, 3), lengths in reaches."""
        r, azimuth = q[:, 0] * self.reach, q[:, 2]
        six, _ = self.surface(r, q[:, 1] * self.surface.limit(r, azimuth), azimuth)
        fx, fy, fz, mx, my, mz = (six / ([1, 1, 1] + 3 * [self.reach])).T
        across, bending = np.hypot(fy, fz), np.hypot(my, mz)
        return np.stack([fx, across, np.arctan2(fz, fy), mx, bending, np.arctan2(-my, mz)], axis=1)

    def slopes(self, q: Any, here: Any) -> Any:
        """Their derivatives to the places (n, 6, 3), angles not cut."""
        columns = [self.difference(self.signals(q + h), here) / NUDGE for h in NUDGE * np.eye(3)]
        return np.stack(columns, axis=2)

    @staticmethod
    def difference(one: Any, other: Any) -> Any:
        """Of signals, directions by the shorter way round."""
        out = one - other
        out[:, [2, 5]] = (out[:, [2, 5]] + np.pi) % (2 * np.pi) - np.pi
        return out


def units(signals: Any) -> Any:
    """What differences of signals are compared with (n, 6): force, moment, a radian."""
    force, moment = np.hypot(signals[:, 0], signals[:, 1]), np.hypot(signals[:, 3], signals[:, 4])
    one = np.ones(len(signals))
    return np.stack([force, force, one, moment, moment, one], axis=1)


def others(contacts: Contacts, place: Any, triplet: list[int], scattered: Any, steps: int) -> Any:
    """Whether each place (n, 3) has another with the same three signals, (n,) of bool."""
    wanted = contacts.signals(place)
    unit = units(wanted)[:, triplet]
    known, region = scattered
    table = contacts.signals(known)
    starts = []
    for value, size in zip(wanted, unit, strict=True):
        off = contacts.difference(table, value[None])[:, triplet] / size
        near = np.abs(off).sum(axis=1)
        starts.append([np.where(region == k, near, np.inf).argmin() for k in np.unique(region)])
    count = len(starts[0])
    q, goal = known[np.concatenate(starts)].copy(), np.repeat(wanted, count, axis=0)
    size = np.repeat(unit, count, axis=0)
    for _ in range(steps):
        here = contacts.signals(q)
        miss = contacts.difference(goal, here)[:, triplet] / size
        slope = contacts.slopes(q, here)[:, triplet] / size[..., None]
        step = np.einsum("nij,nj->ni", np.linalg.pinv(np.nan_to_num(slope), rcond=1e-9), miss)
        q = q + np.clip(np.nan_to_num(step), [-0.1, -0.1, -0.5], [0.1, 0.1, 0.5])
        q[:, :2] = np.clip(q[:, :2], [0.01, 1e-3], [0.99, 0.995])
    left = np.abs(contacts.difference(goal, contacts.signals(q))[:, triplet] / size).max(axis=1)
    off = q - np.repeat(place, count, axis=0)
    off[:, 2] = (off[:, 2] + np.pi) % (2 * np.pi) - np.pi
    # Another place: by 1 mm or 3 degrees more than nothing.
    apart = (np.abs(off[:, 0]) * contacts.reach > 1e-3) | (np.abs(off[:, 2]) > np.radians(3))
    return ((left < 1e-6) & apart).reshape(-1, count).any(axis=1)


def judged(whisker: ww.Whisker, count: int, steps: int, k: float = 0.1) -> pd.DataFrame:
    """One row for each triplet."""
    contacts = Contacts(whisker)
    surface = contacts.surface
    draws = prior_draws(ww.Observer(whisker, ww.cues.SpaceMap(SIX), model="rod"), count, seed=1)
    share = draws[:, 1] / surface.limit(draws[:, 0], draws[:, 2])
    place = np.stack([draws[:, 0] / contacts.reach, share, draws[:, 2]], axis=1)
    place[:, :2] = np.clip(place[:, :2], [0.02, 0.01], [0.98, 0.98])
    rng = np.random.default_rng(2)
    known = rng.uniform([0.02, 0.02, -np.pi], [0.98, 0.98, np.pi], (4000, 3))
    region = (3 * known[:, 0]).astype(int) * 4 + ((known[:, 2] + np.pi) / np.pi * 2).astype(int)
    signals = contacts.signals(place)
    slopes = contacts.slopes(place, signals)
    unit = units(signals)
    sd = np.array([k, k, k, k, k, k]) * np.where([0, 0, 1, 0, 0, 1], 1.0, np.abs(signals))
    sd[:, [0, 3]] = np.hypot(sd[:, [0, 3]], 0.01 * unit[:, [0, 3]])
    rows = []
    for triplet in map(list, [*combinations(range(6), 3), range(6)]):
        values = np.linalg.svd(slopes[:, triplet] / unit[:, triplet, None], compute_uv=False)
        open_ = values[:, 2] < 1e-6 * values[:, 0]
        scaled = slopes[:, triplet] / sd[:, triplet, None]
        with np.errstate(all="ignore"):
            inverse = np.linalg.pinv(scaled, rcond=1e-12)
            jnd = np.sqrt((inverse[:, 0] ** 2).sum(axis=1)) * contacts.reach
        same = others(contacts, place, triplet, (known, region), steps)
        rows.append(
            {
                "triplet": " ".join(NAMES[i] for i in triplet),
                "open": open_.mean(),
                "ambiguous": np.nan if open_.mean() > 0.5 else same.mean(),
                "jnd_mm": np.inf if open_.mean() > 0.5 else 1e3 * np.median(jnd),
            }
        )
    return pd.DataFrame(rows)


def main() -> None:
    """Write and print the table."""
    given = options(__file__, __doc__, short="few contacts, and the curved taper alone")
    kinds = {"curved taper": WHISKERS["curved taper"]} if given.short else WHISKERS
    parts = []
    for name, whisker in kinds.items():
        part = judged(whisker, *((12, 12) if given.short else (60, 25)))
        part.insert(0, "whisker", name)
        parts.append(part)
        print(part.sort_values(["ambiguous", "jnd_mm"]).to_string(index=False), flush=True)
    given.folder.mkdir(parents=True, exist_ok=True)
    pd.concat(parts).to_csv(given.folder / "triplets.csv", index=False)


if __name__ == "__main__":
    main()
