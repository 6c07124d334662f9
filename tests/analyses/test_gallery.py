"""The gallery's studies: cues side by side, a whisk, its speed, a tilted surface, an array."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from analysis_scripts import load
from figure_checks import faults
from matplotlib.figure import Figure
from scipy.special import ndtr

import weberwhisk as ww
from weberwhisk.mechanics import rod
from weberwhisk.receptors import Weber
from weberwhisk.sensitivity import fisher_jnd

gallery, surveys, along_whisk, array_maps = (
    load(f"gallery.{name}") for name in ("make", "surveys", "along_whisk", "array_maps")
)
LateralSlip = load("gallery.lateral_slip").LateralSlip
WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)


@cache
def beam(whisker: ww.Whisker, r: float, n: int = 120) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Stiffness and mass of Hermite elements, and what is free: clamped at 0, held at r."""
    left = max(int(n * r / whisker.length), 4)
    nodes = np.unique(np.r_[np.linspace(0, r, left + 1), np.linspace(r, whisker.length, n - left)])
    size = 2 * len(nodes)
    stiff, mass = np.zeros((size, size)), np.zeros((size, size))
    x, weight = np.polynomial.legendre.leggauss(5)
    x, weight = (x + 1) / 2, weight / 2
    for i, h in enumerate(np.diff(nodes)):
        shape = np.array([1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3),
                          3 * x**2 - 2 * x**3, h * (x**3 - x**2)])  # fmt: skip
        bent = np.array([-6 + 12 * x, h * (6 * x - 4), 6 - 12 * x, h * (6 * x - 2)]) / h**2
        share = (nodes[i] + h * x) / whisker.length
        a = whisker.base_radius + (whisker.tip_radius - whisker.base_radius) * share
        own = slice(2 * i, 2 * i + 4)
        stiff[own, own] += (
            bent * (whisker.youngs_modulus * np.pi / 4 * a**4 * weight * h)
        ) @ bent.T
        mass[own, own] += (shape * (whisker.density * np.pi * a**2 * weight * h)) @ shape.T
    held = 2 * int(np.argmin(np.abs(nodes - r)))
    return stiff, mass, [i for i in range(size) if i not in (0, 1, held)]


def moment(whisker: ww.Whisker, r: float, frequency: float) -> float:
    """Amplitude of the base moment while the base turns by a unit sinusoid."""
    stiff, mass, free = beam(whisker, r)
    dynamic = stiff - (2 * np.pi * frequency) ** 2 * mass
    u = np.zeros(len(stiff))
    u[1] = 1.0
    u[free] = np.linalg.solve(dynamic[np.ix_(free, free)], -dynamic[free, 1])
    return float(dynamic[1] @ u)


def test_torque_threshold_and_saturation_cut_the_curve_where_they_should() -> None:
    r = np.linspace(0.05, 0.95, 40) * WHISKER.length
    table = along_whisk.limits(WHISKER, r)
    observer = ww.Observer(WHISKER, ww.cues.Compliance())
    light = along_whisk.limits(WHISKER, r, push=1e-3, torque=1.0, saturation=1.0, threshold=1e-15)
    expected = 1e3 * fisher_jnd(observer, r[:, None]) * np.sqrt(1.02)
    np.testing.assert_allclose(light["weber_mm"], expected, rtol=2e-3)
    np.testing.assert_allclose(light["all_mm"], light["weber_mm"], rtol=1e-5)
    moment = table["moment_micronewton_metre"]
    np.testing.assert_allclose(moment[table["stopped"]], 4, rtol=1e-6)
    assert table["stopped"].any()
    assert table.loc[moment > 2.5, "all_mm"].isna().all()
    assert (table["threshold_mm"] >= table["weber_mm"]).all()


# -- cues side by side ---------------------------------------------------------------------------


def test_no_cue_is_best_everywhere() -> None:
    table = surveys.best(15)
    names = [f"{name}_mm" for name in surveys.MAPPED]
    assert np.all(table[names].min(axis=1) > 0)
    assert table["best"].nunique() == 3
    # Both forces and the moment are never worse than two of the three.
    pair, every = (table[name] for name in names[2:])
    assert np.all(every <= pair * (1 + 1e-9))


def test_every_way_to_fail_is_an_outcome() -> None:
    """By chance, as a tip that is not touched, or altogether, as modes that damping merges."""
    table = surveys.outcomes(30, 60, seed=3)
    total = table.groupby(["cue", "radial_distance_mm"])["share"].sum()
    assert np.allclose(total, 1.0)
    names = {cue: set(rows["outcome"]) for cue, rows in table.groupby("cue")}
    assert {"no touch", "tip not touched"} <= names["whisker length (a)"]
    assert "no touch" in names["which of three whiskers touch (b)"]
    assert {"one-sided", "out of reach"} <= names["angle-side-angle (c)"]
    assert "flicked past" in names["contact and detachment (c)"]
    assert "slipped off the tip" in names["moment and axial force (f)"]
    assert "flicked past" in names["balance of moments (h)"]
    assert "held" not in names["vibration, 6 damped modes (d)"]


# -- a tilted surface ----------------------------------------------------------------------------


def test_the_lateral_slip_is_that_of_a_rod_pressed_by_a_tilted_plane() -> None:
    """The rod of model 3, turned by a small angle against a smooth tilted plane."""
    r, tilt, turn = 25e-3, 0.6, 1e-4
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=1e-9)
    # The normal's part of the point's shift in the base frame is all that bends the whisker.
    push = r * turn * np.cos(tilt)
    point = [r, push * np.cos(tilt), push * np.sin(tilt)]
    moment = rod.press(whisker, point).moment / turn
    (size, direction), _ = LateralSlip().signals(WHISKER, np.array([r, tilt]))
    # A force along (0, cos τ, sin τ) has the moment (0, −sin τ, cos τ).
    assert np.hypot(moment[1], moment[2]) == pytest.approx(size, rel=1e-5)
    assert np.arctan2(-moment[1], moment[2]) == pytest.approx(direction, rel=1e-5)


# -- arrays --------------------------------------------------------------------------------------


def array_of(*names: str, **how: object) -> ww.ArrayObserver:
    array = ww.WhiskerArray("rat", "right", identities=list(names)).protract(np.radians(40))
    return ww.ArrayObserver(array, **how)


@pytest.mark.slow
def test_a_map_is_that_of_the_posterior_region() -> None:
    """Not by Fisher information: the area of the 95 % region, where noise is small."""
    o = array_of("C2", "D2", "C3", noise=Weber(0.03))
    row = array_maps.array_resolution(o, 16e-3, -1e-3).iloc[0]
    said = np.pi * -2 * np.log(0.05) * row.major_mm * row.minor_mm
    found = [ww.place(o, o.read([16e-3, -1e-3], seed)) for seed in range(4)]
    assert np.mean([one.area() for one in found]) * 1e6 == pytest.approx(said, rel=0.25)
    # The prior counts as a Gaussian of the same variance, which has 0.51 bits more than the box.
    assert np.mean([one.bits for one in found]) == pytest.approx(row.bits - 0.51, abs=0.4)


def test_fewer_whiskers_discriminate_worse() -> None:
    o = array_of("C0", "C1", "C2", "C3", "D0", "D1", "D2", "D3")
    places = np.linspace(-8e-3, 8e-3, 9)
    table = array_maps.array_by_count(o, 20e-3, places, (1, 4, 8), subsets=60, seed=1)
    assert table["correct"].is_monotonic_increasing
    assert table["error_mm"].is_monotonic_decreasing
    # With all intact, by hand: the widths' variance is that of both sides, their prior flat.
    told = o.information(np.stack([np.full(9, 20e-3), places], axis=-1)).sum(axis=1)
    prior = np.diag([1e-9, 12 / np.diff(o.box[1])[0] ** 2])
    x = np.array([np.linalg.inv(each + prior)[0, 0] for each in told])
    assert table["correct"].iloc[-1] == pytest.approx(ndtr(1.5e-3 / np.sqrt(2 * x)).mean())


# -- charts --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", gallery.CHARTS)
def test_every_chart_can_be_read(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery.Asked, "readings", lambda asked, times=1: 3)
    chart = gallery.CHARTS[name](gallery.Asked(short=True)).chart
    assert faults(chart if isinstance(chart, Figure) else ww.plots.figure_of(chart)) == []


def test_a_chart_is_written_with_its_table(tmp_path: Path) -> None:
    gallery.make(tmp_path, ["jnd-limits"], short=True)
    assert {path.name for path in tmp_path.iterdir()} == {
        "jnd-limits.csv", "jnd-limits.png", "jnd-limits.svg", "jnd-limits.run.json",
    }  # fmt: skip
