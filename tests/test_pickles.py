"""Every result pickles and comes back the same, so that workers can send it."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pandas as pd
import pytest
from short_forms import slow_but
from test_reprs import objects

import weberwhisk as ww
from weberwhisk import cues
from weberwhisk._util.values import Line

W = ww.Whisker(50e-3, 100e-6, 5e-6)


def back(result: Any) -> Any:
    return pickle.loads(pickle.dumps(result))


def test_every_public_object_pickles_and_results_say_the_same() -> None:
    for each in objects():
        copy = back(each)
        assert type(copy) is type(each)
        if isinstance(each, Line):
            assert repr(copy) == repr(each)


@pytest.mark.parametrize("method", ["quadrature", "laplace", "emcee"])
@pytest.mark.parametrize("cue", slow_but([cues.Compliance(), cues.ForceMap()], (0,)), ids=repr)
def test_a_posterior_comes_back_to_the_bit(cue: Any, method: str) -> None:
    observer = ww.Observer(W, cue)
    contact = [[25e-3, 0.2], [30e-3, 0.3]][: 1 if method == "emcee" else 2]
    readings = observer.read([c[: len(observer.unknowns)] for c in contact], seed=1)
    p = ww.posterior(observer, readings, method, seed=2)
    same(back(p), p)


@pytest.mark.slow  # of pickles: every public object
def test_a_posterior_of_three_unknowns_comes_back_to_the_bit() -> None:
    observer = ww.Observer(W, cues.UnknownStiffness(cues.ForceMap()))
    p = ww.posterior(observer, observer.read([25e-3, 0.2, 1.0], seed=1))
    same(back(p), p)


def same(copy: ww.Posterior, p: ww.Posterior) -> None:
    np.testing.assert_array_equal(copy.status, p.status)
    np.testing.assert_array_equal(copy.log_evidence, p.log_evidence)
    for name in p.observer.unknowns:
        np.testing.assert_array_equal(copy.estimates[name], p.estimates[name])
        np.testing.assert_array_equal(copy.interval(of=name), p.interval(of=name))
    np.testing.assert_array_equal(copy.solution.draws(20, 3), p.solution.draws(20, 3))


def test_studies_and_tables_come_back() -> None:
    trials, _ = ww.simulate_population(3, trials_per_level=5, seed=1)
    population = ww.fit_population(trials, check=False)
    copy = back(population)
    pd.testing.assert_frame_equal(copy.summary(), population.summary())
    np.testing.assert_array_equal(copy.interval(), population.interval())
    array = ww.WhiskerArray("rat", "right").protract(np.radians(40))
    observer = ww.ArrayObserver(array.only(["C1", "C2"]))
    readings = observer.read([20e-3, 2e-3], seed=1)
    place = ww.place(observer, readings)
    pd.testing.assert_frame_equal(back(place).summary(), place.summary())
    tap = ww.press(W, radial_distance=[20e-3, 30e-3], deflection_angle=0.1)
    table = pd.DataFrame({"moment_Nm": tap.moment, "axial_force_N": tap.axial_force})
    located = ww.locate(table, W, noise=0.1)
    pd.testing.assert_frame_equal(back(located), located)
    assert back(located).attrs["notes"] == located.attrs["notes"]
