"""Receptors, cues and whiskers are values, and new ones take a few lines."""

from __future__ import annotations

import inspect
import pickle
from copy import copy
from dataclasses import FrozenInstanceError, dataclass, is_dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import weberwhisk as ww
from weberwhisk import cues
from weberwhisk.cues import Compliance, ForceMap
from weberwhisk.inference.coordinates import UNITS
from weberwhisk.receptors import (
    Afferents,
    Events,
    Gaussian,
    GeneralisedWeber,
    Joint,
    LogNormal,
    ReceptorNoise,
    Saturating,
    SpikeCount,
    Weber,
)
from weberwhisk.sensitivity import weber_propagation

W = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
NOISES = [
    lambda: Weber([0.1, 0.2], correlation=0.3),
    lambda: GeneralisedWeber(0.1, floor=[0.2, 0.0], ceiling=9.0),
    lambda: Saturating(0.1, ceiling=9.0, sharpness=2.0),
    lambda: LogNormal(0.1, correlation=-0.2),
    lambda: SpikeCount(Afferents(7, 1e-2, 10.0), Afferents(3, [0.1, 1.0], 30.0)),
    lambda: Events([[0.0], [1.0], [2.0]], misreport=0.1),
    lambda: Joint([Weber(0.1), GeneralisedWeber(0, floor=0.1)], [1, 1]),
    lambda: Joint([Joint([LogNormal(0.1), Weber(0.2)], [1, 1]), Weber([0.3])], [2, 1]),
]
#: Every law that the package has, without the classes that laws derive from.
LAWS = [
    law
    for law in (getattr(ww.receptors, name) for name in ww.receptors.__all__)
    if isinstance(law, type) and issubclass(law, ReceptorNoise) and is_dataclass(law)
]


@dataclass(frozen=True, eq=False, repr=False)
class SquareRoot(Gaussian):
    """A new law of noise: sd = size·√|I|."""

    size: float = 0.1
    correlation: float = 0.0

    def sd(self, signals):
        return self.size * np.sqrt(np.abs(signals))


def test_every_law_is_among_these():
    assert {type(make()) for make in NOISES} == set(LAWS)


@pytest.mark.parametrize("make", NOISES)
def test_noise_is_a_value(make):
    first, other = make(), make()
    assert first == other
    assert hash(first) == hash(other)
    assert copy(first) == pickle.loads(pickle.dumps(first)) == first
    assert isinstance(first, Events) or eval(repr(first), vars(ww.receptors)) == first
    with pytest.raises(FrozenInstanceError):
        first.weber_fraction = 0.5
    assert len({make() for make in NOISES for _ in range(2)}) == len(NOISES)


def test_arrays_among_the_fields_are_copies_that_cannot_be_written():
    own = np.array([0.1, 0.2])
    noise = Weber(own)
    own[0] = 9.0
    assert_allclose(noise.weber_fraction, [0.1, 0.2])
    with pytest.raises(ValueError, match="read-only"):
        noise.weber_fraction[0] = 9.0
    assert Weber(0.1) != LogNormal(0.1)
    assert Weber(0.1) != Weber(0.2)


def test_whiskers_and_profiles_are_values():
    assert ww.Whisker(50e-3, 100e-6, 5e-6, 3e9) == W
    assert len({W, W.cylinder(), W.cylinder(), ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)}) == 2
    assert (
        ww.mechanics.Profile.of(W)
        == ww.mechanics.Profile.of(W)
        != ww.mechanics.Profile.of(W.cylinder())
    )
    assert hash(ww.mechanics.Profile.of(W)) == hash(ww.mechanics.Profile.of(W))
    bent = ww.mechanics.Profile.of(W).curved(ww.mechanics.Parabola(20.0))
    assert (
        bent
        == ww.mechanics.Profile.of(W).curved(ww.mechanics.Parabola(20.0))
        != ww.mechanics.Profile.of(W)
    )
    with pytest.raises(FrozenInstanceError):
        W.length = 1.0
    with pytest.raises(ValueError, match="read-only"):
        bent.arc[0] = 1.0


def test_a_new_law_of_noise_in_four_lines():
    """It runs through the observer, the posterior and the JND, with the right numbers."""
    size = 0.1 * np.sqrt(Compliance().signals(W, np.array([20e-3]))[0][0])
    same = ww.Observer(W, Compliance(), Weber(0.1))
    new = ww.Observer(W, Compliance(), SquareRoot(size))
    at = np.array([20e-3])
    assert_allclose(weber_propagation(new, at), weber_propagation(same, at))
    # Σ⁻¹μ'² + ½(ln Σ)'²: the second term is a quarter of Weber's, as sd goes with √I.
    assert_allclose(new.information(at) / same.information(at), (100 + 0.5) / (100 + 2.0))
    choices = ww.behaviour.CueEncoding(new)  # without a Weber fraction its noise is all known
    assert_allclose(choices.floor_sd(at), new.noise.sd(new.signals(at)[0]))
    assert not choices.sd_per_weber_fraction(at).any()
    p = ww.posterior(new, new.read(at, seed=1))
    r = np.linspace(1e-4, W.length, 20_001)[:-1]
    density = np.exp(new.log_likelihood(new.read(at, seed=1), r[:, None]))
    assert_allclose(p.mean, (r * density).sum() / density.sum(), rtol=1e-5)
    two = ww.Observer(W, ForceMap(), SquareRoot(1e-3 * size))
    fast, slow = (
        ww.posterior(two, two.read([20e-3, 0.2], 1), method=m, seed=1)
        for m in ("quadrature", "emcee")
    )
    assert np.all(np.abs(fast.mean - slow.mean) < 0.1 * fast.sd)


# -- cues ----------------------------------------------------------------------------------------

CUES = [
    lambda: cues.Compliance(tap_angle=0.1, velocity_spread=0.5),
    lambda: ForceMap(["moment", "transverse_force"]),
    lambda: ForceMap("moment", deflection_angle=0.2),
    lambda: cues.SpaceMap(),
    lambda: cues.UnknownStiffness(ForceMap(), 0.3),
    lambda: cues.Fused(Compliance(), cues.Vibration(4, phase=True)),
    lambda: cues.Vibration(2, impulse=1e-9, damping_ratio=0.01),
    lambda: cues.VibrissaLength(spread=0.1),
    lambda: cues.ComparativeLength([40e-3], [[-1e-3, 0.0]], position_sd=2e-3),
    lambda: cues.AngleSideAngle(5e-3, side_sd=1e-3),
    lambda: cues.TwoWhiskers(neighbour_length=20e-3),
    lambda: cues.ContactAndDetachment(push=0.2),
    lambda: cues.BalanceOfMoments(1.2, effort=None),
]


@pytest.mark.parametrize("make", CUES)
def test_a_cue_is_a_value(make):
    first, other = make(), make()
    assert first == other
    assert hash(first) == hash(other)
    assert copy(first) == pickle.loads(pickle.dumps(first)) == first
    assert repr(first).startswith(type(first).__name__)
    with pytest.raises(FrozenInstanceError):
        first.side = 0.5
    assert len({make() for make in CUES for _ in range(2)}) == len(CUES)


def test_a_cue_that_differs_is_made_of_another():
    """`dataclasses.replace` met a TypeError: signals had another name where they are given."""
    three = ("moment", "axial_force", "transverse_force")
    assert replace(ForceMap(three), deflection_angle=0.2) == ForceMap(three, deflection_angle=0.2)
    assert replace(cues.SpaceMap(three), roll=0.5) == cues.SpaceMap(three, roll=0.5)
    soft = cues.UnknownStiffness(ForceMap(), soft_signals=["moment"])
    assert replace(soft, spread=0.1) == cues.UnknownStiffness(ForceMap(), 0.1, ["moment"])


def test_every_unknown_has_its_unit():
    conditions = [
        cues.Friction(ForceMap()), cues.UnknownCurvature(ForceMap(), 2.0),
        cues.UnknownHinge(ForceMap(), 0.5), cues.UnknownStiffness(ForceMap()),
        cues.UnknownRoll(cues.SpaceMap(), 0.3),
    ]  # fmt: skip
    unknowns = {name for cue in (*(make() for make in CUES), *conditions) for name in cue.unknowns}
    assert unknowns - set(UNITS) == {"stiffness"}  # a ratio


@pytest.mark.parametrize("make", CUES)
def test_the_slopes_that_a_cue_gives_are_its_own(make):
    """`Cue.jacobian`, by differences, beside what each cue knows in closed form."""
    cue = make()
    observer = ww.Observer(W, cue)
    x = np.full((1, len(cue.unknowns)), -0.2)
    contact = observer.space.constrain(x)[0]
    own = cue.jacobian(W, contact)
    assert_allclose(own, cues.Cue.jacobian(cue, W, contact), rtol=1e-5, atol=1e-7 * abs(own).max())


@dataclass(frozen=True, eq=False, repr=False)
class Lever(cues.Cue):
    """A new cue: moment over transverse force, nearly the distance, at a known angle."""

    deflection_angle: float = 0.1
    signal_names = ("lever_arm",)

    def signals(self, whisker, contact, *, model=None):
        bent = ww.press(whisker, contact[..., 0], self.deflection_angle, model=model)
        return np.asarray(bent.moment / bent.transverse_force)[..., None], np.asarray(bent.outcome)


def test_a_new_cue_in_four_lines():
    observer = ww.Observer(W, Lever(0.1))
    at = np.array([20e-3])
    # M = Fy·x + Fx·y at the contact: the arm is r but for terms of the second order in θ_d.
    assert_allclose(observer.signals(at)[0], at, rtol=0.02)
    assert_allclose(weber_propagation(observer, at), 0.1 * at[0], rtol=0.03)
    p = ww.posterior(observer, observer.read(at, seed=1))
    checked = ww.posterior(observer, observer.read(at, seed=1), method="emcee", seed=2)
    assert abs(p.mean - checked.mean) < 0.1 * p.sd
    r = np.linspace(1e-4, 0.999 * W.length, 4001)
    density = np.exp(observer.log_likelihood(observer.read(at, seed=1), r[:, None]))
    assert_allclose(p.mean, (r * density).sum() / density.sum(), rtol=1e-3)
    table = ww.jnd_curve(observer, radial_distance=[10e-3, 20e-3], n_readings=20, seed=1)
    assert np.isfinite(np.asarray(table[["propagation", "fisher", "posterior"]], dtype=float)).all()
    both = ww.Observer(W, cues.Fused(Lever(0.1), Compliance()))
    assert weber_propagation(both, at) < weber_propagation(observer, at)


# -- misuse --------------------------------------------------------------------------------------

JUNK = ["text", None, np.nan, np.inf, -np.inf, -1, 0, 1e300, 3.0, 2.5, True, object(), [], {}, ()]
JUNK += [1j, ["a", "b"], [1.0, "b"], [[1, 2], [3]], float, ForceMap, b"x", np.zeros((2, 0))]
GOOD = {  # what each class needs at least
    ww.Whisker: (50e-3, 100e-6, 5e-6),
    ww.mechanics.Parabola: (20.0,),
    ww.mechanics.Spiral: (),
    ww.mechanics.Profile: (W, [0, 50e-3], [1e-4, 5e-6], [0.0, 0.0], ww.mechanics.Spiral(1.0)),
    ww.mechanics.Profile.of: (W,),
    ww.mechanics.Profile.tabulated: ([0, 50e-3], [1e-4, 5e-6]),
    Events: ([[0], [1]],),
    Joint: ([Weber()], [1]),
    Afferents: (3, 1e-2, 10.0),
    SpikeCount: (Afferents(3, 1e-2, 10.0),),
    cues.UnknownStiffness: (ForceMap(),),
    cues.Friction: (ForceMap(),),
    cues.UnknownCurvature: (ForceMap(), 5.0),
    cues.UnknownHinge: (ForceMap(), 0.3),
    cues.UnknownRoll: (cues.SpaceMap(), 0.3),
    cues.Fused: (ForceMap(), Compliance()),
    cues.ComparativeLength: ([40e-3], [[-1e-3, 0.0]]),
    GeneralisedWeber: (0.1,),
    Saturating: (0.1,),
    ww.Observer: (W, ForceMap()),
}
NAMED = {GeneralisedWeber: {"floor": 0.1}, Saturating: {"ceiling": 1.0}}
EVERY = [
    *GOOD,
    *(getattr(cues, n) for n in cues.__all__ if n not in ("Cue", "MuscleCurve")),
    *LAWS,
]


@pytest.mark.parametrize("make", dict.fromkeys(EVERY), ids=lambda m: m.__qualname__)
def test_a_constructor_takes_a_value_or_refuses_it_in_one_sentence(make):
    good, named = GOOD.get(make, ()), NAMED.get(make, {})
    try:
        make(*good, **named)
    except TypeError as error:
        pytest.fail(f"add {make.__qualname__} to GOOD: the arguments it needs at least ({error})")
    parameters = inspect.signature(make).parameters
    only = [n for n, p in parameters.items() if p.kind == p.KEYWORD_ONLY]
    refusals, others = [], []
    for junk in JUNK:
        calls = [((*good[:i], junk, *good[i + 1 :]), named) for i in range(max(1, len(good)))]
        if not any(p.kind != p.KEYWORD_ONLY for p in parameters.values()):
            calls = []
        for args, kwargs in [*calls, *((good, named | {name: junk}) for name in only)]:
            try:
                assert isinstance(repr(make(*args, **kwargs)), str)
            except ValueError as error:
                refusals.append(str(error))
            except Exception as error:
                others.append((args, kwargs, repr(error)))
    assert others == []
    assert refusals or make is cues.SpaceMap
    for words in refusals:
        assert 20 < len(words) < 500
        assert "\n" not in words
        assert "object at 0x" not in words
