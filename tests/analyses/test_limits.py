"""The short form of the limits of the methods, and what it must show."""

from __future__ import annotations

import numpy as np
import pytest
from analysis_scripts import load as load_script

import weberwhisk as ww

limits = load_script("limits")


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limits")
    made = limits.make(folder, short=True)
    assert {path.name for path in folder.iterdir()} == {"limits.csv", "limits.png"}
    return made


@pytest.mark.slow
def test_without_any_of_it_every_method_reads_the_truth(table):
    """The observers invert what they assume, with slope one: nothing but the factors is off."""
    plain = table[table["amount"] == 0]
    assert len(plain) == 3 * 8
    np.testing.assert_allclose(plain["inferred_over_true"], 1, atol=1e-5)
    np.testing.assert_allclose(plain["slope"], 1, atol=1e-3)


def test_the_jnds_are_those_of_the_package():
    """The map's by the package; one moment's and eight moments' by the closed form k·r(1 − r/A)."""
    w, r, k = limits.WHISKER, 15e-3, limits.WEBER_FRACTION
    observer = ww.Observer(w, ww.cues.ForceMap(), ww.receptors.Weber(k))
    found = np.ravel(ww.sensitivity.weber_propagation(observer, np.array([[r, limits.PUSH]])))[0]
    assert limits.jnd("force map", r) == pytest.approx(found, rel=1e-3)
    closed = k * r * (1 - r / w.apex_distance)
    assert limits.jnd("compliance", r) == pytest.approx(closed, rel=0.03)
    assert limits.jnd("sweeping", r) == pytest.approx(closed / np.sqrt(limits.SWEEP), rel=0.03)


@pytest.mark.slow
def test_moments_stay_useful_and_axial_force_does_not(table):
    """Even at the most of each factor, distances are told apart by moment with slope near one."""
    moment = table[table["method"].isin(["compliance", "sweeping", "balance of moments"])]
    assert moment["slope"].between(0.8, 1.25).all()
    pulled = table[(table["method"] == "force map") & (table["amount"] == -25.6)]
    assert pulled["inferred_over_true"].isna().all()
