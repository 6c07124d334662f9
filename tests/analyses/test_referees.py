"""The short form of the table of referees, and what it must show."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load as load_script

referees = load_script("referees")
ERRORS = [
    "error_moment",
    "error_axial_force",
    "error_radial_distance",
    "error_deflection_angle",
]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("referees")
    made = referees.make(folder, short=True)
    assert {path.name for path in folder.iterdir()} == {"referees.csv", "referees.md"}
    assert len(pd.read_csv(folder / "referees.csv")) == len(made)
    return made


@pytest.mark.slow
def test_every_scene_has_its_models_and_referees(table):
    assert len(set(table["scene"])) == 7
    rows = table.groupby("scene")["method"].nunique()
    assert rows.min() >= 7
    assert (table["note"] == "").all()
    assert len(referees.summary(table).splitlines()) == 2 + len(table.groupby(["given", "method"]))


@pytest.mark.slow
def test_models_of_large_angles_meet_the_truth(table):
    """Near the fold a contact's signals go as the square root of its distance from it."""
    models = table[table["method"].isin(["elastica", "planar beam", "rod"])]
    assert (models.loc[models["given"] == "force", ERRORS] < 2e-10).all(axis=None)
    assert (models.loc[models["given"] == "contact", ERRORS] < 1e-9).all(axis=None)


@pytest.mark.slow
def test_the_closed_form_is_off_by_what_its_scenes_say(table):
    closed_form = table[(table["method"] == "closed form") & (table["given"] == "contact")]
    found = closed_form["error_moment"].to_numpy()
    assert found[0] < 0.01
    assert np.all(np.diff(found[:4]) > 0)


@pytest.mark.slow
def test_the_truth_is_that_of_the_elliptic_integrals_and_of_scipy(table):
    exact = table[table["method"] == "elliptic integrals"]
    assert len(exact) == 2
    assert (exact[ERRORS] < 1e-14 + 5e-15).all(axis=None)
    for method, error in (("SciPy DOP853, rtol 1e-10", 1e-9), ("SciPy solve_bvp, tol 1e-09", 1e-9)):
        rows = table[table["method"] == method]
        assert (rows[ERRORS] < error).all(axis=None)


def test_bisshopp_and_drucker_by_their_printed_slopes():
    for load, slope in ((1, 0.46135), (2, 0.78175), (5, 1.21537), (10, 1.43029)):
        assert round(referees.bisshopp_drucker_load(load)[1], 5) == slope


def test_a_missing_pyelastica_is_a_row_that_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(referees, "_version", lambda package: None)
    scene = referees.scenes()[0]
    missing = [name for _, name, method in referees.methods(scene, False) if method is None]
    assert missing == ["PyElastica, 60 elements", "PyElastica, 120 elements"]
    assert "pip install weberwhisk[referees]" in referees.NOT_INSTALLED
