"""Speed against accuracy: the tables' errors, and what a figure needs of them.

Times are measured by the charts and never asserted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from figure_checks import faults

import weberwhisk as ww

beams, charts, plots, script = (
    load(f"speed_accuracy.{name}") for name in ("beams", "chart", "plots", "make")
)


@pytest.fixture(scope="module")
def beam_table() -> pd.DataFrame:
    """Of two scenes: test_referees.py has the models beside all referees in seven."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(beams, "SCENES", beams.SCENES[::4])
        return beams.measure()


def test_the_truth_of_the_beams_is_that_of_the_referees() -> None:
    """Benchmark P70 of the theory notes: 60° at 0.7 L."""
    moment, axial, r, theta = beams.follow(35e-3, 8.755567343e-5, 4000)
    assert moment == pytest.approx(2.311081582e-6, rel=1e-9)
    assert axial == pytest.approx(7.582544e-5, rel=1e-6)
    b = ww.press(beams.WHISKER, r, theta)
    assert b.moment == pytest.approx(moment, rel=1e-10)


def test_every_rung_and_solver_is_as_good_as_its_knob(beam_table: pd.DataFrame) -> None:
    assert set(beam_table["scene"]) == {scene.name for scene in beams.SCENES[::4]}
    assert (beam_table["failed"] == 0).all()
    assert (beam_table["seconds"] > 0).all()
    worst = beam_table.groupby("method")["error"].max()
    assert worst["elastica"] < 1e-12
    fine = beam_table[beam_table["knob"] == 1e-9].groupby("method")["error"].max()
    assert (fine[["planar beam, one", "SciPy, solve_bvp"]] < 1e-9).all()
    assert fine["rod, one"] < 1e-8
    easy = beam_table[beam_table["scene"].str.startswith("easy")].set_index("method")["error"]
    assert easy["closed form"].max() < 0.01  # 0.1 JND at k = 0.1


def test_the_referee_of_posteriors_is_right_and_so_is_quadrature() -> None:
    for scene, observer in charts.OBSERVERS.items():
        rows = charts.readings(observer, 16)[:2]
        exact = charts.summed(
            observer, rows, 400 if len(observer.unknowns) > 1 else 4000, zoom=True
        )
        p = ww.posterior(observer, rows, tolerance=1e-4 if len(observer.unknowns) > 1 else None)
        good = p.status == ww.Status.CONVERGED
        assert good.any(), scene
        np.testing.assert_allclose(p.sd[good], exact[good], rtol=3e-3)


def test_fits_are_scored() -> None:
    row = charts.measure_tool("known", lambda trials: (0.11, 0.09, 0.12), 5, 3)
    assert row["error"] == pytest.approx(0.1)
    assert row["bias"] == pytest.approx(0.1)
    assert row["coverage"] == 1
    value, low, high = charts.TOOLS["quadrature"](ww.simulate_trials(weber_fraction=0.1, seed=1))
    assert low < value < high


def test_every_tool_fits_the_same_data_sets(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a quarter of them an RMSE looked 2 to 10 % lower than another's."""
    seen: dict[str, list[bytes]] = {}

    def tool(name: str) -> Any:
        def answer(trials: ww.behaviour.Trials) -> Any:
            seen.setdefault(name, []).append(trials.cells().count.tobytes())
            return (0.1 + 0.01 * len(seen[name]), 0.05, 0.2)

        return answer

    monkeypatch.setattr(charts, "TOOLS", {name: tool(name) for name in charts.TOOLS})
    table = charts.measure_fits(sets=5)
    assert table["count"].unique().tolist() == [5]
    assert "emcee" in seen
    assert all(sets == seen["quadrature"] for sets in seen.values())
    # A bar: of 10, …, 50 % the r.m.s. is 33 %, whose squares scatter by 10 % (ddof 1) over 2·33 %.
    off = np.arange(1, 6) / 10
    rmse = np.sqrt(np.mean(off**2))
    assert table["error"].to_numpy() == pytest.approx(rmse)
    expected = np.std(off**2, ddof=1) / np.sqrt(5) / (2 * rmse)
    assert table["error_se"].to_numpy() == pytest.approx(expected)


@pytest.mark.slow
def test_cubature_and_the_papers_interpolation_are_as_good_as_their_knobs(
    beam_table: pd.DataFrame,
) -> None:
    observer = charts.OBSERVERS["one unknown: r"]
    rows = charts.readings(observer, 4)[:2]
    exact = charts.summed(observer, rows, 4000, zoom=True)
    np.testing.assert_allclose(charts.by_cubature(observer, rows, 1e-6), exact, rtol=1e-5)
    two = charts.OBSERVERS["two: r, θ_d"]
    rows = charts.readings(two, 4)[:1]
    exact = charts.summed(two, rows, 400, zoom=True)
    np.testing.assert_allclose(charts.by_cubature(two, rows, 1e-2), exact, rtol=1e-2)
    cubic = beam_table[beam_table["method"].str.startswith("cubic")]
    error = cubic.pivot_table(index=["scene", "knob"], columns="method", values="error")
    linear, logarithmic = (error[name] for name in sorted(error.columns))
    assert np.all(logarithmic < linear)
    assert np.all(logarithmic.unstack()[1000.0] < logarithmic.unstack()[100.0])


@pytest.mark.slow
def test_jnd_curves_are_judged_by_their_own_truth() -> None:
    table = charts.measure_jnds()
    assert set(table["part"]) == {"jnds"}
    for _, rows in table.groupby("scene"):
        error = rows.groupby("method")["error"].min()
        methods = {"closed form", "Fisher information", "posteriors, quadrature",
                   "posteriors, emcee"}  # fmt: skip
        assert methods <= set(error.index)
        assert error["posteriors, quadrature"] < 0.02
        assert error["posteriors, emcee"] < 0.1
    # What the slope alone cannot know: with the angle unknown a reading allows many contacts.
    two = table[table["scene"].str.contains("map")].set_index("method")["error"]
    assert two["closed form"] > 0.1


@pytest.mark.slow
def test_the_kept_tables_are_drawn_so_that_they_can_be_read() -> None:
    kept = Path(__file__).parents[2] / "analyses" / "figures"
    tables = {name: pd.read_csv(kept / f"speed_accuracy_{name}.csv") for name in plots.FIGURES}
    styles = plots.styles_of(tables, set())
    for name, figure in plots.figures(tables, foot="a machine").items():
        assert faults(figure) == [], name
        methods: dict[str, set[str]] = {}
        for line, style in styles[name].items():
            method = line if name == "growth" else plots.method_of(line)
            methods.setdefault(style["color"], set()).add(method)
        assert all(len(of_colour) == 1 for of_colour in methods.values()), name


def test_the_chain_of_links_converges_as_their_length_squared() -> None:
    scene = beams.SCENES[0]
    errors = [script.chain(scene, links) / beams.truth(scene) - 1 for links in (20, 40, 80)]
    order = np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))
    np.testing.assert_allclose(order, 2, atol=0.1)
