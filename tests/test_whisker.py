import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import whisker


def test_geometry_and_scales():
    w = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
    assert w.radius_ratio == 20
    assert w.apex_distance == pytest.approx(50e-3 / (1 - 1 / 20), rel=1e-15)
    assert w.stiffness == pytest.approx(3e9 * np.pi / 4 * 1e-16, rel=1e-15)
    assert w.moment_scale == pytest.approx(w.stiffness / 50e-3, rel=1e-15)
    assert w.compliance_constant == pytest.approx(3 * w.stiffness, rel=1e-15)


def test_cylinder_and_cone_are_the_limits():
    w = ww.Whisker(50e-3, 100e-6, 5e-6)
    assert w.cylinder().apex_distance == np.inf
    cone = ww.Whisker(50e-3, 100e-6, 0.0)
    assert (cone.apex_distance, cone.radius_ratio) == (50e-3, np.inf)


def test_every_identity_makes_a_whisker():
    names = whisker.identities()
    assert len(names) == 30
    for name in names:
        w = ww.Whisker.from_identity(name)
        assert 5e-3 < w.length < 60e-3
        assert 0 < w.tip_radius <= w.base_radius < 100e-6


def test_c2_is_the_tables_mean():
    w = ww.Whisker.from_identity("C2")
    assert w.length == pytest.approx(33.6e-3)
    assert w.base_radius == pytest.approx(69.5e-6)
    assert w.tip_radius == pytest.approx(1.75e-6)


def test_draws_are_repeatable_and_have_the_tables_spread():
    one, two = (ww.Whisker.from_identity("C2", seed=3) for _ in range(2))
    assert (one.length, one.base_radius) == (two.length, two.base_radius)
    lengths = [ww.Whisker.from_identity("C2", seed=s).length for s in range(2000)]
    # The normal's sd, cut at ± 2.5 sd, is 0.976 of itself.
    assert np.std(lengths) == pytest.approx(0.976 * 2.5e-3, rel=0.06)
    assert np.mean(lengths) == pytest.approx(33.6e-3, abs=4 * 2.5e-3 / np.sqrt(2000))


def test_wild_spreads_still_make_whiskers():
    # C6 has a length of 7.3 ± 5.6 mm: a draw must not come out negative.
    for seed in range(200):
        assert ww.Whisker.from_identity("C6", seed=seed).length > 0


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"length": -1e-3}, "length must be above zero, got -0.001"),
        ({"length": 0}, "length must be above zero, got 0"),
        ({"length": np.nan}, "length must be finite, got nan"),
        ({"length": "long"}, "length must be a number, got 'long'"),
        ({"base_radius": [1e-4, -1e-4]}, "base_radius must be above zero, got -0.0001"),
        ({"tip_radius": -1e-6}, "tip_radius must not be negative, got -1e-06"),
        ({"tip_radius": 2e-4}, "tip must not be wider than the base"),
        ({"youngs_modulus": np.inf}, "youngs_modulus must be finite, got inf"),
        ({"density": 0}, "density must be above zero"),
        ({"curvature": np.nan}, "curvature must be finite"),
        ({"length": [1e-3, 2e-3], "base_radius": [1e-4] * 3}, "must broadcast together"),
    ],
)
def test_nonsense_is_refused_in_one_sentence(fields, words):
    good = {"length": 50e-3, "base_radius": 1e-4, "tip_radius": 5e-6}
    with pytest.raises(ValueError, match=words) as error:
        ww.Whisker(**(good | fields))
    assert str(error.value).count(". ") == 0
    assert str(error.value).endswith(".")


@pytest.mark.parametrize("curved", ["x", "no", 1, None])
def test_curved_is_yes_or_no(curved):
    with pytest.raises(ValueError, match="curved must be True or False, got "):
        ww.Whisker.from_identity("C2", curved=curved)


def test_unknown_identity_names_the_nearest():
    with pytest.raises(ValueError, match=r"whisker 'C22' is unknown \(did you mean 'C2'\?\)"):
        ww.Whisker.from_identity("C22")
