"""The quickstart: one run on real input, and whether what it says is what it found."""

from __future__ import annotations

import contextlib
import io
import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww
from weberwhisk import cli
from weberwhisk._util.values import interval_text
from weberwhisk.behaviour import load_rat_auditory
from weberwhisk.behaviour.quadrature import QuadraturePosterior
from weberwhisk.cli import run_app
from weberwhisk.commands import quickstart
from weberwhisk.sensitivity import linear_surface

FIGURES = ("jnd_curve", "jnd_surface", "rat_psychometric")


@pytest.fixture(scope="module", params=[(37, 37), pytest.param((31, 37), marks=pytest.mark.slow)])
def run(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str, str]:
    """The output of a short run into the folder of its name, and what it printed."""
    there, out, err = tmp_path_factory.mktemp("quick"), io.StringIO(), io.StringIO()
    given = ["quickstart", "--identity", "D1", "--draws", "4"]
    with pytest.MonkeyPatch.context() as patched, contextlib.chdir(there):
        choices = partial(quickstart.rat_choices, sessions=request.param)
        patched.setattr(quickstart, "rat_choices", choices)
        patched.setattr(QuadraturePosterior.__init__, "__defaults__", (0, 1000, 4))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            assert run_app(cli.app, given) == 0
    return there / "quickstart", out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def folder(run: tuple[Path, str, str]) -> Path:
    return run[0]


@pytest.fixture(scope="module")
def numbers(folder: Path) -> dict:
    text = (folder / "quickstart.json").read_text("utf-8")
    return dict(json.loads(text, parse_constant=pytest.fail))


def test_it_leaves_every_file(folder: Path) -> None:
    record = json.loads((folder / "quickstart.run.json").read_text("utf-8"))
    made = {path.name for path in folder.iterdir()}
    assert made == {*record["files"], "quickstart.run.json"}
    for name in FIGURES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / f"{name}.svg").read_text("utf-8")


def test_the_curve_is_of_the_whisker_named(folder: Path, numbers: dict) -> None:
    whisker = ww.Whisker.from_identity("D1")
    table = pd.read_csv(folder / "jnd_curve.csv").set_index("whisker")
    for name, apex in (("tapered", whisker.apex_distance), ("cylinder", np.inf)):
        rows = table.loc[name]
        r = rows["radial_distance_mm"] * 1e-3
        np.testing.assert_allclose(rows["closed_form_mm"], 100 * r * (1 - r / apex), rtol=1e-9)
        # The same readings by both methods; emcee goes on to 2 % in each sd.
        np.testing.assert_allclose(
            rows["posterior_mm"], rows["posterior_by_quadrature_mm"], rtol=0.03
        )
        scale = whisker.length * 0.1 * 1e3
        np.testing.assert_allclose(
            numbers["jnd_curve"][name]["posterior"], rows["posterior_mm"] / scale
        )


def test_the_surface_falls_with_distance_and_deflection(numbers: dict) -> None:
    for falling in ("at_10_degrees", "at_0.7_length"):
        values = list(numbers["jnd_surface"][falling].values())
        assert np.all(np.diff(values) < 0)


def test_the_surface_is_the_small_angle_form_at_small_angles() -> None:
    whisker = ww.Whisker.from_identity("C2")
    table = linear_surface(quickstart.moment_dominated(whisker, 0.1), 20)
    first = table.groupby("radial_distance_mm").first()
    r, apex = 1e-3 * first.index.to_numpy(), whisker.apex_distance
    form = 0.1 * (apex - r) * (3 * apex - 2 * r) / (2 * apex - r)
    # Angles start at 0.3 % of the limit: what is left goes as their square.
    np.testing.assert_allclose(1e-3 * first["jnd_mm"], form, rtol=2e-3)
    limit = np.radians(table.groupby("radial_distance_mm")["deflection_angle_deg"].last())
    expected = ww.flick_past(whisker, r).deflection_angle
    np.testing.assert_allclose(limit, expected, rtol=1e-4)


def test_the_rat_is_the_one_shipped(folder: Path, numbers: dict) -> None:
    rat = numbers["rat"]
    first, last = rat["sessions"]
    trials = load_rat_auditory(range(first, last + 1))
    assert rat["data"]["n_trials"] == trials.n_trials
    fit = ww.fit_weber(trials, bias="per standard", seed=1)
    assert rat["weber_fraction"] == pytest.approx(fit.weber_fraction)
    assert [rat["lower"], rat["upper"]] == pytest.approx(list(fit.interval()))
    assert rat["holds"].startswith("What holds of this observer: the curve at every pair")
    if first == 31:  # that many sessions show more
        assert "What does not: answers that scatter by chance alone" in rat["holds"]
        assert "The answers show streaks" in rat["holds"]
    choices = pd.read_csv(folder / "rat_choices.csv")
    assert choices["n"].sum() == trials.n_trials
    assert rat["lower"] < rat["weber_fraction"] < rat["upper"]
    assert (folder / "rat_report.txt").read_text("utf-8") in (folder / "quickstart.txt").read_text(
        "utf-8"
    )


def test_the_text_says_what_was_found(folder: Path, numbers: dict) -> None:
    text = " ".join((folder / "quickstart.txt").read_text("utf-8").split())
    rat, curve = numbers["rat"], numbers["jnd_curve"]
    for words in (
        f"{rat['data']['n_trials']} choices",
        interval_text(rat["weber_fraction"], rat["lower"], rat["upper"]),
        f"{curve['tapered']['within_95_percent']} of 10 tapered points",
        "psytrack package",
        "unit is not published",
        "Belli",
    ):
        assert words in text
    assert "nan" not in text


def test_it_says_on_the_terminal_what_it_wrote(run: tuple[Path, str, str]) -> None:
    folder, out, err = run
    assert all("left" in line for line in err.splitlines())  # progress, on a slow machine
    assert (folder / "quickstart.txt").read_text("utf-8") in out
    assert f"Written to {folder}: " in out
    assert "D1 whisker" in out
