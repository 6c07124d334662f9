"""What every public class prints: a line with units, six digits at most, 300 characters."""

from __future__ import annotations

import enum
import inspect
import operator
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import behaviour, cues, design, mechanics, receptors, recordings, sweeping
from weberwhisk._util.values import LONGEST, Fields, Line
from weberwhisk.behaviour import effects

CONF = Path(__file__).parent.parent / "docs" / "conf.py"
#: The modules whose public names the reference lists.
PUBLIC = re.findall(r'^    "weberwhisk\.(.+?)":', CONF.read_text("utf-8"), re.M)
#: Protocols, rows of named numbers, and a filter of many contacts.
OTHERS = {"Component", "Effect", "Encoding", "Estimate", "Published", "TrialBefore"}


def public_classes() -> dict[str, type]:
    found = {}
    for module in PUBLIC:
        for name in operator.attrgetter(module)(ww).__all__:
            value = getattr(operator.attrgetter(module)(ww), name)
            if inspect.isclass(value) and not issubclass(value, enum.Enum | Exception):
                found[value.__name__] = value
    return {name: of for name, of in found.items() if name not in OTHERS}


def test_every_public_class_prints_by_one_mechanism() -> None:
    assert [n for n, of in public_classes().items() if not issubclass(of, Fields | Line)] == []


def objects() -> list[Any]:
    """One of every public class, most with a number that has a long binary tail."""
    third = 0.1 + 0.2  # 0.30000000000000004
    whisker = ww.Whisker.from_identity("C2")  # 0.033600000000000005 m long
    few = ww.WhiskerArray(identities=["C2", "C3"])
    afferents = receptors.Afferents(75, third, third * 1e3)
    tap, pair = cues.Compliance(), cues.ForceMap()
    observer = ww.Observer(whisker, tap)
    readings = ww.Observer(whisker, pair).read([[20e-3, 0.2], [20e-3, 0.25]], seed=1)
    trials = ww.simulate_trials(weber_fraction=third, seed=1)
    fit = ww.fit_weber(trials)
    two = ww.simulate_trials(standards=[1.0, 4.0], seed=1)
    hypotheses = design.taper(whisker)
    scheme = design.Scheme.spaced(hypotheses[0].encoding, [15e-3, 30e-3], trials=5)
    plan = ww.plan_experiment("C2", standards=[10e-3, 30e-3], trials=10, runs=0)
    placer = design.BayesianPlacer(hypotheses[0], scheme, seed=1)
    return [
        whisker, tap, pair, observer, trials, fit, fit.posterior, fit.model, scheme, plan, placer,
        ww.press(whisker, 20e-3, third), ww.press(whisker, np.linspace(5e-3, 30e-3, 99), third),
        ww.flick_past(whisker, [10e-3, 20e-3]), mechanics.choose_model(whisker, 20e-3, third),
        ww.posterior(observer, observer.read(20e-3, seed=1)),
        ww.touches(ww.Observer(whisker, pair), readings),
        receptors.Weber(), receptors.Weber(third), receptors.LogNormal(),
        receptors.GeneralisedWeber(third, floor=third), receptors.Saturating(0.1, ceiling=third),
        receptors.Events([[third], [1.0]]),
        receptors.Joint([receptors.Weber(third), receptors.Weber()], [1, 1]),
        cues.AngleSideAngle(), cues.BalanceOfMoments(), cues.SpaceMap(), cues.TwoWhiskers(),
        cues.ContactAndDetachment(), cues.Vibration(), cues.VibrissaLength(),
        cues.Fused(tap, pair), cues.UnknownStiffness(pair, third), cues.Friction(pair, third),
        behaviour.IdentityEncoding(), behaviour.CueEncoding(observer, unit=third),
        *behaviour.TASKS.values(), *effects.EFFECTS.values(),
        behaviour.weber_law_test(ww.fit_weber(two)), ww.compare({"a": fit, "b": fit}),
        behaviour.Priors(), *hypotheses, design.Evidence(bayes_factor=third * 1e2),
        design.Constraints(step=third), design.SubjectPopulation(third),
        design.Session(placer, None), placer.next(),
        ww.jnd_curve(observer, [10e-3, 20e-3], n_readings=4, seed=1), recordings.HingedTap(),
        few, ww.ArrayObserver(few, angle_sd=third), *few.whiskers.values(), afferents,
        receptors.SpikeCount(afferents), mechanics.modes.modes(whisker, count=3),
        mechanics.Spiral(third, third), mechanics.Parabola(third), sweeping.peg(20e-3, third),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def printed() -> list[str]:
    return [repr(each) for each in objects()]


def test_no_object_prints_more_than_a_line(printed: list[str]) -> None:
    assert [text for text in printed if len(text) > LONGEST or "\n" in text] == []


def test_numbers_have_six_digits_and_arrays_are_shortened(printed: list[str]) -> None:
    wrong = re.compile(r"[1-9](\.?\d){6}|array\(|object at 0x")
    assert [text for text in printed if wrong.search(text)] == []
    assert repr(ww.Whisker.from_identity("C2")) == "Whisker(0.0336, 6.95e-05, 1.75e-06)"


def test_a_weber_fraction_is_shown_also_by_default() -> None:
    assert repr(receptors.Weber()) == "Weber(0.1)"
    assert repr(receptors.LogNormal()) == "LogNormal(0.1)"


def test_results_say_their_units(printed: list[str]) -> None:
    units = {"Posterior": "mm", "Touches": "mm", "Bending": "µN m", "JNDCurve": "mm",
             "FlickPast": "°", "Plan": "mm", "Modes": "Hz"}  # fmt: skip
    for name, unit in units.items():
        text = next(text for text in printed if text.startswith(f"<{name}: "))
        assert unit in text


def test_trials_show_their_rows_in_a_notebook() -> None:
    html = ww.simulate_trials(seed=1)._repr_html_()
    assert html.startswith("<p><b>Trials</b>: 360 with an answer")
    assert "<table" in html
