"""The belief about lapses: `analyses/lapse_prior.py`, and psignifit on the same data."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import FOLDER, load
from scipy.stats import beta, fisk
from short_forms import slow_but

from weberwhisk import Observer, Whisker, cues, fit_weber, simulate_trials
from weberwhisk.behaviour import (
    CueEncoding,
    effects,
    fit_population,
    simulate_population,
)
from weberwhisk.behaviour.priors import DEFAULTS
from weberwhisk.receptors import GeneralisedWeber

script, grid = load("lapse_prior"), load("plain_grid")
beside = load("psignifit_side_by_side")

LEVELS = {"weber_fraction": "levels"}
#: With 117 trials to 0.9 sd even an observer informed of lapses and bias is at 20 %.
BEYOND_REACH = script.CELL_ABOVE
BOTH = script.SHIPPED_FRACTION, script.BY_LEVELS


@pytest.fixture(scope="module")
def psignifit() -> pd.DataFrame:
    """Answers of psignifit 4.3, one second each, as `psignifit_side_by_side.py` has them."""
    return pd.read_csv(FOLDER / "psignifit_side_by_side.csv", dtype={"name": str})


def by_grid(design: object, count: np.ndarray, *fractions: object) -> list[np.ndarray]:
    """Medians of k, (N,) each, for priors of k with the lapses believed beside them."""
    by_levels = [fraction == script.BY_LEVELS for fraction in fractions]
    lapses = [script.LAPSES_BY_LEVELS if levels else script.SHIPPED for levels in by_levels]
    table = np.array([script.belief(*script.BELIEFS[name]) for name in lapses]).T
    ln_k, like = script.density(design, count, table)
    priors = [script.prior_of(fraction, design) for fraction in fractions]
    found = [script.estimates(ln_k, like[0, :, i], prior) for i, prior in enumerate(priors)]
    return [np.exp(each["median"]) for each in found]


def rmse(found: np.ndarray, k: float | np.ndarray) -> float:
    return float(np.sqrt(np.mean((found / k - 1) ** 2)))


def test_what_was_chosen_is_the_default() -> None:
    a, b, correlation = script.BELIEFS[script.SHIPPED]
    for prior in (DEFAULTS.lapse_low, DEFAULTS.lapse_high):
        assert (prior.dist.name, prior.args) == ("beta", (a, b))
    assert DEFAULTS.lapse_correlation == correlation
    shipped = grid.SHIPPED_BIAS
    assert (DEFAULTS.bias.dist.name, DEFAULTS.bias.args) == (shipped.dist.name, shipped.args)


@pytest.mark.parametrize(
    "name", slow_but(["k 0.1, 297 trials to ±0.30", "k 0.2, 297 trials to ±0.30"], (1,))
)
def test_the_plain_grid_gives_what_the_fit_gives(name: str) -> None:
    design, count, _ = script.cell(name, 6)
    for priors, summed in zip((None, LEVELS), by_grid(design, count, *BOTH), strict=True):
        fits = np.array([beside.our_answer(design, row, priors)[0] for row in count])
        # Nodes of 0.12 in ln k, and sixteen for each lapse.
        np.testing.assert_allclose(summed, fits, rtol=0.03)


@pytest.mark.parametrize("name", slow_but(script.CELLS, (1, 8)))
def test_no_further_from_the_truth_than_psignifit_on_the_same_data(
    name: str, psignifit: pd.DataFrame
) -> None:
    """At k = 0.2 and 297 trials the default was at 19 % and psignifit at 13 %; in one cell the
    default cannot be, and the belief about the levels, which psignifit has too, is."""
    own = psignifit[(psignifit["kind"] == "cell") & (psignifit["name"] == name)]
    assert len(own) > 50
    design, count, k = script.cell(name, 400)
    count, theirs = count[own["set"].to_numpy()], rmse(own["k"].to_numpy(), k)
    beliefs = BOTH[1:] if name == BEYOND_REACH else BOTH
    assert max(rmse(found, k) for found in by_grid(design, count, *beliefs)) <= theirs


@pytest.mark.parametrize("part", slow_but(script.DESIGNS, (1,)))
@pytest.mark.slow
def test_over_animals_and_designs_the_defaults_lose_least(part: str) -> None:
    """Of lapses less than the default before; and half as wide a prior of k loses less where the
    animals were laid out, and far more once they are moved, with their levels, to k about 0.5."""
    table = np.array([script.belief(*script.BELIEFS[name]) for name in list(script.BELIEFS)[:2]]).T
    fractions = script.SHIPPED_FRACTION, "0.1, a factor of 2"
    loss: dict[str, list[float]] = {}
    for number in range(8):
        design, count, truth = script.population(part, number, 50)
        ln_k, like = script.density(design, count, table)

        def squares(name: str, belief: int, moved: float = 0.0) -> list[float]:
            prior = script.prior_of(name, design, moved)  # noqa: B023
            median = script.estimates(ln_k, like[0, :, belief], prior)["median"]  # noqa: B023
            return ((median - np.log(truth[0])) ** 2).tolist()  # noqa: B023

        loss.setdefault("before", []).extend(squares(fractions[0], 1))
        for name in fractions:
            loss.setdefault(name, []).extend(squares(name, 0))
            loss.setdefault(name + ", moved", []).extend(squares(name, 0, np.log(0.5 / 0.14)))
    rms = {name: np.sqrt(np.mean(squares)) for name, squares in loss.items()}
    three, two = fractions
    assert rms[three] < 0.97 * rms["before"]
    assert rms[three] < 0.3
    assert rms[two] < rms[three]
    assert rms[two + ", moved"] > 1.2 * rms[three + ", moved"]


@pytest.mark.parametrize("kind", slow_but(beside.KINDS, (1,)))
def test_no_further_than_psignifit_over_animals_whose_thresholds_are_bracketed(
    kind: str, psignifit: pd.DataFrame
) -> None:
    ours, theirs = [], []
    for number in range(8):
        own = psignifit[(psignifit["kind"] == kind) & (psignifit["name"] == str(number))]
        at = own["set"].to_numpy()
        design, count, k = beside.data(kind, str(number), 400)
        inside = beside.bracketed(kind, str(number), 400)[at]
        at = at[inside]
        ours.append(np.log(by_grid(design, count[at], *BOTH) / k[at]))
        theirs.append(np.log(own["k"].to_numpy()[inside] / k[at]))
    fixed, levels, their = (
        np.sqrt(np.mean(errors**2))
        for errors in (*np.concatenate(ours, axis=1), np.concatenate(theirs))
    )
    assert levels <= fixed <= their


def test_the_belief_about_levels_is_the_prior_that_it_says() -> None:
    trials = simulate_trials(weber_fraction=0.2, trials_per_level=13, seed=3)
    fit = fit_weber(trials, priors=LEVELS)
    pairs = trials.frame[["stimulus_1", "stimulus_2"]].to_numpy()
    easiest = np.max(np.abs(pairs[:, 1] - pairs[:, 0]) / np.hypot(*pairs.T)) / 1.5
    as_said = {"weber_fraction": fisk(np.pi / (3**0.5 * 0.46), scale=easiest)}
    as_said |= dict.fromkeys(("lapse_low", "lapse_high"), beta(0.5, 9.5))
    same = fit_weber(trials, priors=as_said)
    assert fit.interval() == pytest.approx(same.interval(), rel=1e-9)
    assert fit.summary()["prior"]["weber_fraction"].endswith("about the levels shown")
    assert "about the levels shown" in fit.report()
    assert "about the levels shown" in fit.methods()
    assert "levels" not in same.methods()
    other = fit_weber(trials, priors=LEVELS | {"lapse_low": 0.0}).model.priors
    assert (other.words("lapse_low"), other.words("lapse_high")) == ("fixed at 0", "beta(0.5, 9.5)")


def test_animals_shown_other_levels_lay_the_prior_at_their_geometric_mean() -> None:
    trials, _ = simulate_population(2, weber_fraction=0.1, trials_per_level=8, seed=1)
    frame = trials.frame
    comparison = frame["stimulus_2"] / frame["stimulus_1"]
    narrow = (frame["subject"] == trials.subjects[0]) & (np.abs(comparison - 1) > 0.2)
    fewer = type(trials)(frame[~narrow].reset_index(drop=True), trials.task)
    alone = [
        fit_weber(fewer.select(subject=s), priors=LEVELS).model.priors.weber_fraction.median()
        for s in fewer.subjects
    ]
    assert alone[0] < 0.8 * alone[1]
    together = fit_population(fewer, priors=LEVELS)
    assert together.believed.weber_fraction.median() == pytest.approx(np.sqrt(np.prod(alone)))
    assert "about the levels shown" in together.methods()


def test_levels_are_refused_where_they_say_nothing_of_k() -> None:
    trials = simulate_trials(trials_per_level=5, seed=1)
    with pytest.raises(ValueError, match="did you mean 'levels'"):
        fit_weber(trials, priors={"weber_fraction": "level"})
    with pytest.raises(ValueError, match="a floor is fitted"):
        fit_weber(trials, priors=LEVELS, effects=[effects.Floor()])
    equal = type(trials)(trials.frame.assign(stimulus_2=trials.frame["stimulus_1"]), trials.task)
    with pytest.raises(ValueError, match="no pair of different stimuli"):
        fit_weber(equal, priors=LEVELS)
    whisker = Whisker(50e-3, 100e-6, 5e-6)
    floored = CueEncoding(Observer(whisker, cues.Compliance(), GeneralisedWeber(0.1, floor=1e-6)))
    taps = simulate_trials(standards=[20e-3], trials_per_level=5, encoding=floored, seed=1)
    with pytest.raises(ValueError, match="does not go with the Weber fraction"):
        fit_weber(taps, encoding=floored, priors=LEVELS)


@pytest.mark.slow
def test_the_same_by_the_fit_itself_in_full(psignifit: pd.DataFrame) -> None:
    for name in script.CELLS:
        found = beside.side_by_side(psignifit, "cell", [name])
        ours, levels, theirs = (rmse(found[tool][:, 0], 1.0) for tool in beside.TOOLS)
        assert levels <= theirs, name
        assert ours <= theirs or name == BEYOND_REACH, name
    for kind in beside.KINDS:
        found = beside.side_by_side(psignifit, kind, [str(n) for n in range(8)])
        inside = found["bracketed"]
        log = [np.sqrt(np.mean(np.log(found[t][inside, 0]) ** 2)) for t in beside.TOOLS]
        assert max(log[:2]) <= log[2]
