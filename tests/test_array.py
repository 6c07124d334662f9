"""Arrays of whiskers: where they stand, and where an object is that some of them touch."""

from __future__ import annotations

import csv
from importlib import resources

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.array import ROLL, WhiskerArray, published
from weberwhisk.mechanics.shape import Spiral

# C2 by hand, from the equations as printed, with r = 3 and c = 3.
C2 = {
    "rat": (-8.4, 2.51, 6.7432, 27.845, 0.012784, 61.5887, 9.2904, 32.6626),
    "mouse": (-6.1, 5.9, 4.43537, 13.058, 0.014743, 79.4758, 16.1, 45.118),
}


def measured(species: str) -> list[tuple[str, float, float]]:
    """Identity, arc length (mm) and the coefficient of the parabola through the measured shape."""
    path = resources.files("weberwhisk").joinpath("data/whisker_curvature.csv")
    out = []
    for row in csv.DictReader(path.read_text("utf-8").splitlines()):
        if row["species"].lower() == species:
            name = f"{'ABCDE'[int(row['row']) - 1]}{int(row['column']) - 1}"
            length = float(row["arc_length_mm"])
            bow = Spiral(float(row["B_per_mm"]), float(row["A_per_mm2"]))
            x, z = bow.point(np.linspace(0.0, length, 200))
            out.append((name, length, float(np.sum(z * x**2) / np.sum(x**4))))
    return out


@pytest.mark.parametrize("species", ["rat", "mouse"])
def test_c2_is_row_3_column_3_of_every_equation(species: str) -> None:
    np.testing.assert_allclose(published("C2", species), C2[species], rtol=2e-4)


@pytest.mark.parametrize(("species", "median"), [("rat", -0.01), ("mouse", -0.07)])
def test_columns_count_from_one_at_the_greek_arc(species: str, median: float) -> None:
    """Arc lengths agree in the median so, and are a fifth or more off with any other count."""
    table = [row for row in measured(species) if row[0][1] != "0" and row[0] != "E1"]
    off = [np.log(n / published(name, species).arc_length) for name, n, _ in table]
    one_less = [f"{name[0]}{int(name[1]) - 1}" for name, _, _ in table]
    other = [np.log(row[1] / published(name, species).arc_length)
             for row, name in zip(table, one_less, strict=True)]  # fmt: skip
    assert abs(np.median(off) - median) < 0.06
    assert np.std(off) < 0.22
    assert np.median(other) < -0.2


@pytest.mark.parametrize("species", ["rat", "mouse"])
def test_published_coefficients_are_twice_the_measured_ones(species: str) -> None:
    ratio = [a / published(name, species).coefficient for name, _, a in measured(species)]
    assert 0.44 < np.median(ratio) < 0.56


def test_base_diameters_of_the_rat_follow_their_equation_with_columns_from_zero() -> None:
    path = resources.files("weberwhisk").joinpath("data/whisker_morphology.csv")
    off = {0: [], 1: []}
    for row in csv.DictReader(path.read_text("utf-8").splitlines()):
        length, r = float(row["length_mm"]), "ABCDE".index(row["row"]) + 1
        for start, found in off.items():
            said = 0.041 + 0.002 * length + 0.011 * r - 0.0039 * (int(row["column"]) + start)
            found.append(float(row["base_diameter_um"]) * 1e-3 - said)
    assert abs(np.mean(off[0])) < 0.002 < abs(np.mean(off[1]))


@pytest.mark.parametrize("species", ["rat", "mouse"])
def test_base_points_have_their_mean_at_the_origin(species: str) -> None:
    whiskers = WhiskerArray(species).whiskers.values()
    assert np.abs(np.mean([w.base for w in whiskers], axis=0)).max() < 0.4e-3


def test_sides_are_mirror_images() -> None:
    array = WhiskerArray("rat", curved=True).protract(0.3)
    for name in array.identities:
        left, right = array.whiskers[f"left {name}"], array.whiskers[f"right {name}"]
        np.testing.assert_array_equal(left.base, right.base * [-1, 1, 1])
        np.testing.assert_array_equal(left.direction, right.direction * [-1, 1, 1])
        place = np.array([12e-3, 9e-3])
        np.testing.assert_array_equal(left.in_plane(place * [-1, 1]), right.in_plane(place))


def test_a_pole_is_met_where_the_base_tangent_crosses_it() -> None:
    rng = np.random.default_rng(1)
    r, angle = rng.uniform(1e-3, 40e-3, 50), rng.uniform(-1.5, 1.5, 50)
    for whisker in WhiskerArray("mouse").protract(0.4).whiskers.values():
        found = whisker.in_plane(whisker.place(r, angle))
        np.testing.assert_allclose(found, (r, angle), rtol=1e-9, atol=1e-12)
        # By vectors: the point in the plane of tangent and horizontal at that angle is over it.
        flat = np.array([*whisker.direction[:2], 0.0]) / np.cos(whisker.elevation)
        behind = whisker.mirror * np.array([-flat[1], flat[0], 0.0]) * -1.0
        tip = np.cos(angle)[:, None] * whisker.direction + np.sin(angle)[:, None] * behind
        np.testing.assert_allclose(
            (whisker.base + r[:, None] * tip)[:, :2], whisker.place(r, angle), atol=1e-12
        )


def test_protraction_turns_rostrally_and_rolls_by_row() -> None:
    rest, forward = WhiskerArray("rat", "right"), WhiskerArray("rat", "right").protract(0.5)
    for name, before in rest.whiskers.items():
        after = forward.whiskers[name]
        assert after.direction[1] > before.direction[1]
        assert after.swept == 0.5
        assert np.isclose(after.roll - before.roll, 0.5 * ROLL["ABCDE".index(name[0])])
    assert rest.protract(0.2).protract(0.3) == forward
    assert rest.only(["C2"]).whiskers.keys() == {"C2"}


def test_curvature_in_the_plane_of_whisking_falls_with_roll() -> None:
    array = WhiskerArray("rat", "right", curved=True, identities=["C0", "C4"])
    at_base = {n: float(w.whisker.law(np.array(0.0))) for n, w in array.whiskers.items()}
    assert np.isclose(at_base["C0"], -5.309 * np.cos(np.radians(9.18575)))
    assert np.isclose(at_base["C4"], -8.06 * np.cos(np.radians(56.13935)))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: ww.WhiskerArray("cat"), "species 'cat' is unknown"),
        (lambda: ww.WhiskerArray(sides="top"), "sides 'top' is unknown"),
        (lambda: ww.WhiskerArray(identities=["C9"]), "'C9' is unknown"),
        (lambda: ww.WhiskerArray(protraction=np.nan), "protraction must be finite"),
        (lambda: published("C2", "cat"), "species 'cat' is unknown"),
    ],
)
def test_what_there_is_not_is_refused(make, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()
