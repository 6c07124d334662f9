"""Figures: what is drawn is what was found, and the files are the same each time."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy import stats

import weberwhisk as ww
from weberwhisk import figures
from weberwhisk.commands import figure
from weberwhisk.figures import style

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)


def observer(cue: ww.cues.Cue | None = None) -> ww.Observer:
    return ww.Observer(WHISKER, cue or ww.cues.Compliance(), ww.receptors.Weber(0.1))


@pytest.fixture(scope="module")
def fit() -> ww.WeberFit:
    trials = ww.simulate_trials(
        weber_fraction=0.15, standards=[1.0, 2.0], trials_per_level=20, seed=3
    )
    return ww.fit_weber(trials)


def test_jnd_curve_draws_the_table_in_the_unit_asked_for() -> None:
    table = ww.jnd_curve(observer(), [10e-3, 30e-3], n_readings=20, seed=1).frame
    for options, x_unit, y_unit in (
        ({}, 1e-3, 1e-3),
        ({"length": 50e-3, "weber_fraction": 0.1}, 50e-3, 5e-3),
    ):
        ax = figures.jnd_lines({"one": table, "two": table}, **options)
        line = ax.get_lines()[0]
        np.testing.assert_allclose(line.get_xdata(), table["radial_distance"] / x_unit)
        np.testing.assert_allclose(line.get_ydata(), table["closed_form"] / y_unit)
        bars = ax.containers[0]
        np.testing.assert_allclose(bars.lines[0].get_ydata(), table["posterior"] / y_unit)
        (segments,) = [c.get_segments() for c in bars.lines[2]]
        lengths = [s[1, 1] - s[0, 1] for s in segments]
        np.testing.assert_allclose(lengths, 2 * 1.96 * table["posterior_error"] / y_unit)
        styles = {(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}
        assert len({colour for colour, _ in styles}) == 2
        assert ax.get_xlim()[0] == 0
        assert "d'=1" in ax.get_ylabel()


def test_jnd_curve_leaves_out_posteriors_that_are_not_there() -> None:
    table = ww.jnd_curve(observer(), [10e-3, 30e-3], n_readings=20, seed=1).frame
    table["posterior"] = np.nan
    assert figures.jnd_lines(table).containers == []


def test_jnd_surface_ends_where_the_whisker_flicks_past() -> None:
    r, share = np.linspace(0.1, 0.9, 9) * 50e-3, np.linspace(0.1, 1.0, 12)
    limit = np.asarray(ww.flick_past(WHISKER, r).deflection_angle)
    theta = limit[:, None] * share
    table = pd.DataFrame(
        {
            "radial_distance": np.repeat(r, 12),
            "deflection_angle": theta.ravel(),
            "jnd": (r[:, None] * (2 - share)).ravel() * 0.1,
        }
    )
    points = pd.DataFrame(
        {"radial_distance": [25e-3], "deflection_angle": [0.1], "posterior": 5e-3}
    )
    shuffled = table.sample(frac=1.0, random_state=1)
    ax = figures.jnd_surface(shuffled, length=50e-3, weber_fraction=0.1, points=points)
    edge = ax.get_lines()[0]
    np.testing.assert_allclose(edge.get_xdata(), r / 50e-3)
    np.testing.assert_allclose(edge.get_ydata(), np.degrees(limit))
    assert "flicked past" in [text.get_text() for text in ax.texts]
    assert "1.00" in [text.get_text() for text in ax.texts]


def test_psychometric_shows_choices_and_curve(fit: ww.WeberFit) -> None:
    with pytest.raises(ValueError, match="2 standards; name one, such as standard=1"):
        figures.psychometric(fit)
    ax = figures.psychometric(fit, standard=2.0)
    cells = fit.trials.cells().of(2.0)
    seen = ax.containers[0].lines[0]
    np.testing.assert_allclose(seen.get_xdata(), cells.stimulus_2)
    np.testing.assert_allclose(seen.get_ydata(), cells.count / cells.n)
    x, p = next(line.get_data() for line in ax.get_lines() if len(line.get_xdata()) > 100)
    expected = fit.psychometric(x, 2.0)["median"]
    np.testing.assert_allclose(p, expected, atol=1e-9)


def test_psychometrics_has_a_panel_for_each_standard(fit: ww.WeberFit) -> None:
    axes = figures.psychometrics(fit, unit="g")
    assert [ax.get_title() for ax in axes] == ["standard 1", "standard 2"]
    assert figures.figure_of(axes).get_supxlabel() == "Second stimulus (g)"


def test_psychometric_of_given_parameters_has_no_band(fit: ww.WeberFit) -> None:
    known = {"weber_fraction": 0.15, "lapse_low": 0.0, "lapse_high": 0.0, "bias": 0.0}
    exact = ww.fit_weber(fit.trials, priors=known)
    ax = figures.psychometric(exact, standard=1.0)
    legend = ax.get_legend()
    assert legend is not None
    assert [t.get_text() for t in legend.get_texts()] == ["given parameters", "choices, 95 %"]


def test_log_column_is_drawn_by_difference() -> None:
    table = pd.DataFrame(
        {"stimulus_1": [0.0, 1.0] * 20, "stimulus_2": [1.0, 0.0] * 20, "choice": [1, 0] * 20}
    )
    fit = ww.fit_weber(ww.read_trials(table, scale="log"))
    ax = figures.psychometric(fit)
    np.testing.assert_allclose(ax.containers[0].lines[0].get_xdata(), [1.0, -1.0])
    assert "log column" in ax.get_xlabel()


def test_binomial_intervals_are_jeffreys() -> None:
    count, n = np.array([0.0, 3.0, 10.0]), np.full(3, 10.0)
    low, high = figures.fits.binomial_interval(count, n)
    expected = stats.beta(count + 0.5, n - count + 0.5).interval(0.95)
    np.testing.assert_allclose([low[1], high[1]], [e[1] for e in expected])
    assert (low[0], high[2]) == (0, 1)
    assert low[2] < 1
    assert high[0] > 0


def test_bending_draws_a_line_for_each_contact_and_says_where_there_is_none() -> None:
    lines = ww.press(WHISKER, [[20e-3], [40e-3], [60e-3]], np.linspace(0.01, 0.5, 30))
    points = ww.press(WHISKER, [[20e-3], [40e-3], [60e-3]], [0.1, 0.2])
    axes = figures.bending(lines, points=points)
    assert [len(ax.get_lines()) for ax in axes] == [4, 4, 4]  # a line and its marks, twice
    x, y = axes[0].get_lines()[0].get_data()
    np.testing.assert_allclose(x, np.degrees(lines.deflection_angle[0]))
    np.testing.assert_allclose(y, lines.moment[0] * 1e6)
    nothing = figures.bending(ww.press(WHISKER, [[60e-3]], np.linspace(0.01, 0.5, 5)))
    assert [text.get_text() for text in nothing[1].texts] == ["no contact is held"]


@pytest.mark.parametrize("of", ["radial_distance", "deflection_angle"])
def test_posterior_shows_its_mean_and_interval(of: str) -> None:
    seen = observer(ww.cues.ForceMap())
    result = ww.posterior(seen, seen.read([35e-3, 0.2], seed=2))
    ax = figures.posterior_histogram(result, of=of)
    unit = {"radial_distance": 1e-3, "deflection_angle": np.pi / 180}[of]
    at = [line.get_xdata()[0] * unit for line in ax.get_lines()]
    np.testing.assert_allclose(at, [result.estimates[of].mean, *result.interval(of=of)])


def test_posterior_of_many_readings_is_refused() -> None:
    result = ww.posterior(observer(), observer().read(np.full((2, 1), 30e-3), seed=1))
    with pytest.raises(ValueError, match="got 2 readings; infer from one"):
        figures.posterior_histogram(result)


def test_figures_leave_the_users_style_alone(fit: ww.WeberFit, tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    ax = figures.psychometric(fit, standard=1.0)
    figures.figure_of(ax).savefig(tmp_path / "one.png")
    assert dict(matplotlib.rcParams) == before
    own = Figure().subplots()
    assert figures.psychometric(fit, own, standard=1.0) is own


def test_svg_files_are_repeatable(fit: ww.WeberFit, tmp_path: Path) -> None:
    for name in ("one.svg", "two.svg"):
        figure = figures.figure_of(figures.psychometrics(fit))
        figure.savefig(tmp_path / name, metadata={"Date": None})
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_png_has_enough_dots(fit: ww.WeberFit) -> None:
    assert figures.figure_of(figures.psychometric(fit, standard=1.0)).dpi >= 150


# The paper's figure 4a; figure 4b's numbers are in test_paper.py


@pytest.mark.parametrize(
    ("short", "close"), [(True, 0.2), pytest.param(False, 0.06, marks=pytest.mark.slow)]
)
def test_figure_4a(short: bool, close: float) -> None:
    curve = figure.figure_4a(figure.Asked(short=short)).tables["figure-4a"]
    tapered = curve[curve["whisker"] == "tapered"]
    r, apex = tapered["radial_distance_mm"], 50 / 0.95
    np.testing.assert_allclose(tapered["closed_form_mm"], 0.1 * r * (1 - r / apex), rtol=1e-9)
    # In full a twentieth: what the bend of the closed form over one sd makes of its slope.
    np.testing.assert_allclose(tapered["posterior_mm"], tapered["closed_form_mm"], rtol=close)
    assert (curve["unreliable"] == 0).all()


def test_residuals_outside_the_band_are_marked() -> None:
    table = pd.DataFrame({"session": [1, 2, 3], "z": [0.5, 2.5, -3.0]})
    ax = figures.residuals(table)
    marked = next(line for line in ax.get_lines() if line.get_label() == "outside")
    np.testing.assert_array_equal(marked.get_xdata(), [2, 3])
    np.testing.assert_array_equal(marked.get_ydata(), [2.5, -3.0])


@pytest.fixture(scope="module")
def population() -> ww.PopulationFit:
    trials, _ = ww.simulate_population(3, trials_per_level=6, spread=0.8, seed=2)
    return ww.fit_population(trials)


def test_shrinkage_shows_every_animal_twice_and_labels_apart(population: ww.PopulationFit) -> None:
    fit = population
    ax = figures.shrinkage(fit)
    table = fit.subjects.sort_values("alone")
    drawn = [bars.lines[0].get_xdata() for bars in ax.containers]
    np.testing.assert_allclose(drawn[0], table["alone"])
    np.testing.assert_allclose(drawn[1], table["weber_fraction"])
    figure = figures.figure_of(ax)
    figure.canvas.draw()
    boxes = [t.get_window_extent() for t in ax.get_xticklabels(which="both") if t.get_text()]
    boxes.sort(key=lambda box: box.x0)
    assert all(a.x1 < b.x0 for a, b in pairwise(boxes))


def test_names_that_no_font_shows_are_drawn(
    tmp_path: Path, population: ww.PopulationFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Missing glyphs warn, and warnings are errors here; a pair of dollars would be a formula."""
    names = ["\x1b[31mred\x07", "\U0001f400 鼠\u200b", r"a$\frac{$ " + 60 * "b"]
    monkeypatch.setitem(population.subjects, "subject", names)
    ax = figures.shrinkage(population)
    figures.figure_of(ax).savefig(tmp_path / "one.png")
    figures.figure_of(ax).savefig(tmp_path / "one.svg")
    drawn = {label.get_text() for label in ax.get_yticklabels()}
    assert {r"\x1b[31mred\x07", r"\U0001f400 \u9f20\u200b"} <= drawn
    assert max(map(len, drawn)) <= 26


def test_pairs_show_the_draws(fit: ww.WeberFit) -> None:
    grid = figures.pairs(fit)
    names = fit.parameters
    assert grid.shape == (len(names),) * 2
    assert not grid[0, 1].get_visible()
    x, y = grid[1, 0].get_lines()[0].get_data()
    assert (x > 0).all()
    assert abs(np.median(x) - fit.weber_fraction) < 0.2 * fit.posterior.sd("weber_fraction")
    assert (y >= 0).all()
    assert (y <= 1).all()
    assert not grid[0, 0].get_yticks().size


@pytest.mark.slow
def test_real_data_are_reported(tmp_path: Path) -> None:
    report = load("real_data").main(tmp_path, short=True).read_text("utf-8")
    assert "contraction against" in report
    assert "nan" not in report
    assert (tmp_path / "figures" / "real_data.png").stat().st_size > 10_000


def test_no_print_is_smaller_than_seven_points(population: ww.PopulationFit) -> None:
    """Of the style itself, and of what the figure modules ask for by number."""
    assert style.SMALL >= 7
    drawn = [figures.figure_of(figures.shrinkage(population)), figures.new_figure()]
    for one in drawn:
        one.canvas.draw()
        for text in one.findobj(Text):
            if text.get_text():
                assert text.get_fontsize() >= 6.9
    assert not [p for p in Path(style.__file__).parent.glob("*.py")
                if re.search(r"(fontsize|labelsize)=[0-6]\b", p.read_text("utf-8"))]  # fmt: skip
