"""Animals engaged part of the time: against enumeration, a public GLM-HMM, emcee, and recovery."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from scipy import stats

from weberwhisk._util.sampling import sample_stacked
from weberwhisk.behaviour import (
    StateFit,
    States,
    Trials,
    compare,
    fit_weber,
    read_trials,
    simulate_trials,
    weber_law_test,
)
from weberwhisk.behaviour.effects import History
from weberwhisk.behaviour.states import (
    STATE_PRIORS,
    StateDraws,
    StateModel,
    StateTarget,
    with_states,
)

Array = NDArray[np.float64]
LEVELS = [-0.3, -0.2, -0.1, 0.1, 0.2, 0.3]
NAMES = ("weber_fraction", "bias", "lapse", "engaged", "switch", "side", "low", "high")
POINTS: Array = np.array(
    [[0.15, 0.1, 0.02, 0.7, 0.06, 0.4, 0.05, 0.9], [0.3, -0.2, 0.05, 0.4, 0.3, 0.8, 0.2, 0.7]]
)


def draws_at(points: Array, n_states: int = 3) -> StateDraws:
    k, bias, lapse = points.T[:3]
    states = points[:, 3:] if n_states == 3 else points[:, [3, 4, 6]]
    none = np.zeros((len(k), 0))
    return StateDraws(k, lapse, lapse, bias[:, None], none, states)


def model_of(trials: Trials, n_states: int = 3, **options: Any) -> StateModel:
    fit = fit_weber(trials, **options)
    return with_states(fit.model, trials, fit.encoding, n_states)


def by_enumeration(model: StateModel, draws: StateDraws) -> tuple[Array, Array]:
    """Likelihood, and P(engaged) of each row, summed over all paths of every session."""
    p, _ = model.probability(*draws.values)
    like, engaged = np.ones(len(draws)), np.zeros((model.cell.size, len(draws)))
    ends = np.r_[model.begins, model.cell.size]
    for n, states in enumerate(draws.states):
        share, switch = states[0], states[1]
        if model.n_states == 3:
            shares = np.array([share, (1 - share) * (1 - states[2]), (1 - share) * states[2]])
            away = states[3:]
        else:
            shares, away = np.array([share, 1 - share]), states[2:]
        for first, last in pairwise(ends):
            total, at = 0.0, np.zeros(last - first)
            for path in product(range(model.n_states), repeat=last - first):
                weight = shares[path[0]]
                for i, state in enumerate(path):
                    row = first + i
                    if i:
                        kept = (1 - switch) ** model.passed[row]
                        weight *= kept * (state == path[i - 1]) + (1 - kept) * shares[state]
                    second = away[state - 1] if state else p[n, model.cell[row]]
                    if model.answer[row] < 2:
                        weight *= second if model.answer[row] else 1 - second
                total += weight
                at += weight * (np.array(path) == 0)
            like[n] *= total
            engaged[first:last, n] = at / total
    return like, engaged


@pytest.fixture
def short() -> Trials:
    """Three sessions, with trials unanswered and left out of the table."""
    frame = pd.DataFrame(
        {
            "session": [1] * 6 + [2] * 5 + [3],
            "trial": [1, 2, 3, 4, 5, 6, 1, 2, 5, 6, 7, 1],
            "stimulus_1": 1.0,
            "stimulus_2": [0.7, 1.2, 1.3, 0.8, 0.9, 1.1, 1.3, 0.9, 1.2, 0.7, 0.7, 1.2],
            "choice": [0, 1, 1, None, 0, 0, None, 0, 0, 0, 1, 1],
        }
    )
    return read_trials(frame)


@pytest.mark.parametrize("n_states", [2, 3])
def test_chain_is_the_sum_over_all_paths(short: Trials, n_states: int) -> None:
    model, draws = model_of(short, n_states), draws_at(POINTS, n_states)
    like, engaged = by_enumeration(model, draws)
    np.testing.assert_allclose(np.exp(model.chain(draws)[0]), like, rtol=1e-10)
    many = draws.at(np.repeat([0, 1], 20_000))
    path = model.paths(many, np.random.default_rng(1)) == 0
    seen = path.reshape(-1, 2, 20_000).mean(axis=2)
    np.testing.assert_allclose(seen, engaged, atol=4 * 0.5 / np.sqrt(20_000))


def test_probability_of_each_answer_given_those_before_makes_up_the_likelihood(
    short: Trials,
) -> None:
    model, draws = model_of(short), draws_at(POINTS)
    p, q = model.by_row(draws)
    answer = model.answer[model.answer < 2]
    said = np.log(np.where(answer == 1, p, q)).sum(axis=1)
    np.testing.assert_allclose(said, model.chain(draws)[0], rtol=1e-10)


def test_chain_and_states_agree_with_a_public_glm_hmm() -> None:
    """dynamax; `analyses/choices/glm_hmm_reference.py` made the file."""
    path = Path(__file__).parents[1] / "data" / "glm_hmm.json"
    kept = json.loads(path.read_text("utf-8"))
    parts = [
        pd.DataFrame({"session": i, "stimulus_1": 1.0, "stimulus_2": one["level"]}).assign(
            choice=one["answer"]
        )
        for i, one in enumerate(kept["sessions"])
    ]
    model = model_of(read_trials(pd.concat(parts, ignore_index=True)))
    rng = np.random.default_rng(1)
    for one in kept["expected"]:
        draws = draws_at(np.array([one["point"]]))
        assert model.chain(draws)[0] == pytest.approx(one["log_likelihood"], rel=1e-9)
        path_drawn = model.paths(draws.at(np.zeros(4000, dtype=np.intp)), rng) == 0
        expected = np.concatenate(one["engaged"])
        assert np.abs(path_drawn.mean(axis=1) - expected).max() < 5 * 0.5 / np.sqrt(4000)


def animal(seed: int, engaged: float = 0.7, per_level: int = 100, **options: Any) -> Trials:
    return simulate_trials(
        weber_fraction=0.15, offsets=LEVELS, trials_per_level=per_level, lapse_low=0.02,
        lapse_high=0.02, states=States(engaged=engaged), seed=seed, **options,
    )  # fmt: skip


@pytest.fixture(scope="module", params=[8, pytest.param(20, marks=pytest.mark.slow)])
def animals(request: pytest.FixtureRequest) -> list[tuple[Trials, StateFit]]:
    """Some of them; the study in `analyses/choices` has a hundred of each kind."""
    share = np.linspace(0.5, 0.88, request.param)
    trials = [animal(seed, own, sessions=2, missing=0.02) for seed, own in enumerate(share)]
    fits = [fit_weber(one, states=3) for one in trials]
    return list(zip(trials, fits, strict=True))  # type: ignore[arg-type]


def test_weber_fraction_of_the_engaged_state_is_recovered(
    animals: list[tuple[Trials, StateFit]],
) -> None:
    ends = np.array([fit.interval() for _, fit in animals])
    inside = (ends[:, 0] < 0.15) & (ends[:, 1] > 0.15)
    assert inside.sum() >= len(inside) - 3  # at 95 % fewer in 3 of 1000 runs of 20
    off = np.log([fit.weber_fraction / 0.15 for _, fit in animals])
    assert np.sqrt(np.mean(off**2)) < 0.2
    assert not any(fit.status.is_misfit for _, fit in animals)


def test_engaged_trials_are_found_and_their_share_is_in_its_interval(
    animals: list[tuple[Trials, StateFit]],
) -> None:
    held, found, truth = 0, [], []
    for trials, fit in animals:
        engaged = (trials.frame["state"] == "engaged").to_numpy()
        share, low, high = fit.share_engaged()
        held += low <= engaged.mean() <= high
        found.append(fit.engagement["engaged"].to_numpy())
        truth.append(engaged)
        assert share == pytest.approx(found[-1].mean(), abs=1e-9)
    assert held >= len(found) - 3
    p, engaged = np.concatenate(found), np.concatenate(truth)
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.0)):
        some = (p >= low) & (p <= high)
        assert abs(engaged[some].mean() - p[some].mean()) < 0.08


@pytest.mark.slow  # of few trials a plain sum does
def test_importance_sampling_agrees_with_emcee() -> None:
    """The same posterior by ensembles, which share nothing with it but the density."""
    fit = fit_weber(animal(5, per_level=40), states=2)
    model = fit.model
    assert isinstance(model, StateModel)
    rng = np.random.default_rng(2)
    density, dim = StateTarget(model).log_density, len(model.names)
    start = 0.3 * rng.standard_normal((1, 4, 24, dim))
    run = sample_stacked(
        lambda x: density(x.reshape(-1, dim)).reshape(x.shape[:2]), start, seed=rng,
        precision=0.1, max_steps=400,
    )  # fmt: skip
    drawn = model.draws_of(run.values[0].reshape(-1, dim)).named(model)
    for name in model.names:
        error = fit.posterior.sd(name) * 0.25
        assert drawn[name].mean() == pytest.approx(fit.posterior.mean(name), abs=error), name


def test_evidence_is_that_of_a_plain_sum() -> None:
    """Of two unknowns the grid can be written out."""
    trials = animal(7, per_level=10)
    known = {
        "lapse_low": 0.02, "lapse_high": 0.02, "bias": 0.0, "switch": 0.05, "side": 0.5,
        "answer_low": 0.05, "answer_high": 0.95,
    }  # fmt: skip
    fit = fit_weber(trials, states=3, priors=known)
    assert fit.parameters == ("weber_fraction", "engaged")
    model = fit.model
    assert isinstance(model, StateModel)
    z, u = np.linspace(-5, 5, 201), (np.arange(200) + 0.5) / 200
    k = model.value("weber_fraction", z)
    every = np.array([[a, 0.0, 0.02, b, 0.05, 0.5, 0.05, 0.95] for a in k for b in u])
    like = np.exp(model.chain(draws_at(every))[0].reshape(z.size, u.size) - fit.log_evidence)
    density = like.mean(axis=1) * stats.norm.pdf(z) * (z[1] - z[0])
    assert density.sum() == pytest.approx(1.0, abs=0.03)
    mean = (density @ k) / density.sum()
    assert fit.posterior.mean("weber_fraction") == pytest.approx(mean, rel=0.01)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"states": 4}, "states must be 1, 2 or 3"),
        ({"states": 3, "method": "quadrature"}, "leave method out"),
    ],
)
def test_what_has_no_states_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fit_weber(simulate_trials(seed=1), **change)


def test_counts_and_scored_answers_have_no_states() -> None:
    scored = simulate_trials(task="2AFC percent correct", offsets=[0.1, 0.3], seed=1)
    with pytest.raises(ValueError, match="which answer was given"):
        fit_weber(scored, states=3)
    table = pd.DataFrame({"stimulus_1": 1.0, "stimulus_2": [0.9, 1.1], "n": 9, "n_greater": [2, 7]})
    with pytest.raises(ValueError, match="needs a row a trial"):
        fit_weber(read_trials(table), states=3)


def test_effects_act_while_engaged() -> None:
    trials = animal(9, effects=[(History(), 1.0)])
    fit = fit_weber(trials, states=3, effects=[History()])
    low, high = fit.interval(parameter="history")
    assert low < 1.0 < high
    assert low > 0.3


def test_simulated_states_last_and_are_shared_as_asked() -> None:
    trials = simulate_trials(
        offsets=LEVELS, trials_per_level=2000, states=States(0.6, 0.1, 0.25, 0.0, 1.0), seed=3
    )
    state = trials.frame["state"]
    assert (state == "engaged").mean() == pytest.approx(0.6, abs=0.07)  # 3.5 sds
    assert (state == "high").mean() == pytest.approx(0.1, abs=0.04)
    stays = (state == state.shift(1))[1:][state[:-1].to_numpy() == "engaged"].mean()
    assert stays == pytest.approx(1 - 0.1 * 0.4, abs=0.01)
    count = trials.frame["count"]
    assert (count[state == "low"] == 0).all()
    assert (count[state == "high"] == 1).all()
    again = replace(States(), engaged=1.0)
    plain = simulate_trials(offsets=LEVELS, seed=3, states=again)
    without = simulate_trials(offsets=LEVELS, seed=3)
    assert plain.frame["count"].equals(without.frame["count"])


def test_report_methods_and_records_speak_of_states(
    animals: list[tuple[Trials, StateFit]],
) -> None:
    _, fit = animals[0]
    assert "The animal was engaged on" in fit.report()
    said = fit.methods()
    assert "hidden Markov chain of three states" in said
    assert "importance sampling" in said
    for name in STATE_PRIORS[3]:
        assert f"{name} ~ " in said
    record = fit.to_dict()
    assert record["settings"]["states"] == 3  # type: ignore[index]
    assert "engaged" in record["parameters"]  # type: ignore[operator]
    data = fit.to_arviz()
    assert float(np.sum(data["log_likelihood"]["answers"].to_numpy()[0, 0])) == pytest.approx(
        fit.model.chain(fit.posterior.draws().at([0]))[0][0]  # type: ignore[attr-defined]
    )


def test_what_needs_independent_trials_refuses_states(
    animals: list[tuple[Trials, StateFit]],
) -> None:
    trials, fit = animals[0]
    with pytest.raises(ValueError, match="log_evidence"):
        compare({"states": fit, "one": fit_weber(trials)})
    with pytest.raises(ValueError, match="tested of one state"):
        weber_law_test(fit_weber(simulate_trials(standards=[1.0, 2.0], seed=1), states=2))
