"""Posteriors are the same to the bit: by workers, in any company, whatever was solved before."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import cues, receptors
from weberwhisk.inference import quadrature, tree

W = ww.Whisker(50e-3, 100e-6, 5e-6)


def numbers(p: ww.Posterior, rows: Any = slice(None)) -> list[Any]:
    """All numbers of a posterior, of some of its readings."""
    moments = [values[rows] for estimate in p.estimates.values() for values in estimate]
    ends = [p.interval(of=name)[rows] for name in p.observer.unknowns]
    return [p.status[rows], p.log_evidence[rows], *moments, *ends]


def same(one: list[Any], other: list[Any]) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def contacts(observer: ww.Observer, count: int) -> Any:
    """Contacts that are held, with what is shared of the further unknown."""
    rng = np.random.default_rng(1)
    r, angle = rng.uniform(10e-3, 35e-3, count), rng.uniform(0.02, 0.3, count)
    return np.stack([r, angle, np.full(count, 0.1)], axis=1)[:, : len(observer.unknowns)]


def readings_of(observer: ww.Observer, count: int) -> Any:
    """Readings, with one missing and one of no contact besides."""
    y = observer.read(contacts(observer, count), seed=1)
    return np.insert(y, [1, 3], [[np.nan], [0.0]], axis=0)


CORRELATED = receptors.Weber(0.1, correlation=0.3)
OBSERVERS = {
    "compliance": ww.Observer(W, cues.Compliance()),
    "force map": ww.Observer(W, cues.ForceMap()),
    "correlated": ww.Observer(W, cues.ForceMap(), CORRELATED),
    "rubbing": ww.Observer(W, cues.Friction(cues.ForceMap(), 0.2)),
    "two angles": ww.Observer(W, cues.AngleSideAngle()),
    "balance": ww.Observer(W, cues.BalanceOfMoments()),
}


@pytest.mark.parametrize("name", slow_but(OBSERVERS, (2, 3, 5)))
def test_other_readings_and_those_before_change_no_bit(name: str) -> None:
    observer = OBSERVERS[name]
    y = readings_of(observer, 12)
    tree._kept.clear()
    whole = ww.posterior(observer, y)
    same(numbers(ww.posterior(observer, y)), numbers(whole))
    for rows in (slice(0, 1), slice(5, 8), slice(None, None, -1)):
        tree._kept.clear()
        same(numbers(ww.posterior(observer, y[rows])), numbers(whole, rows))


@pytest.mark.slow
def test_an_unknown_friction_does_not_depend_on_what_was_solved_before() -> None:
    observer = ww.Observer(W, cues.Friction(cues.ForceMap()))
    y = readings_of(observer, 3)
    tree._kept.clear()
    fresh = numbers(ww.posterior(observer, y[:1]))
    tree._kept.clear()
    ww.posterior(observer, y[-1:])
    same(numbers(ww.posterior(observer, y[:1])), fresh)


@pytest.mark.parametrize("name", ["compliance", "force map"])
def test_one_worker_gives_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    observer, reports = OBSERVERS[name], []
    y = readings_of(observer, 5)
    alone = ww.posterior(observer, y)
    monkeypatch.setattr(quadrature, "TOGETHER", 2)
    spread = ww.posterior(observer, y, workers=1, progress=lambda *now: reports.append(now))
    same(numbers(spread), numbers(alone))
    np.testing.assert_array_equal(spread.solution.draws(5, 3), alone.solution.draws(5, 3))
    assert reports == [(2, 5), (4, 5), (5, 5)]


@pytest.mark.slow  # of workers: `tests/util` and `tests/recordings`
def test_two_workers_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    observer = OBSERVERS["force map"]
    y = readings_of(observer, 5)
    alone = ww.posterior(observer, y)
    monkeypatch.setattr(quadrature, "TOGETHER", 3)
    same(numbers(ww.posterior(observer, y, workers=2)), numbers(alone))


@pytest.mark.slow
def test_layers_are_spread_by_chunks_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quadrature, "LAYERED", 1)
    observer = ww.Observer(W, cues.UnknownStiffness(cues.ForceMap()))
    y = observer.read([[20e-3, 0.1, 1.0], [25e-3, 0.1, 1.0]], seed=1)
    same(numbers(ww.posterior(observer, y, workers=1)), numbers(ww.posterior(observer, y)))


def test_one_reading_or_none_that_is_usable() -> None:
    observer = OBSERVERS["compliance"]
    y = observer.read(30e-3, seed=1)
    alone, spread = ww.posterior(observer, y), ww.posterior(observer, y, workers=1)
    assert (spread.mean, spread.sd, spread.status) == (alone.mean, alone.sd, alone.status)
    assert ww.posterior(observer, [np.nan], workers=2).status.name == "NOT_A_READING"


def test_workers_that_cannot_be() -> None:
    observer = OBSERVERS["compliance"]
    y = observer.read([[20e-3], [30e-3]], seed=1)
    for workers in (0, -1, 1.5, "two", True):
        with pytest.raises(ValueError, match="workers"):
            ww.posterior(observer, y, workers=workers)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="a cluster has its own workers"):
        ww.posterior(observer, y, workers=2, scheduler="tcp://127.0.0.1:9")
    for method in ("emcee", "laplace"):
        with pytest.raises(ValueError, match=f"spread over workers, got method='{method}'; leave"):
            ww.posterior(observer, y, method, workers=2)


def test_what_one_process_refuses_is_refused_in_the_same_words() -> None:
    observer = ww.Observer(W, cues.Compliance(), receptors.LogNormal(0.1))
    y, sentences = -observer.read([[20e-3], [30e-3]], seed=1), []
    for workers in (None, 1):
        with pytest.raises(ValueError, match="No contact can give the reading") as refused:
            ww.posterior(observer, y, workers=workers)
        sentences.append(str(refused.value))
    assert sentences[0] == sentences[1]
