"""Experiments with curved whiskers, several touches, several whiskers, and go/no-go at a pole."""

from __future__ import annotations

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk.behaviour import (
    CueEncoding,
    PooledEncoding,
    response_probability,
    task_named,
)
from weberwhisk.behaviour.encodings import Encoding
from weberwhisk.design import Evidence, Hypothesis, Plan, Scheme
from weberwhisk.design.plan_file import _reader, plain, preregistration
from weberwhisk.sensitivity import weber_propagation

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
SHORT = ww.Whisker(35e-3, 70e-6, 4e-6)
CURVED = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=-15.0)
SOFT = ww.Observer(WHISKER, ww.cues.UnknownStiffness(ww.cues.ForceMap()))
AFC = task_named("2AFC")


def chosen(encoding: object, near: float, far: float, k: float) -> float:
    """Share of choices "second farther" that the encoding predicts."""
    return float(response_probability(AFC, encoding, near, far, weber_fraction=k)[0])


@pytest.mark.slow  # of several whiskers: the next test
def test_choices_of_several_touches_are_those_of_their_posteriors() -> None:
    """Three touches of each of two distances, read, located by `touches`, and compared."""
    observer = ww.Observer(WHISKER, ww.cues.ForceMap(), ww.receptors.Weber(0.05))
    angles, pair, runs = np.array([0.15, 0.2, 0.25]), (20e-3, 21.5e-3), 50
    rng = np.random.default_rng(1)
    found = np.array(
        [
            [
                ww.touches(observer, observer.read(np.stack([0 * angles + r, angles], 1), rng)).mean
                for r in pair
            ]
            for _ in range(runs)
        ]
    )
    predicted = chosen(PooledEncoding.of_touches(observer, angles), *pair, 0.05)
    share, error = np.mean(found[:, 1] > found[:, 0]), np.sqrt(predicted * (1 - predicted) / runs)
    assert share == pytest.approx(predicted, abs=2.5 * error)
    one = chosen(CueEncoding(observer, 0.2), *pair, 0.05)
    assert predicted > one + 1.5 * error


def test_choices_of_several_whiskers_are_those_of_their_likelihoods_multiplied() -> None:
    """Two whiskers tap one pole, their bases 3 mm apart: curved and straight, by brute force."""
    k = 0.1
    observers = [
        ww.Observer(w, ww.cues.Compliance(), ww.receptors.Weber(k)) for w in (CURVED, SHORT)
    ]
    offsets, pair, runs = (0.0, 3e-3), (15e-3, 16.5e-3), 4000
    pooled = PooledEncoding(tuple(map(CueEncoding, observers)), offsets)
    grid = np.linspace(8e-3, 30e-3, 900)
    rng = np.random.default_rng(2)
    best = []
    for r in pair:
        log = 0.0
        for observer, offset in zip(observers, offsets, strict=True):
            reading = observer.read(np.full((runs, 1), r - offset), rng)
            mean = observer.signals((grid - offset)[:, None])[0][:, 0]
            log = log - 0.5 * ((reading - mean) / (k * mean)) ** 2 - np.log(mean)
        best.append(grid[np.argmax(log, axis=1)])
    share = np.mean(best[1] > best[0])
    predicted = chosen(pooled, *pair, k)
    assert share == pytest.approx(predicted, abs=0.025)
    alone = [
        chosen(CueEncoding(o), *(r - d for r in pair), k)
        for o, d in zip(observers, offsets, strict=True)
    ]
    assert predicted > max(alone) + 0.04


def test_pooling_adds_precision_and_only_of_looks_that_reach() -> None:
    """Equal touches give 1/√n, floors too; past the short whisker's tip only the long one tells."""
    noise = ww.receptors.GeneralisedWeber(0.1, floor=1e-8)
    observer = ww.Observer(WHISKER, ww.cues.ForceMap(["moment", "axial_force"]), noise)
    one, nine = (PooledEncoding.of_touches(observer, [0.2] * n) for n in (1, 9))
    r = np.array([15e-3, 30e-3])
    for name in ("sd_per_weber_fraction", "floor_sd"):
        np.testing.assert_allclose(getattr(nine, name)(r), getattr(one, name)(r) / 3, rtol=1e-6)
    long, short = (ww.Observer(w, ww.cues.Compliance()) for w in (WHISKER, SHORT))
    both = PooledEncoding((CueEncoding(long), CueEncoding(short)))
    alone = weber_propagation(long, np.array([[20e-3], [40e-3]])) / 0.1
    sd = both.sd_per_weber_fraction([20e-3, 40e-3])
    assert sd[0] < 0.8 * alone[0]
    assert sd[1] == pytest.approx(alone[1], rel=1e-6)
    assert both.domain == (0.0, 50e-3)
    assert np.isnan(both.mean(51e-3))


@pytest.mark.parametrize(
    ("looks", "says"),
    [
        ((), "looks is empty"),
        ((CueEncoding(ww.Observer(WHISKER, ww.cues.Compliance())), 3.0), "a CueEncoding"),
        ((CueEncoding(SOFT, 0.2), CueEncoding(SOFT, 0.2)), "average away"),
        ((CueEncoding(ww.Observer(WHISKER, ww.cues.Compliance())),
          CueEncoding(ww.Observer(WHISKER, ww.cues.Compliance()), unit=1e-3)), "different units"),
    ],
)  # fmt: skip
def test_looks_that_cannot_be_pooled_are_refused(looks, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        PooledEncoding(looks)


@pytest.fixture(scope="module")
def looks() -> tuple[Hypothesis, Hypothesis]:
    """One whisker, or a shorter one beside it."""
    taps = [CueEncoding(ww.Observer(w, ww.cues.Compliance())) for w in (WHISKER, SHORT)]
    return (
        Hypothesis("one whisker", taps[0]),
        Hypothesis("two whiskers", PooledEncoding(tuple(taps))),
    )


def test_go_no_go_at_a_pole_is_planned_simulated_and_fitted(looks) -> None:
    """One stimulus a trial in the lists; hits and false alarms as the simulated animal has them."""
    both = [Hypothesis(h.name, h.encoding, task="go/no-go") for h in looks]
    scheme = Scheme([20e-3], [-4e-3, 2e-3, 4e-3], 100)
    plan = Plan(scheme, both, Evidence(bayes_factor=10))
    assert (plan.trials["stimulus_1_mm"] == 20).all()
    assert ((plan.trials["greater"] == 2) == (plan.trials["stimulus_2_mm"] > 20)).all()
    assert plan.trials["level"].value_counts().tolist() == [100] * 3
    text = preregistration(plan)
    assert "standard held in mind" in " ".join(text.split())
    assert "independent looks" in " ".join(text.split())
    trials = ww.simulate_trials(
        standards=20e-3, comparisons=[16e-3, 20e-3, 22e-3, 24e-3], encoding=looks[1].encoding,
        task="go/no-go", weber_fraction=0.15, bias=0.3, trials_per_level=400, seed=4,
    )  # fmt: skip
    fit = ww.fit_weber(trials, encoding=looks[1].encoding, priors={"lapse_low": 0, "lapse_high": 0})
    low, high = fit.interval(0.99)
    assert low < 0.15 < high
    assert fit.posterior.quantile("criterion", 0.5) == pytest.approx(0.3, abs=0.15)
    found = ww.power(scheme, both, runs=16, seed=1)
    assert found.table["power"].between(0, 1).all()


def test_plans_keep_curved_and_pooled_observers_in_their_files(looks) -> None:
    observer = ww.Observer(CURVED, ww.cues.Friction(ww.cues.ForceMap(), angle=0.2))
    hinged = ww.Whisker(50e-3, 100e-6, 5e-6, hinge_stiffness=1e-5)
    tap, force_map = ww.cues.Compliance(), ww.cues.ForceMap()
    others = [
        ww.Observer(CURVED, ww.cues.Fused(tap, force_map)),
        ww.Observer(CURVED, ww.cues.UnknownCurvature(force_map, 2.0)),
        ww.Observer(CURVED, ww.cues.UnknownStiffness(force_map)),
        ww.Observer(hinged, ww.cues.UnknownHinge(force_map, 0.3)),
    ]
    for encoding in (
        looks[1].encoding,
        PooledEncoding.of_touches(observer, [0.1, 0.2]),
        *(CueEncoding(other, 0.2) for other in others),
    ):
        assert plain(_reader().structure(plain(encoding), Encoding)) == plain(encoding)
