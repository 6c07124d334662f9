"""Along a whisk: inertia beside a beam of finite elements, and JNDs against push and its limits."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh

import weberwhisk as ww
from weberwhisk import along_whisk, surveys
from weberwhisk.jnd import fisher_jnd
from weberwhisk.mechanics import quasi_static
from weberwhisk.mechanics.modes import modes

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
CYLINDER = ww.Whisker(40e-3, 60e-6, 60e-6)


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


@pytest.mark.parametrize("whisker", [WHISKER, CYLINDER])
@pytest.mark.parametrize("place", [0.2, 0.6, 0.9])
def test_inertia_lies_between_its_bounds(whisker: ww.Whisker, place: float) -> None:
    """A beam of 120 finite elements, at a twentieth to four fifths of its first frequency."""
    r = place * whisker.length
    found = quasi_static(whisker, r)
    stiff, mass, free = beam(whisker, r)
    lowest = eigh(stiff[np.ix_(free, free)], mass[np.ix_(free, free)], eigvals_only=True,
                  subset_by_index=(0, 0))[0]  # fmt: skip
    assert found.first_frequency == pytest.approx(np.sqrt(lowest) / (2 * np.pi), rel=2e-4)
    still = moment(whisker, r, 1e-3)
    for share in (0.05, 0.2, 0.5, 0.8):
        frequency = share * found.first_frequency
        lost = 1 - moment(whisker, r, frequency) / still
        least, most = found.error(frequency)
        assert least * (1 - 1e-3) < lost < most * (1 + 1e-3)


def test_a_beam_stepped_through_time_loses_as_much() -> None:
    """Newmark's average acceleration over a whisk that starts slowly: its moment's amplitude."""
    r, frequency, rate = 40e-3, 12.0, 4e-4
    stiff, mass, free = beam(WHISKER, r, 40)
    inner, time = np.ix_(free, free), np.arange(0.0, 0.75, rate)
    onset = np.clip(time / 0.4, 0, 1)
    angle = np.sin(2 * np.pi * frequency * time) * onset**2 * (3 - 2 * onset)
    push = np.gradient(np.gradient(angle, rate), rate)
    step = np.linalg.inv(mass[inner] + rate**2 / 4 * stiff[inner])
    u, v, a, felt = (np.zeros(len(free)) for _ in range(4))
    felt = np.zeros(time.size)
    for i in range(1, time.size):
        guess = u + rate * v + rate**2 / 4 * a
        load = -stiff[free, 1] * angle[i] - mass[free, 1] * push[i]
        after = step @ (load - stiff[inner] @ guess)
        u, v, a = guess + rate**2 / 4 * after, v + rate / 2 * (a + after), after
        inertia = mass[1, free] @ a + mass[1, 1] * push[i]
        felt[i] = stiff[1, 1] * angle[i] + stiff[1, free] @ u + inertia
    late = time > 0.5
    wave = np.exp(2j * np.pi * frequency * time[late])
    amplitude = 2 * abs(np.mean(felt[late] * wave))
    lost = 1 - amplitude / moment(WHISKER, r, 1e-3)
    least, most = quasi_static(WHISKER, r).error(frequency)
    assert least * 0.97 < lost < most * 1.03


def test_a_first_contact_rings_within_its_bound() -> None:
    """The modes of 60 finite elements, each with its own damping, from a whisker that strikes."""
    r, zeta, time = 30e-3, 0.1, np.linspace(2e-3, 0.1, 200)
    stiff, mass, free = beam(WHISKER, r, 60)
    inner = np.ix_(free, free)
    square, shapes = eigh(stiff[inner], mass[inner])
    omega = np.sqrt(square)
    places = np.unique(np.r_[np.linspace(0, r, 37), np.linspace(r, 50e-3, 25)])
    static = np.linalg.solve(stiff[inner], -stiff[free, 1])
    still = stiff[1, 1] + stiff[1, free] @ static
    # The whisker comes on straight: a node at s moves with s and turns with 1.
    coming = np.stack([places, np.ones(len(places))], axis=-1).ravel()[free] - static
    damped = omega * np.sqrt(1 - zeta**2)
    start = shapes.T @ (mass[inner] @ coming) / damped
    wave = np.exp(-zeta * omega * time[:, None]) * np.sin(damped * time[:, None]) * start
    # Reactions at the clamp: of the element there, whose own mass is next to nothing.
    rings = np.abs((wave @ shapes.T) @ stiff[1, free]) / (still * time)
    found = quasi_static(WHISKER, r)
    most = found.onset(time, zeta)
    assert (rings < most * 1.02).all()
    early = time < 0.02
    assert (rings[early] / most[early]).max() > 0.8
    for share in (0.1, 1e-3):
        assert found.onset(found.settled(share)) == pytest.approx(share, rel=1e-6)
    with pytest.raises(ValueError, match="damping_ratio must be between 0 and 1, got 0"):
        found.onset(0.01, 0.0)


def test_limits_and_notes_of_speed_say_the_same_as_the_bound() -> None:
    found = quasi_static(WHISKER, 30e-3)
    for error in (1e-3, 1e-2, 0.3):
        assert found.error(found.limit(error))[1] == pytest.approx(error, rel=1e-9)
    assert np.isinf(found.error(found.first_frequency * 1.01)[1])
    assert "mechanics hold." in found.note(8.0)
    assert f"hold up to {found.limit(0.01):.3g} Hz" in found.note(20.0)
    assert "do not hold" in found.note(200.0)
    at_tip = quasi_static(WHISKER, 50e-3)
    assert at_tip.first_frequency > modes(WHISKER, 1).frequency[0]
    for wrong in (0.0, 51e-3, np.nan):
        with pytest.raises(ValueError, match="radial_distance"):
            quasi_static(WHISKER, wrong)


def test_a_push_tells_more_of_a_peg_than_of_anything_round() -> None:
    push = np.radians([5.0, 15.0, 25.0])
    table = along_whisk.resolution_along_push(WHISKER, 25e-3, push)
    by = {name: rows.reset_index() for name, rows in table.groupby("object", sort=False)}
    observer = ww.Observer(WHISKER, ww.cues.ForceMap())
    peg = fisher_jnd(observer, np.stack([np.full(3, 25e-3), push], axis=-1))
    np.testing.assert_allclose(by["peg"]["jnd_mm"], 1e3 * peg, rtol=1e-5)
    order = [by[name]["jnd_mm"].to_numpy() for name in list(by)[:4]]
    assert all((a < b).all() for a, b in pairwise(order))
    wall = by["wall, by the tip"]
    assert wall["tip"].tolist() == [True, False, False]
    assert np.isnan(wall["jnd_mm"][0])
    assert wall["jnd_mm"][1] < wall["jnd_mm"][2] < by["peg"]["jnd_mm"][2]


def test_a_followed_distance_lies_in_its_band() -> None:
    table = along_whisk.lateral_sweep(WHISKER, 25e-3, np.radians(np.arange(2.0, 31.0, 4.0)))
    inside = table["true_distance_mm"].between(table["lower_mm"], table["upper_mm"])
    assert inside.mean() > 0.8
    slid = table[table["object"] != "peg"]["true_distance_mm"]
    assert slid.iloc[0] - slid.iloc[-1] > 4


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


@pytest.mark.parametrize(
    ("r", "push", "torque"), [(35e-3, np.radians(24), 1.98e-6), (45e-3, np.radians(12), 1.47e-7)]
)
def test_torque_stops_the_push_on_the_way_up_to_the_largest_moment(r, push, torque) -> None:
    """Past the peak of the moment, or the fold, the torque had been ignored."""
    peak = np.nanmax(ww.press(WHISKER, r, np.linspace(0, push, 2001)).moment)
    assert peak > torque
    row = along_whisk.limits(WHISKER, [r], push=push, torque=torque).iloc[0]
    assert row["stopped"]
    assert row["moment_micronewton_metre"] == pytest.approx(1e6 * torque, rel=1e-9)
    before = np.linspace(0, np.radians(row["deflection_angle_deg"]), 50)[:-1]
    assert np.all(np.asarray(ww.press(WHISKER, r, before).moment) < torque)


def test_angles_along_a_whisk_are_those_of_straight_whiskers() -> None:
    """A curved one, whose angles start where it lies, had JNDs of a negative moment."""
    curved = ww.Whisker.from_identity("C2", curved=True)
    for ask in (
        lambda: along_whisk.limits(curved, [20e-3]),
        lambda: along_whisk.resolution_along_push(curved, 20e-3, [0.1, 0.2]),
    ):
        with pytest.raises(ValueError, match=r"straight whisker is needed.*write curvature=0"):
            ask()
    with pytest.raises(ValueError, match="push must be"):
        along_whisk.limits(WHISKER, [20e-3], push=-0.1)


def test_friction_makes_a_reversal_jump_and_none_leaves_it_still() -> None:
    angles = np.radians([16.0, 24.0])
    at = along_whisk.bodies(25e-3, [5e-3])
    none = along_whisk.reversal(WHISKER, 25e-3, angles, friction_coefficient=0.0, objects=at)
    np.testing.assert_allclose(none["bias_mm"], 0.0, atol=1e-6)
    table = along_whisk.reversal(WHISKER, 25e-3, angles, objects=at)
    by = table.set_index(["object", "base", "direction"])
    assert (by.loc[("peg", "rotates", "let go"), "bias_mm"] > 0).all()
    assert (by.loc[("peg", "rotates", "pressed"), "bias_mm"] < 0).all()
    moved = by.loc[("peg", "translates", "pressed"), "radial_distance_mm"].to_numpy()
    np.testing.assert_allclose(moved, 25 / np.cos(angles), rtol=1e-9)
    # By hand, at a peg: what is felt with friction, taken for a contact without.
    bent = ww.press(WHISKER, 25e-3, angles, -np.arctan(0.3))
    felt = np.stack([bent.moment, bent.axial_force], axis=-1)
    off = 1e3 * ww.cues.ForceMap().contact(WHISKER, felt)[0][:, 0] - 25
    np.testing.assert_allclose(by.loc[("peg", "rotates", "pressed"), "bias_mm"], off, rtol=1e-4)
    # A base that moves on rolls the contact along a cylinder, inwards as one that turns does.
    for base in ("rotates", "translates"):
        there = by.loc[("cylinder, 5 mm", base, "pressed")]
        assert (np.diff(there["radial_distance_mm"]) < 0.1).all()
        assert (there["radial_distance_mm"] < 24).all()


def test_a_distance_that_is_none_is_refused_in_one_sentence() -> None:
    for made in (
        along_whisk.resolution_along_push, along_whisk.lateral_sweep, along_whisk.reversal
    ):  # fmt: skip
        with pytest.raises(ValueError, match="radial_distance must be above zero, got -1"):
            made(WHISKER, -1.0, [0.1])
        with pytest.raises(ValueError, match=r"must be on the whisker of 0.05 m, got 25; give met"):
            made(WHISKER, 25.0, [0.1])
        with pytest.raises(ValueError, match="straight whisker is needed"):
            made(ww.Whisker.from_identity("C2", curved=True), 20e-3, [0.1])
    with pytest.raises(ValueError, match=r"must be on the whisker of 0.05 m, got 25"):
        along_whisk.limits(WHISKER, [10e-3, 25.0])
    far = along_whisk.limits(WHISKER, [10e-3, 45e-3], push=2.0)
    assert far["outcome"].tolist() == ["HELD", "FLICKED_PAST"]
    assert far["weber_mm"].isna().tolist() == [False, True]


def test_speeds_and_limits_are_those_read_aloud() -> None:
    """Of the figures' whisker, of 3 GPa; what was written was of 3.34."""
    r = np.array([0.2, 0.5, 0.85]) * surveys.WHISKER.length
    found = along_whisk.speed(surveys.WHISKER, r, [8.0])
    assert found["one_percent_hz"].round(1).tolist() == [20.9, 13.2, 3.1]
    assert (100 * found["error_8Hz"]).round(1).tolist() == [0.1, 0.4, 6.7]
    assert found["first_frequency_hz"].iloc[2] == pytest.approx(72, abs=1)
    assert (1e3 * found["settled_s"]).round().tolist() == [5, 10, 21]
    row = along_whisk.limits(surveys.WHISKER, r[2]).iloc[0]
    assert row["threshold_mm"] / row["weber_mm"] == pytest.approx(1.4, abs=0.02)
