"""Comparisons find the observer that made the data, by evidence and by prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp, ndtr
from short_forms import slow_but

from weberwhisk import Observer, Whisker, cues
from weberwhisk.behaviour import (
    Comparison,
    CueEncoding,
    IdentityEncoding,
    Trials,
    compare,
    fit_weber,
    load_numerosity,
    simulate_trials,
)
from weberwhisk.behaviour.effects import Drift, Overdispersion
from weberwhisk.behaviour.encodings import ConstantNoise
from weberwhisk.behaviour.sampled import SampledPosterior
from weberwhisk.design import Hypothesis, noises, taper

TAPERED = Whisker(50e-3, 100e-6, 5e-6)
CYLINDER = Whisker(50e-3, 100e-6, 100e-6)
KNOWN = {"lapse_low": 0.0, "lapse_high": 0.0, "bias": 0.0}


def compared(trials: Trials, hypotheses: tuple[Hypothesis, ...]) -> Comparison:
    return compare({h.name: h.fit(trials) for h in hypotheses})


def test_evidence_and_loo_of_one_parameter_by_brute_force() -> None:
    trials = simulate_trials(weber_fraction=0.15, standards=[1.0, 3.0], trials_per_level=6, seed=2)
    felt = {"weber": IdentityEncoding(), "constant": ConstantNoise(IdentityEncoding(), 2.0)}
    tables = [
        compare(
            {n: fit_weber(trials, encoding=p, priors=KNOWN, seed=seed) for n, p in felt.items()}
        ).table
        for seed in range(4)
    ]
    s1, s2, x = (trials.frame[c].to_numpy(float) for c in ("stimulus_1", "stimulus_2", "count"))
    log_k = np.linspace(np.log(1e-4), np.log(100), 4001)
    prior = stats.lognorm(np.log(3.0), scale=0.1).logpdf(np.exp(log_k)) + log_k
    prior -= logsumexp(prior)
    for name, noise in (("weber", np.hypot(s1, s2)), ("constant", np.full(s1.shape, np.sqrt(8)))):
        p = ndtr((s2 - s1) / noise / np.exp(log_k)[:, None])
        each = np.log(np.clip(np.where(x == 1, p, 1 - p), 1e-300, 1))
        total = each.sum(axis=1)
        evidence = logsumexp(total + prior)
        left_out = (evidence - logsumexp((total + prior)[:, None] - each, axis=0)).sum()
        assert tables[0].loc[name, "log_evidence"] == pytest.approx(evidence, abs=0.01)
        # Importance sampling has Monte Carlo error, which the seeds show.
        elpd = np.array([table.loc[name, "elpd"] for table in tables])
        assert abs(elpd.mean() - left_out) < 4 * elpd.std(ddof=1) / np.sqrt(elpd.size)
        assert elpd.std() < 0.2
    for table in tables:
        assert table["probability"].sum() == pytest.approx(1.0)
        assert table["log_bayes_factor"].max() == 0.0
        assert table.loc["weber", "bad_k"] == 0


@pytest.mark.parametrize(
    ("made_by", "best"),
    slow_but([("weber", "Weber noise"), ("constant", "constant noise")], (1,)),
)
def test_the_noise_that_made_the_data_is_found(made_by: str, best: str) -> None:
    encoding = IdentityEncoding() if made_by == "weber" else ConstantNoise(IdentityEncoding(), 2.0)
    trials = simulate_trials(
        encoding=encoding,
        weber_fraction=0.12,
        standards=[1.0, 2.0, 4.0],
        trials_per_level=25,
        seed=4,
    )
    found = compared(trials, noises(IdentityEncoding(), trials.standards, bias="shared"))
    assert found.table.index[0] == best
    wrong = {"Weber noise", "constant noise"} - {best}
    row = found.table.loc[wrong.pop()]
    assert row["log_bayes_factor"] < -np.log(100)
    assert row["elpd_difference"] < -2 * row["difference_se"]
    assert found.report().startswith(best)


@pytest.mark.parametrize(
    ("drift", "best"), slow_but([(0.0, "stationary"), (-1.6, "drifting")], (1,))
)
@pytest.mark.slow  # of a comparison: the noise that made the data
def test_a_drift_is_found_where_there_is_one(drift: float, best: str) -> None:
    trials = simulate_trials(
        weber_fraction=0.15, drift=drift, sessions=5, offsets=[-0.3, -0.1, 0.1, 0.3],
        trials_per_level=120, seed=5,
    )  # fmt: skip
    found = compare(
        {"stationary": fit_weber(trials), "drifting": fit_weber(trials, effects=[Drift()])}
    )
    assert found.table.index[0].startswith(best)
    if drift:
        assert found.table.loc["stationary", "log_bayes_factor"] < -np.log(100)
        low, high = found.fits["drifting"].interval(0.99, parameter="drift")
        assert low < drift < high


@pytest.mark.slow  # the evidence by brute force: above
@pytest.mark.parametrize(
    ("whisker", "best"), slow_but([(TAPERED, "tapered"), (CYLINDER, "cylindrical")], (0,))
)
def test_the_papers_prediction_tells_whiskers_apart(whisker: Whisker, best: str) -> None:
    # In a simulation of its own, 360 trials at these standards mostly gave more than 10.
    encoding = CueEncoding(Observer(whisker, cues.Compliance()), unit=1e-3)
    trials = simulate_trials(
        encoding=encoding, weber_fraction=0.1, standards=[15.0, 30.0, 45.0],
        offsets=[-0.09, -0.06, -0.03, 0.03, 0.06, 0.09], trials_per_level=40, seed=6,
    )  # fmt: skip
    table = compared(trials, taper(TAPERED, unit=1e-3, bias="shared")).table
    assert table.index[0] == best
    assert table["log_bayes_factor"].iloc[1] < -np.log(10)


def test_misuse_is_refused_in_one_sentence() -> None:
    trials = simulate_trials(weber_fraction=0.1, sessions=2, seed=8)
    fit = fit_weber(trials)
    with pytest.raises(ValueError, match="two fits or more can be compared, got 1"):
        compare({"a": fit})
    with pytest.raises(ValueError, match="'b' was fitted to other trials than 'a'"):
        compare({"a": fit, "b": fit_weber(simulate_trials(weber_fraction=0.1, seed=9))})
    with pytest.raises(ValueError, match="without the effect Overdispersion"):
        compare({"a": fit, "b": fit_weber(trials, effects=[Overdispersion()])})
    with pytest.raises(ValueError, match="no taper to test"):
        taper(CYLINDER)


def test_a_fit_by_sampling_has_no_evidence_but_a_prediction() -> None:
    fit = fit_weber(load_numerosity("s1"))
    draws = SampledPosterior(fit.posterior.model, fit.posterior.draws(), 4, 0.0, "")  # type: ignore[attr-defined]
    found = compare({"integrated": fit, "sampled": replace(fit, posterior=draws)})
    assert np.isnan(found.table.loc["sampled", "log_evidence"])
    assert np.ptp(found.table["elpd"]) < 1e-9
    assert "nothing to compare by evidence" in found.report()


def test_the_same_answers_to_other_stimuli_are_other_trials() -> None:
    trials = simulate_trials(trials_per_level=3, seed=1)
    frame = trials.frame
    other = frame.assign(stimulus_2=frame["stimulus_2"].sample(frac=1, random_state=1).to_numpy())
    known = {"lapse_low": 0.0, "lapse_high": 0.0}
    fits = [
        fit_weber(replace(trials, frame=f), bias="none", priors=known)
        for f in (frame, other, frame.assign(stimulus_1=1e3, stimulus_2=1e3 * frame["stimulus_2"]))
    ]
    with pytest.raises(ValueError, match="was fitted to other trials"):
        compare({"one": fits[0], "other": fits[1]})
    elpd = compare({"one": fits[0], "in another unit": fits[2]}).table["elpd"]
    assert elpd.iloc[0] == pytest.approx(elpd.iloc[1])
