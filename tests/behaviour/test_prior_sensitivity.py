"""How far beliefs move the Weber fraction: beside fits with these beliefs, and ArviZ's function."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import ndtr
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.behaviour import FitStatus, Priors, WeberFit, effects, fit_weber, prior_sensitivity
from weberwhisk.behaviour.posteriors import log_score_density
from weberwhisk.commands import as_options

LEVELS = np.array([10, 12, 14, 16, 18, 20.0])


def go_no_go(boundary: float, seed: int, k: float = 0.08) -> ww.Trials:
    """An animal that goes above a boundary, against a no-go stimulus of 10; lapses of 1 %."""
    n = np.r_[200, np.full(5, 40)]
    p = 0.01 + 0.98 * ndtr((LEVELS - boundary) / (k * LEVELS))
    count = np.random.default_rng(seed).binomial(n, p)
    table = pd.DataFrame({"standard": 10.0, "comparison": LEVELS, "n": n, "n_greater": count})
    return ww.read_trials(table, task="go/no-go")


NARROW = {"criterion": stats.norm(0, 1)}
FITS: dict[str, Any] = {
    "go/no-go": lambda: fit_weber(go_no_go(14, 1), priors=NARROW),
    "few": lambda: fit_weber(
        ww.simulate_trials(trials_per_level=4, seed=3), priors={"bias": stats.norm(0, 1)}
    ),
    "biases": lambda: fit_weber(
        ww.simulate_trials(standards=[1, 2], bias=[1, -1], trials_per_level=20, seed=2),
        bias="per standard", priors={"bias": stats.norm(0, 1)},
    ),
    "contraction": lambda: fit_weber(
        ww.simulate_trials(standards=[1, 2], trials_per_level=10, seed=3),
        effects=[effects.Contraction()], priors={"bias": stats.norm(0, 1)},
    ),
}  # fmt: skip


@pytest.fixture(params=slow_but(FITS, (0, 3)))
def fit(request: pytest.FixtureRequest) -> WeberFit:
    made: WeberFit = FITS[request.param]()
    return made


def scaled(fit: WeberFit, belief: str, power: float) -> WeberFit:
    """The same fit with a normal belief, or a log-normal one, to a power."""
    prior = fit.model.priors.of("bias" if belief == "criterion" else belief)
    if prior.dist.name == "lognorm":
        made: Any = stats.lognorm(prior.args[0] / np.sqrt(power), **prior.kwds)
    else:
        made = stats.norm(prior.mean(), prior.std() / np.sqrt(power))
    own = {effect.name: effect.prior for effect in fit.model.effects}
    priors = {n: fit.model.priors.of(n) for n in ("weber_fraction", "bias", *own)} | {belief: made}
    if belief == "criterion":
        del priors["bias"]
    return fit_weber(fit.trials, bias=fit.bias, effects=fit.model.effects, priors=priors)


def test_a_belief_counted_twice_or_half_moves_k_as_its_fit_does(fit: WeberFit) -> None:
    table = fit.prior_sensitivity
    beliefs = [b for b in table.index if b not in ("lapses", "answers")]
    sd = np.log(fit.posterior.draws().weber_fraction).std()
    for belief in beliefs:
        for power, column in ((2.0, "twice"), (0.5, "half")):
            other = scaled(fit, str(belief), power).weber_fraction
            off = np.log(table.loc[belief, column] / other)
            assert abs(off) < 0.06 * sd, (belief, column)


def test_it_is_the_sensitivity_of_arviz(fit: WeberFit, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the same draws; ArviZ smooths weights, which changes next to nothing."""
    arviz, xr = pytest.importorskip("arviz"), pytest.importorskip("xarray")
    draws = fit.posterior.draws()
    monkeypatch.setattr(type(fit.posterior), "reproducible_draws", lambda self: draws)
    table = fit.prior_sensitivity
    data = fit.to_arviz()
    chains = len(data["posterior"]["chain"])
    for belief, log in log_score_density(fit.model, draws).items():
        data["log_prior"][belief] = xr.DataArray(log.reshape(chains, -1), dims=("chain", "draw"))
        if arviz.__version__.startswith("0."):
            theirs = arviz.psens(
                data, component="prior", component_var_names=[belief],
                var_names=["weber_fraction"],
            )  # fmt: skip
        else:
            theirs = arviz.psense(
                data, group="prior", group_var_names=[belief], var_names=["weber_fraction"]
            )["weber_fraction"]
        assert table.loc[belief, "sensitivity"] == pytest.approx(float(theirs), abs=0.003, rel=0.03)


def test_few_draws_with_the_weight_are_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = FITS["go/no-go"]()
    more = replace(fit.posterior, n_draws=16_000)  # so that the other's error is most of theirs
    before = prior_sensitivity.prior_sensitivity(fit.model, more)
    monkeypatch.setattr(prior_sensitivity, "LEAST_EFFECTIVE", 1e9 / 5)
    monkeypatch.setattr(
        prior_sensitivity, "adapted_draws",
        lambda *given, effective, **more: adapted(*given, effective=4000.0, **more),
    )  # fmt: skip
    anew = prior_sensitivity.prior_sensitivity(fit.model, fit.posterior)
    assert anew.index.tolist() == before.index.tolist()
    columns = ["change_twice", "change_half"]
    np.testing.assert_allclose(
        anew[columns].astype(float), before[columns].astype(float), atol=0.012
    )


adapted = prior_sensitivity.adapted_draws


def test_a_belief_that_overrides_the_answers_is_named_with_a_line_that_works() -> None:
    """A criterion of 5 sds under a standard normal belief: the interval of k missed 0.08."""
    trials = go_no_go(14, 103)
    fit = fit_weber(trials, priors=NARROW)
    assert fit.status is FitStatus.PRIOR_DEPENDENT
    row = fit.prior_sensitivity.loc["criterion"]
    assert row["conflict"]
    assert row["sds"] > 1
    said = next(note for note in fit.notes if "about the criterion, norm(0, 1)" in note)
    assert "The answers pull it the other way." in said
    assert "priors={'criterion': scipy.stats.norm(0, 5)}" in said
    assert "--prior criterion='norm(0, 5)'" in as_options(said)
    low, high = fit_weber(trials, priors={"criterion": stats.norm(0, 5)}).interval()
    assert low < 0.08 < high


def test_answers_that_say_little_depend_on_the_belief_about_k() -> None:
    fit = fit_weber(ww.simulate_trials(trials_per_level=1, seed=2))
    table = fit.prior_sensitivity
    assert table.loc["weber_fraction", "sds"] > table.loc["bias", "sds"]


def test_lapses_that_few_trials_cannot_tell_from_noise_are_named() -> None:
    """The median stays, and an end of the interval goes by the belief."""
    fit = fit_weber(
        ww.simulate_trials(trials_per_level=13, lapse_low=0.08, lapse_high=0.08, seed=23)
    )
    assert abs(fit.prior_sensitivity.loc["lapses", "change_half"]) < 0.02
    assert fit.status is FitStatus.PRIOR_DEPENDENT
    said = "What is believed about lapses, beta(0.7, 20), moves the Weber fraction"
    assert fit.report().count(said) == 1
    assert "--prior lapse_low=0.02 --prior lapse_high=0.02" in as_options(fit.report())


def test_beliefs_that_are_known_are_no_rows() -> None:
    trials = ww.simulate_trials(trials_per_level=10, seed=2)
    known = fit_weber(trials, priors={"lapse_low": 0.0, "lapse_high": 0.0, "bias": 0.0})
    assert known.prior_sensitivity.index.tolist() == ["weber_fraction", "answers"]
    given = fit_weber(trials, priors={"weber_fraction": 0.1})
    assert given.prior_sensitivity.empty
    scored = ww.simulate_trials(task="2AFC percent correct", trials_per_level=20, seed=2)
    assert fit_weber(scored).prior_sensitivity.index.tolist() == [
        "weber_fraction", "lapses", "answers"
    ]  # fmt: skip
    none = replace(trials, frame=trials.frame.assign(n=0, count=0).iloc[:0])
    assert fit_weber(none).prior_sensitivity.empty


def test_scores_far_out_in_a_log_logistic_are_at_the_end() -> None:
    """SciPy's survival function took the logarithm of 0 there, with a warning."""
    priors = Priors(weber_fraction=stats.fisk(3.94, scale=0.1))
    score = priors.score("weber_fraction", [1e-9, 0.1, 1e9])
    np.testing.assert_allclose(score, [-9.0, 0.0, 9.0], atol=1e-9)
