"""Figures: what is drawn is what was found, and the files are the same each time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load
from figure_checks import faults
from matplotlib.figure import Figure
from scipy import stats

import weberwhisk as ww
from weberwhisk import design, plots
from weberwhisk.behaviour.quadrature import QuadraturePosterior
from weberwhisk.sensitivity import linear_surface

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)


def observer(cue: ww.cues.Cue | None = None) -> ww.Observer:
    return ww.Observer(WHISKER, cue or ww.cues.Compliance(), ww.receptors.Weber(0.1))


@pytest.fixture(scope="module")
def fit() -> ww.behaviour.WeberFit:
    trials = ww.simulate_trials(
        weber_fraction=0.15, standards=[1.0, 2.0], trials_per_level=20, seed=3
    )
    return ww.fit_weber(trials)


def test_jnd_curve_draws_the_table_in_the_unit_asked_for() -> None:
    table = ww.jnd_curve(observer(), [10e-3, 30e-3], n_readings=20, seed=1).table
    for options, x_unit, y_unit in (
        ({}, 1.0, 1.0),
        ({"length": 50e-3, "weber_fraction": 0.1}, 50.0, 5.0),
    ):
        ax = plots.jnd_lines({"one": table, "two": table}, **options)
        line = ax.get_lines()[0]
        np.testing.assert_allclose(line.get_xdata(), table.index / x_unit)
        np.testing.assert_allclose(line.get_ydata(), table["closed_form_mm"] / y_unit)
        bars = ax.containers[0]
        np.testing.assert_allclose(bars.lines[0].get_ydata(), table["posterior_mm"] / y_unit)
        (segments,) = [c.get_segments() for c in bars.lines[2]]
        lengths = [s[1, 1] - s[0, 1] for s in segments]
        np.testing.assert_allclose(lengths, 2 * 1.96 * table["posterior_error_mm"] / y_unit)
        styles = {(line.get_color(), line.get_linestyle()) for line in ax.get_lines()}
        assert len({colour for colour, _ in styles}) == 2
        assert ax.get_xlim()[0] == 0
        assert "d'=1" in ax.get_ylabel()


def test_a_posterior_that_is_not_there_says_so_and_three_signals_need_three_axes() -> None:
    ax = plots.posteriors(ww.posterior(observer(), [np.nan]))
    assert "no posterior" in ax.texts[0].get_text()
    with pytest.raises(ValueError, match="of 'distance' is unknown"):
        plots.posteriors(ww.posterior(observer(), [1e-5]), of="distance")
    bent = ww.press(WHISKER, [10e-3, 20e-3], 0.1)
    with pytest.raises(ValueError, match="give three axes"):
        plots.bending(bent, ax)
    with pytest.raises(ValueError, match="against 'arc_length' is unknown"):
        plots.bending(bent, against="arc_length")
    assert "10 to 20 mm" in str(plots.bending(bent)[0].get_lines()[0].get_label())


def test_jnd_surface_ends_where_the_whisker_flicks_past() -> None:
    r, share = np.linspace(0.1, 0.9, 9) * 50e-3, np.linspace(0.1, 1.0, 12)
    limit = np.asarray(ww.flick_past(WHISKER, r).deflection_angle)
    theta = limit[:, None] * share
    table = pd.DataFrame(
        {
            "radial_distance_mm": 1e3 * np.repeat(r, 12),
            "deflection_angle_deg": np.degrees(theta.ravel()),
            "jnd_mm": (1e3 * r[:, None] * (2 - share)).ravel() * 0.1,
        }
    )
    shuffled = table.sample(frac=1.0, random_state=1)
    ax = plots.jnd_surface(shuffled, length=50e-3, weber_fraction=0.1)
    edge = ax.get_lines()[0]
    np.testing.assert_allclose(edge.get_xdata(), r / 50e-3)
    np.testing.assert_allclose(edge.get_ydata(), np.degrees(limit))
    assert "flicked past" in [text.get_text() for text in ax.texts]


def test_psychometric_shows_choices_and_curve(fit: ww.behaviour.WeberFit) -> None:
    own = Figure().subplots()
    with pytest.raises(ValueError, match="2 standards and 1 axes; name one, such as standard=1"):
        plots.psychometrics(fit, own)
    (ax,) = plots.psychometrics(fit, own, standard=2.0)
    assert ax is own
    cells = fit.trials.cells().of(2.0)
    seen = ax.containers[0].lines[0]
    np.testing.assert_allclose(seen.get_xdata(), cells.stimulus_2)
    np.testing.assert_allclose(seen.get_ydata(), cells.count / cells.n)
    x, p = next(line.get_data() for line in ax.get_lines() if len(line.get_xdata()) > 100)
    expected = fit.psychometric(x, 2.0)["median"]
    np.testing.assert_allclose(p, expected, atol=1e-9)


def test_psychometrics_has_a_panel_for_each_standard(fit: ww.behaviour.WeberFit) -> None:
    axes = plots.psychometrics(fit, unit="g")
    assert [ax.get_title() for ax in axes] == ["standard 1 g", "standard 2 g"]
    assert plots.figure_of(axes).get_supxlabel() == "Second stimulus (g)"


def test_binomial_intervals_are_jeffreys() -> None:
    count, n = np.array([0.0, 3.0, 10.0]), np.full(3, 10.0)
    low, high = plots.choices.binomial_interval(count, n)
    expected = stats.beta(count + 0.5, n - count + 0.5).interval(0.95)
    np.testing.assert_allclose([low[1], high[1]], [e[1] for e in expected])
    assert (low[0], high[2]) == (0, 1)
    assert low[2] < 1
    assert high[0] > 0


def test_bending_draws_a_line_for_each_contact_and_says_where_there_is_none() -> None:
    lines = ww.press(WHISKER, [[20e-3], [40e-3], [60e-3]], np.linspace(0.01, 0.5, 30))
    points = ww.press(WHISKER, [[20e-3], [40e-3], [60e-3]], [0.1, 0.2])
    axes = plots.bending(lines, points=points)
    assert [len(ax.get_lines()) for ax in axes] == [4, 4, 4]  # a line and its marks, twice
    x, y = axes[0].get_lines()[0].get_data()
    np.testing.assert_allclose(x, np.degrees(lines.deflection_angle[0]))
    np.testing.assert_allclose(y, lines.moment[0] * 1e6)
    nothing = plots.bending(ww.press(WHISKER, [[60e-3]], np.linspace(0.01, 0.5, 5)))
    assert [text.get_text() for text in nothing[1].texts] == ["no contact is held"]


@pytest.mark.parametrize("of", ["radial_distance", "deflection_angle"])
def test_posterior_shows_its_mean_and_interval(of: str) -> None:
    seen = observer(ww.cues.ForceMap())
    result = ww.posterior(seen, seen.read([35e-3, 0.2], seed=2))
    ax = plots.posteriors(result, of=of)
    unit = {"radial_distance": 1e-3, "deflection_angle": np.pi / 180}[of]
    at = [line.get_xdata()[0] * unit for line in ax.get_lines()]
    np.testing.assert_allclose(at, [result.estimates[of].mean, *result.interval(of=of)])


def test_figures_leave_the_users_style_alone(fit: ww.behaviour.WeberFit, tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    axes = plots.psychometrics(fit)
    plots.figure_of(axes).savefig(tmp_path / "one.png")
    assert dict(matplotlib.rcParams) == before


def test_svg_files_are_repeatable(fit: ww.behaviour.WeberFit, tmp_path: Path) -> None:
    for name in ("one.svg", "two.svg"):
        figure = plots.figure_of(plots.psychometrics(fit))
        figure.savefig(tmp_path / name, metadata={"Date": None})
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


@pytest.fixture(scope="module")
def population() -> ww.behaviour.PopulationFit:
    trials, _ = ww.simulate_population(3, trials_per_level=6, spread=0.8, seed=2)
    return ww.fit_population(trials, bias="none")


def test_names_that_no_font_shows_are_drawn(
    tmp_path: Path, population: ww.behaviour.PopulationFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Missing glyphs warn, and warnings are errors here; a pair of dollars would be a formula."""
    names = ["\x1b[31mred\x07", "\U0001f400 鼠\u200b", r"a$\frac{$ " + 60 * "b"]
    monkeypatch.setitem(population.subjects, "subject", names)
    ax = plots.shrinkage(population)
    plots.figure_of(ax).savefig(tmp_path / "one.png")
    plots.figure_of(ax).savefig(tmp_path / "one.svg")
    drawn = {label.get_text() for label in ax.get_yticklabels()}
    assert {r"\x1b[31mred\x07", r"\U0001f400 \u9f20\u200b"} <= drawn
    assert max(map(len, drawn)) <= 26


@pytest.mark.slow
def test_real_data_are_reported(tmp_path: Path) -> None:
    report = load("real_data").main(tmp_path, short=True).read_text("utf-8")
    assert "contraction against" in report
    assert "nan" not in report
    assert (tmp_path / "figures" / "real_data.png").stat().st_size > 10_000


@pytest.fixture(scope="module")
def drawn(
    fit: ww.behaviour.WeberFit, population: ww.behaviour.PopulationFit
) -> Iterator[dict[str, Any]]:
    """Every figure of the package, of small tables and few draws."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(QuadraturePosterior.__init__, "__defaults__", (0, 1000, 4))
        yield every_figure(fit, population)


def every_figure(
    fit: ww.behaviour.WeberFit, population: ww.behaviour.PopulationFit
) -> dict[str, Any]:
    tap, force_map = observer(), observer(ww.cues.ForceMap())
    moment_alone = ww.Observer(WHISKER, ww.cues.ForceMap(), ww.receptors.Weber([0.1, 1e-9]))
    contacts = np.stack([np.linspace(5e-3, 45e-3, 9), np.full(9, 0.1)], axis=-1)
    one = ww.posterior(tap, tap.read(30e-3, seed=1))
    many = ww.posterior(tap, tap.read(contacts[:, :1], seed=1))
    lines = ww.press(WHISKER, [[20e-3], [30e-3], [40e-3]], np.linspace(0.01, 0.5, 30))
    b = ww.press(WHISKER, contacts[:, 0], contacts[:, 1])
    table = pd.DataFrame({"moment_uNm": b.moment * 1e6, "axial_force_uN": b.axial_force * 1e6})
    plan = ww.plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=16)
    scheme, hypotheses = plan.scheme, plan.hypotheses
    placer = design.BayesianPlacer(hypotheses[0], scheme, seed=1)
    for i in range(12):
        trial = placer.next()
        placer.record(trial.standard, trial.comparison, i % 3 > 0)
    compared = pd.DataFrame(
        {"log_bayes_factor": [0.0, -2.1], "elpd_difference": [0.0, -1.2],
         "difference_se": [0.0, 1.5]}, index=["lapses", "no lapses"],
    )  # fmt: skip
    studied = pd.DataFrame(
        {"truth": ["tapered", "cylindrical"] * 3, "log_bayes_factor": np.linspace(-1, 6, 6)}
    )
    engaged = SimpleNamespace(
        engagement=pd.DataFrame({"session": [1] * 20 + [2] * 20, "engaged": np.linspace(0, 1, 40)}),
        share_engaged=lambda: (0.5, 0.4, 0.6),
    )
    whiskers = ww.WhiskerArray("rat", "right").protract(np.radians(40))
    all_of_them = ww.ArrayObserver(whiskers)
    touching = all_of_them.read([20e-3, 5e-3], seed=1)
    at = np.repeat([10.0, 20.0, 30.0, 40.0], 4)
    slopes = pd.DataFrame(
        {"radial_distance_mm": at,
         "moment_rate": observer().read(at[:, None] / 1e3, seed=1)[:, 0]}
    )  # fmt: skip
    answers, _ = ww.simulate_population(2, standards=[0.015, 0.025], trials_per_level=6, seed=1)
    return {
        "analysed": design.analyse(answers, hypotheses[:1]).plot(),
        "bending": plots.bending(lines),
        "calibrated": plots.calibrated(ww.calibrate(slopes, WHISKER, draws=1000)),
        "comparison": plots.comparison(SimpleNamespace(table=compared)),  # type: ignore[arg-type]
        "engagement": plots.engagement(engaged),  # type: ignore[arg-type]
        "jnd_lines": plots.jnd_lines(
            ww.jnd_curve(force_map, contacts[::3, :1], [0.1, 0.2], n_readings=4, seed=1)
        ),
        "jnd_surface": plots.jnd_surface(
            linear_surface(moment_alone, 20), length=50e-3, weber_fraction=0.1
        ),
        "located": plots.located(ww.locate(table, replace(WHISKER, curvature=0.0))),
        "place": plots.place(ww.place(all_of_them, touching)),
        "placements": plots.placements(placer),
        "planned_jnds": plots.planned_jnds(plan),
        "planned power": plots.power_curve(plan),
        "planned_psychometrics": plots.planned_psychometrics(plan),
        "population": plots.population(population),
        "one posterior": plots.posteriors(one),
        "posteriors": plots.posteriors(many),
        "power_curve": plots.power_curve(
            ww.power(scheme, hypotheses, trials=[5, 10], runs=16, seed=1)
        ),
        "psychometrics at one standard": plots.psychometrics(fit, standard=1.0),
        "psychometrics": plots.psychometrics(fit),
        "rehearsed": plots.rehearsed(SimpleNamespace(goal=plan.goal, runs=studied)),  # type: ignore[arg-type]
        "residuals": plots.residuals(pd.DataFrame({"session": [1, 2, 3], "z": [0.5, 2.5, -3]})),
        "shrinkage": plots.shrinkage(population),
        "whisker_array": plots.whisker_array(whiskers),
    }  # fmt: skip


def test_every_figure_can_be_read(drawn: dict[str, Any]) -> None:
    """No print under 7 pt at two columns' width, no text over text or cut, no legend over data."""
    no_figures = {"COLOURS", "DOUBLE", "LINES", "MARKERS", "SINGLE", "figure_of", "new_figure",
                  "shown", "styled"}  # fmt: skip
    assert set(plots.__all__) - no_figures <= set(drawn)
    found = {
        name: faults(one if isinstance(one, Figure) else plots.figure_of(one))
        for name, one in drawn.items()
    }
    assert {name: bad for name, bad in found.items() if bad} == {}


def test_what_cannot_be_read_is_found() -> None:
    one = plots.new_figure()
    ax = one.subplots()
    ax.plot([0, 1], [0, 1], label="a line")
    ax.legend(loc="upper right")
    ax.text(0.2, 0.5, "first")
    ax.text(0.22, 0.51, "second")
    ax.text(0.1, 0.1, "small", fontsize=6)
    ax.text(0.9, 0.2, "far beyond the edge", clip_on=False).set_in_layout(False)
    assert {text.split(" ", 1)[-1] for text in faults(one)} == {
        "has 6.0 pt", "is over 'second'", "beyond the edge' leaves the figure",
        "legend of '' is over a line",
    }  # fmt: skip


def test_a_fit_is_drawn_with_the_columns_of_its_table() -> None:
    own = {"stimulus_1": "reference", "stimulus_2": "weight_g", "choice": "heavier"}
    table = ww.simulate_trials(trials_per_level=3, seed=1).table().rename(columns=own)
    trials = ww.read_trials(table, columns=own).select(session=1)
    figure = plots.figure_of(plots.psychometrics(ww.fit_weber(trials)))
    assert figure.get_supxlabel() == "weight_g"
    assert figure.get_supylabel() == "heavier: second reported greater"


# -- figures of real size --------------------------------------------------------------------------


def many_stimuli(standards: int, trials: int = 2000) -> ww.behaviour.WeberFit:
    """A table in which no stimulus is shown twice."""
    rng = np.random.default_rng(1)
    first = np.geomspace(1.0, 20.0, standards)[np.arange(trials) % standards]
    second = first * np.exp(rng.normal(0, 0.25, trials))
    greater = rng.random(trials) < stats.norm.cdf((second - first) / 0.12 / np.hypot(first, second))
    table = pd.DataFrame(
        {
            "stimulus_1": first,
            "stimulus_2": second,
            "choice": greater.astype(int),
            "standard": first,
        }
    )
    return ww.fit_weber(ww.read_trials(table))


def test_thousands_of_stimuli_are_drawn_in_bins(tmp_path: Path) -> None:
    """They were a black block of bars, and a file of some megabytes."""
    fit = many_stimuli(1)
    (ax,) = plots.psychometrics(fit)
    seen = ax.containers[0]
    assert len(seen.lines[0].get_xdata()) == 20
    assert seen.get_label() == "choices in bins, 95 %"
    x = seen.lines[0].get_xdata()
    assert (np.diff(x) > 0).all()
    shares = np.asarray(seen.lines[0].get_ydata())
    cells = fit.trials.cells()
    assert shares.mean() == pytest.approx(cells.count.sum() / cells.n.sum(), abs=0.01)
    figure = plots.figure_of(ax)
    assert faults(figure) == []
    figure.savefig(tmp_path / "one.svg")
    assert (tmp_path / "one.svg").stat().st_size < 150_000


def test_more_standards_than_panels_are_drawn_in_groups() -> None:
    fit = many_stimuli(500)
    axes = plots.psychometrics(fit)
    assert len(axes) == 4
    assert axes[0].get_title().startswith("standards 1 to ")
    figure = plots.figure_of(axes)
    assert figure.get_supxlabel() == "Second stimulus / first"
    assert faults(figure) == []
    # What the fit expects lies within the bars of nearly all bins.
    for ax in axes:
        bars = ax.containers[0]
        (segments,) = (c.get_segments() for c in bars.lines[2])
        low, high = np.array([(s[0, 1], s[1, 1]) for s in segments]).T
        curve = ax.get_lines()[0].get_ydata()
        assert np.mean((low <= curve) & (curve <= high)) > 0.8
    (one,) = plots.psychometrics(fit, Figure().subplots())
    assert one.get_xlabel() == "Second stimulus / first"
    with pytest.raises(ValueError, match="standard 33 has no answers to draw; choose one of"):
        plots.psychometrics(fit, standard=33)


def test_bins_hold_as_many_trials_each_and_equal_places_together() -> None:
    x = np.array([1.0, 1.0 + 1e-13, 2.0, 3.0, 4.0, 4.0])
    group = plots.choices._bins(x, np.array([1.0, 1, 2, 2, 1, 1]), 2)
    assert group.tolist() == [0, 0, 0, 1, 1, 1]
    assert plots.choices._bins(x, np.ones(6), 100).tolist() == [0, 0, 1, 2, 3, 3]


@pytest.mark.parametrize("animals", [30, pytest.param(100, marks=pytest.mark.slow)])
def test_populations_of_many_animals_can_be_read(
    animals: int, population: ww.behaviour.PopulationFit
) -> None:
    rng = np.random.default_rng(1)
    (fit, *_), (row, *_) = population.fits.values(), population.subjects.to_dict("records")
    shift = np.exp(rng.normal(0, 0.3, animals))
    columns = [c for c in population.subjects if c not in ("subject", "n", "status")]
    subjects = pd.DataFrame([row] * animals).assign(subject=[f"rat {i}" for i in range(animals)])
    subjects[columns] = subjects[columns].mul(shift, axis=0)
    many = SimpleNamespace(
        fits=dict.fromkeys(subjects["subject"], fit), subjects=subjects,
        interval=population.interval,
    )  # fmt: skip
    for axes in (plots.population(many), plots.shrinkage(many)):  # type: ignore[arg-type]
        figure = plots.figure_of(axes)
        assert faults(figure) == []
        assert figure.get_figheight() < 9.5
        named = [t for t in np.ravel([axes])[-1].get_yticklabels() if "rat" in t.get_text()]
        assert len(named) == (animals if animals == 30 else 0)


def test_thousands_of_readings_are_a_band_and_dots(tmp_path: Path) -> None:
    tap = observer()
    places = np.random.default_rng(1).uniform(5e-3, 45e-3, (2000, 1))
    ax = plots.posteriors(ww.posterior(tap, tap.read(places, seed=1)))
    assert not ax.containers
    assert len(ax.get_lines()[0].get_xdata()) == 2000
    figure = plots.figure_of(ax)
    assert faults(figure) == []
    figure.savefig(tmp_path / "one.svg")
    assert (tmp_path / "one.svg").stat().st_size < 400_000


def test_swapped_pairs_are_drawn_where_they_are_as_hard_to_tell() -> None:
    """They were put at an equal ratio of millimetres, while the curve is of signals."""
    encoding = ww.behaviour.CueEncoding(observer(), unit=1e-3)
    trials = ww.simulate_trials(standards=[15.0], offsets=[-0.3, 0.4], encoding=encoding,
                                order="random", trials_per_level=20, seed=1)  # fmt: skip
    fit = ww.fit_weber(trials, encoding=encoding)
    (ax,) = plots.psychometrics(fit)
    (marks,) = (c.lines[0] for c in ax.containers)
    cells = fit.trials.cells()
    task, k = fit.trials.task, fit.weber_fraction

    def chance(first: Any, second: Any) -> Any:
        p = ww.behaviour.response_probability(task, encoding, first, second, weber_fraction=k)
        return np.asarray(p)

    places = np.sort(marks.get_xdata())
    expected = np.sort(chance(cells.stimulus_1, cells.stimulus_2))
    np.testing.assert_allclose(chance(np.full(places.size, 15.0), places), expected, atol=2e-4)
    at_ratio = np.sort(15 * cells.stimulus_2 / cells.stimulus_1)
    assert np.abs(places - at_ratio).max() > 0.3
    assert "of equal d′" in ax.get_xlabel() + plots.figure_of(ax).get_supxlabel()


def test_numbers_on_axes_are_as_people_write_them() -> None:
    fit = ww.fit_weber(ww.simulate_trials(standards=[1200, 12000], trials_per_level=8, seed=1))
    axes = plots.psychometrics(fit, unit="ms")
    figure = plots.figure_of(axes)
    assert faults(figure) == []
    assert [ax.get_title() for ax in axes] == ["standard 1200 ms", "standard 12000 ms"]
    shown = [label.get_text() for ax in axes for label in ax.get_xticklabels()]
    assert not any("e" in text for text in shown)


def test_axes_are_named_after_what_is_on_them() -> None:
    def labels(fit: ww.behaviour.WeberFit) -> tuple[str, str]:
        figure = plots.figure_of(plots.psychometrics(fit))
        return figure.get_supxlabel(), figure.get_supylabel()

    few: Any = {"trials_per_level": 4, "seed": 1}
    assert labels(ww.fit_weber(ww.simulate_trials(task="go/no-go", **few))) == (
        "Stimulus", 'Proportion of "go"',
    )  # fmt: skip
    either = ww.fit_weber(ww.simulate_trials(order="random", **few))
    assert labels(either)[0] == "Second stimulus × standard / first"
    log = pd.DataFrame({"log_ratio": [-0.3, -0.1, 0.1, 0.3] * 9, "choice": [0, 0, 1, 1] * 9})
    assert labels(ww.fit_weber(ww.read_trials(log)))[0] == (
        "log_ratio, second/first (natural logarithm)"
    )
    seen = ww.behaviour.CueEncoding(observer(), unit=1e-3)
    mm = ww.simulate_trials(standards=20.0, encoding=seen, **few)
    assert labels(ww.fit_weber(mm, encoding=seen))[0] == "Second stimulus (mm)"
