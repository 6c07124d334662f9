"""One front for all models: the cheapest that a scene needs, which and why, and whether rightly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.mechanics import Model, closed_form, elastica, profile, rod
from weberwhisk.mechanics.ladder import press_by
from weberwhisk.mechanics.shape import Parabola, Profile
from weberwhisk.whisker import _morphology

STRAIGHT = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9)
CURVED = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=5.0)
SIGNALS = ("moment", "axial_force", "transverse_force")


def signals(b):
    return np.stack([getattr(b, name) for name in SIGNALS])


# The front door


def test_by_default_each_scene_gets_the_lowest_rung_that_models_all_of_it():
    assert ww.bend(STRAIGHT, 30e-3, 1e-5).model == Model.ELASTICA
    assert ww.bend(STRAIGHT, 30e-3, 1e-5, friction_angle=-0.1).model == Model.PROFILE
    assert ww.bend(CURVED, 30e-3, 1e-5).model == Model.PROFILE
    assert ww.press(CURVED, 30e-3, 0.3).model == Model.PROFILE
    assert ww.press(STRAIGHT, 30e-3, 0.3, 0.1).model == Model.PROFILE
    assert ww.press(STRAIGHT, 30e-3, 0.3, roll=0.5).model == Model.ELASTICA
    assert ww.press(CURVED, 30e-3, 0.3, roll=0.5).model == Model.ROD
    assert ww.press(Profile.of(STRAIGHT), 30e-3, 0.1).model == Model.PROFILE
    assert ww.press(STRAIGHT, 30e-3, 0.1, model="closed_form").model == Model.CLOSED_FORM


def test_a_profile_takes_the_place_of_its_whisker():
    p, r, theta, psi = Profile.of(CURVED), 30e-3, np.array([-0.1, 0.3]), 0.1
    for a, b in (
        (ww.bend(p, r, 3e-5, psi), ww.bend(CURVED, r, 3e-5, psi)),
        (ww.press(p, r, theta, psi), ww.press(CURVED, r, theta, psi)),
        (ww.press(p, r, theta, roll=0.4), ww.press(CURVED, r, theta, roll=0.4)),
    ):
        np.testing.assert_array_equal(signals(a), signals(b))
    np.testing.assert_array_equal(
        ww.mechanics.signal_jacobian(p, r, theta, psi),
        ww.mechanics.signal_jacobian(CURVED, r, theta, psi),
    )
    np.testing.assert_array_equal(
        ww.flick_past(p, r, psi, side=-1).deflection_angle,
        ww.flick_past(CURVED, r, psi, side=-1).deflection_angle,
    )


@pytest.mark.parametrize(
    ("psi", "roll"), slow_but([(0.0, 0.0), (0.2, 0.0), (0.0, 0.3), (0.1, -1.2)], (0, 3))
)
def test_jacobian_is_the_slope_of_press(psi, roll):
    """Out of the plane the object's height goes with its distance, and is sloped as well."""
    r, theta, h = 30e-3, 0.3, 1e-4
    slopes = ww.mechanics.signal_jacobian(CURVED, r, theta, psi, roll=roll)
    for k, (dr, dt) in enumerate(((h * r, 0.0), (0.0, h))):
        at = np.array([1, -1, 2, -2])
        s = signals(ww.press(CURVED, r + at * dr, theta + at * dt, psi, roll=roll))
        central = (8 * (s[:, 0] - s[:, 1]) - (s[:, 2] - s[:, 3])) / (12 * (dr + dt))
        np.testing.assert_allclose(slopes[:, k], central, rtol=1e-6)


def test_a_rolled_whisker_is_met_at_rest():
    """The push starts from no force, whatever the roll, and mirrored rolls feel the same."""
    roll = np.array([-2.0, -0.5, 0.5, 1.2])
    rest = ww.mechanics.rest_angle(CURVED, 30e-3)
    azimuth = np.arctan2(np.sin(rest) * np.cos(roll), np.cos(rest))
    b = ww.press(CURVED, 30e-3, azimuth, roll=roll)
    assert np.all(np.abs(b.force) < 1e-9 * CURVED.force_scale)
    push = ww.press(CURVED, 30e-3, azimuth + 0.2, roll=roll)
    mirrored = ww.press(CURVED, 30e-3, azimuth + 0.2, roll=-roll)
    np.testing.assert_allclose(signals(push), signals(mirrored), rtol=1e-8)
    assert np.all(push.moment > 0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: ww.press(CURVED, 3e-2, 0.1, model="elastica"), "curvature is not modelled by the"),
        (lambda: ww.bend(STRAIGHT, 3e-2, 1e-5, 0.1, model="closed_form"), "Friction is not model"),
        (lambda: ww.press(CURVED, 3e-2, 0.1, roll=0.1, model="profile"), "write model='rod'"),
        (lambda: ww.press(Profile.of(STRAIGHT), 3e-2, 0.1, model="elastica"), "stiffness profile"),
        (lambda: ww.bend(CURVED, 3e-2, 1e-5, model="rod"), "choose one of closed_form, elastica"),
        (lambda: ww.bend(STRAIGHT, 3e-2, 1e-5, np.nan), "friction_angle must be finite"),
        (lambda: ww.press(STRAIGHT, 3e-2, 0.1, roll=np.inf), "roll must be finite"),
        (lambda: ww.choose_model(STRAIGHT, 3e-2, 0.1, tolerance=0.0), "tolerance must be above"),
        (lambda: ww.choose_model(STRAIGHT, 3e-2, 0.1, weber_fraction=-1), "weber_fraction must be"),
        (lambda: ww.choose_model(STRAIGHT, 3e-2, 0.1, 2.0), "friction_angle must be between"),
        (lambda: ww.choose_model(STRAIGHT, [1e-2] * 3, [0.1] * 2), "must broadcast"),
        (lambda: ww.choose_model(STRAIGHT, 3e-2, 0.1, cue=Felt(("warmth",))), "got warmth for"),
        (lambda: ww.choose_model(STRAIGHT, 3e-2, 0.1, cue=Felt(("moment",), 2)), "no more"),
        (lambda: ww.flick_past(STRAIGHT, 3e-2, side=2), "side must be 1 or -1"),
        (lambda: ww.flick_past(CURVED, 3e-2, roll=0.2), "a roll of 0.2 rad; write ww.press"),
        (lambda: ww.bend(CURVED, 3e-2, 1e-5, roll=0.2), "write ww.mechanics.rod.bend"),
        (lambda: ww.Observer(CURVED, ww.cues.Vibration()), "for straight whiskers, got curvature"),
    ],
)
def test_misuse_is_one_sentence(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@dataclass
class Felt:
    signal_names: tuple[str, ...]
    count: int = 1

    @property
    def unknowns(self):
        return ("radial_distance", "deflection_angle")[: self.count]


# Every model on one table of scenes

COARSE = Profile.of(STRAIGHT).curved(Parabola(0.4))
TABLE = {  # whisker, r (m), push (rad), friction angle, roll
    "light tap near the base": (STRAIGHT, 8e-3, 0.02, 0.0, 0.0),
    "light tap near the tip": (STRAIGHT, 47e-3, 0.002, 0.0, 0.0),
    "firm press": (STRAIGHT, 30e-3, 0.4, 0.0, 0.0),
    "close to the fold": (STRAIGHT, 35e-3, 0.42, 0.0, 0.0),
    "cylinder": (STRAIGHT.cylinder(), 30e-3, -0.5, 0.0, 0.0),
    "perfect cone": (ww.Whisker(40e-3, 80e-6, 0.0), 20e-3, 0.3, 0.0, 0.0),
    "hardly curved": (COARSE, 20e-3, 0.1, 0.0, 0.0),
    "convex side": (CURVED, 25e-3, 0.3, 0.0, 0.0),
    "concave side": (CURVED, 25e-3, -0.3, 0.0, 0.0),
    "friction": (STRAIGHT, 25e-3, 0.3, -0.1, 0.0),
    "friction on a curved whisker": (CURVED, 15e-3, 0.5, 0.2, 0.0),
    "rolled a little": (COARSE, 30e-3, 0.2, 0.0, 0.3),
    "rolled": (CURVED, 25e-3, 0.3, 0.0, 0.8),
    "curved across the push, with friction": (CURVED, 30e-3, 0.2, -0.1, np.pi / 2),
}


@pytest.mark.parametrize("name", TABLE)
def test_every_rung_on_one_scene(name):
    """Each model against the top one, which test_elastica, test_profile and test_rod hold."""
    whisker, r, push, psi, roll = TABLE[name]
    azimuth, _ = first_touch(whisker, r, roll)
    theta = azimuth + push
    choice = ww.choose_model(whisker, r, theta, psi, roll=roll)
    by_model = [press_by(whisker, r, theta, psi, roll, model) for model in Model]
    top = ww.press(whisker, r, theta, psi, roll=roll)
    assert [b.model for b in by_model] == list(Model)
    assert top.outcome is Outcome.HELD
    for model, b in enumerate(by_model):
        assert (b.radial_distance, b.deflection_angle) == (r, theta)
        if model >= top.model:
            np.testing.assert_allclose(signals(b), signals(top), rtol=2e-7)
            assert choice.error[model] == 0
        elif np.isfinite(choice.error[model]):
            off = np.max(np.abs(signals(b) / signals(top) - 1))
            assert choice.error[model] == pytest.approx(off, rel=1e-3, abs=1e-6)
        else:
            assert not b.held


def first_touch(whisker, r, roll):
    """Azimuth and elevation at which a rolled whisker at rest has the distance r."""
    rest = profile.rest_angle(whisker, r)
    azimuth = np.arctan2(np.sin(rest) * np.cos(roll), np.cos(rest))
    return azimuth, np.arcsin(np.sin(rest) * np.sin(roll))


# Which model a scene needs


def test_one_call_may_take_several_rungs():
    w = ww.Whisker(50e-3, 100e-6, 5e-6, 3e9, curvature=np.array([0.0, 0.5, 5.0, 5.0]))
    r, theta = 25e-3, np.array([[0.01], [0.4]])
    scenes = {"friction_angle": 0.0, "roll": np.array([0.0, 0.0, 0.0, 1.0])}
    choice = ww.choose_model(w, r, theta, **scenes, weber_fraction=0.03)
    assert choice.model.shape == choice.why.shape == (2, 4)
    assert choice.error.shape == choice.bias.shape == (2, 4, 4)
    assert set(np.ravel(choice.model)) == set(Model)
    each = [press_by(w, r, theta, 0.0, scenes["roll"], model) for model in Model]
    b = np.take_along_axis(np.stack([signals(b) for b in each]), choice.model[None, None], 0)[0]
    exact = ww.press(w, r, theta, **scenes)
    # What the chosen model is off by is what it says, and so small that no one feels it.
    off = np.abs(b / signals(exact) - 1)
    assert np.all(off[0] <= 0.1 * 0.03)
    said = np.take_along_axis(choice.error, choice.model[..., None], -1)[..., 0]
    np.testing.assert_allclose(off.max(axis=0), said, rtol=1e-3, atol=1e-6)
    one = ww.choose_model(ww.Whisker(50e-3, 100e-6, 5e-6, 3e9), r, 0.4)
    assert isinstance(one.model, Model)
    assert isinstance(one.why, str)


def test_a_cue_is_judged_by_what_it_feels():
    """A model may do for the moment and not for the map; on a cylinder's ridge too it is judged."""
    theta = first_touch(CURVED, 20e-3, 0.0)[0] + 0.1
    alone = ww.choose_model(CURVED, 20e-3, theta)
    mapped = ww.choose_model(CURVED, 20e-3, theta, cue=ww.cues.ForceMap())
    tapped = ww.choose_model(CURVED, 20e-3, theta, cue=ww.cues.Compliance())
    assert mapped.bias[1] > 3 * alone.bias[1] > 0
    np.testing.assert_array_equal(tapped.bias, alone.bias)
    np.testing.assert_array_equal(mapped.error, alone.error)
    ridge = ww.choose_model(STRAIGHT.cylinder(), 20e-3, 0.3, cue=ww.cues.ForceMap())
    assert 0 < ridge.bias[0] < np.inf


def test_where_nothing_is_held_the_rung_that_knows_is_taken():
    r = np.array([35e-3, 60e-3, 49.999e-3])
    theta = np.array([0.6, 0.1, 0.5])
    for w in (STRAIGHT, CURVED):
        b, choice = ww.press(w, r, theta), ww.choose_model(w, r, theta)
        np.testing.assert_array_equal(b.model, choice.model)
        assert not np.any(b.held)
        assert np.all(np.isnan(signals(b)))
        assert np.all(np.isnan(b.error))
    rest = ww.mechanics.rest_angle(CURVED, 30e-3)
    none = ww.choose_model(CURVED, 30e-3, rest)  # no push: the error is that of a small one
    assert none.bias[1] == pytest.approx(
        ww.choose_model(CURVED, 30e-3, rest + 1e-5).bias[1], rel=1e-2
    )


# Ten thousand scenes


@dataclass
class Scenes:
    """Random whiskers of the rat's pad, held against a point; k and tolerance of each."""

    whisker: ww.Whisker
    bow: np.ndarray  # coefficient of y = a·x², 1/m
    friction: np.ndarray
    roll: np.ndarray
    r: np.ndarray
    push: np.ndarray
    weber_fraction: np.ndarray
    tolerance: np.ndarray
    mapped: np.ndarray  # judged by moment and axial force, else by the moment alone

    @classmethod
    def random(cls, n, seed):
        rng = np.random.default_rng(seed)
        rows = list(_morphology().values())
        pick = rng.integers(0, len(rows), n)
        length, base = (
            np.array([row[name] for row in rows])[pick] * unit
            for name, unit in (("length_mm", 1e-3), ("base_diameter_um", 0.5e-6))
        )
        # Belli et al. 2017: radius ratios have median 31.5, quartiles 23 and 43.5.
        ratio = np.maximum(31.5 * np.exp(0.47 * rng.standard_normal(n)), 1.5)
        ratio[rng.random(n) < 0.1] = 1.0

        def some(share, low, high):
            size = np.exp(rng.uniform(np.log(low), np.log(high), n)) * rng.choice([-1.0, 1.0], n)
            return np.where(rng.random(n) < share, size, 0.0)

        whisker = ww.Whisker(length, base, base / ratio)
        bow, friction, roll = some(0.7, 0.01, 0.4), some(0.25, 3e-3, 0.45), some(0.3, 0.05, 3.1)
        r = rng.uniform(0.05, 0.98, n) * length
        # Half even up to just past the straight whisker's fold, half crowded towards it.
        share, crowded = rng.random(n), rng.random(n) < 0.5
        share = 1.05 * np.where(crowded, np.sin(share * np.pi / 2), share)
        push = share * elastica.flick_past(whisker, r).deflection_angle * rng.choice([-1, 1], n)
        k = np.exp(rng.uniform(np.log(0.005), np.log(0.5), n))
        tolerance = np.exp(rng.uniform(np.log(0.03), np.log(0.3), n))
        mapped = rng.random(n) < 0.5
        return cls(whisker, bow / length, friction, roll, r, push, k, tolerance, mapped)

    def profile(self, index):
        w = self.whisker
        part = ww.Whisker(w.length[index], w.base_radius[index], w.tip_radius[index])
        return Profile.of(part).curved(Parabola(self.bow[index]))


def truth(scenes):
    """Deflection angle (n,), top model (n,), and of every model the bias (4, n), by full solutions.

    The bias is infinite where the outcome is not that of the top model. Every model is called by
    its own module; nothing of the ladder is used.
    """
    n = scenes.r.size
    everything = np.arange(n)
    azimuth, height = first_touch(scenes.profile(everything), scenes.r, scenes.roll)
    theta = azimuth + scenes.push
    top = np.where((scenes.bow != 0) | (scenes.friction != 0), Model.PROFILE, Model.ELASTICA)
    top = np.where((scenes.bow != 0) & (scenes.roll != 0), Model.ROD, top)
    found, outcome = np.full((4, 3, n), np.nan), np.full((4, n), Outcome.OUT_OF_REACH)
    reached = ~np.isnan(theta)
    push = np.where(reached, scenes.push, 0.0)
    for model, module in enumerate((closed_form, elastica)):
        b = module.press(scenes.whisker, scenes.r, push)
        found[model], outcome[model] = signals(b), np.where(reached, b.outcome, outcome[model])
    slope = elastica.signal_jacobian(scenes.whisker, scenes.r, push)[..., 1].T.copy()

    i = np.flatnonzero(reached & (top >= Model.PROFILE))
    flat = scenes.profile(i).curved(Parabola(scenes.bow[i] * np.cos(scenes.roll[i])))
    angle = np.nan_to_num(profile.rest_angle(flat, scenes.r[i]) + push[i])
    b = profile.press(flat, scenes.r[i], angle, scenes.friction[i])
    found[2][:, i], outcome[2, i] = signals(b), b.outcome
    slope[:, i] = profile.signal_jacobian(flat, scenes.r[i], angle, scenes.friction[i])[..., 1].T

    def in_space(i, theta):
        place = np.cos(height[i]) * np.stack([np.cos(theta), np.sin(theta)])
        point = scenes.r[i] * np.stack([*place, np.sin(height[i])])
        b = rod.press(scenes.profile(i), point.T, scenes.friction[i], plane=scenes.roll[i])
        return np.stack([b.moment[:, 2], b.axial_force, b.force[:, 1]]), b.outcome

    i = np.flatnonzero(reached & (top == Model.ROD))
    found[3][:, i], outcome[3, i] = in_space(i, theta[i])
    i = i[scenes.mapped[i] & (outcome[3, i] == Outcome.HELD)]
    h = 1e-5 * np.abs(push[i]) + 1e-7
    slope[:, i] = (in_space(i, theta[i] + h)[0] - in_space(i, theta[i] - h)[0]) / (2 * h)

    for model in (2, 3):
        same = top < model
        found[model][:, same], outcome[model, same] = (
            found[model - 1][:, same],
            outcome[model - 1, same],
        )
    with np.errstate(all="ignore"):
        off = (found - found[3]) / found[3]
        across = slope[:2] / found[3][:2]  # what an unknown angle could explain
        across = np.stack([across[1], -across[0]]) / np.hypot(*across)
        along = np.abs((across * off[:, :2]).sum(axis=1))
        bias = np.where(scenes.mapped, along, np.abs(off[:, 0])) / scenes.weber_fraction
    bias = np.where(outcome[3] == Outcome.HELD, bias, 0.0)
    return theta, outcome[3] == Outcome.HELD, np.where(outcome == outcome[3], bias, np.inf)


def scores(n, seed):
    """Share of the scenes where the model taken is within tolerance, and where it is the cheapest.

    Both of all scenes, held or not, then of those held.
    """
    scenes = Scenes.random(n, seed)
    theta, held, bias = truth(scenes)
    taken = np.zeros(n, dtype=int)
    for mapped, cue in ((False, None), (True, ww.cues.ForceMap())):
        i = np.flatnonzero((scenes.mapped == mapped) & ~np.isnan(theta))
        choice = ww.choose_model(
            scenes.profile(i),
            scenes.r[i],
            theta[i],
            scenes.friction[i],
            roll=scenes.roll[i],
            cue=cue,
            weber_fraction=scenes.weber_fraction[i],
            tolerance=scenes.tolerance[i],
        )
        taken[i] = choice.model
    meets = bias <= scenes.tolerance
    met = meets[taken, np.arange(n)]
    cheapest = taken == np.argmax(meets, axis=0)
    assert held.sum() > 0.8 * n
    assert np.all(np.bincount(taken[held], minlength=4) > 0.015 * n)  # all four are at work
    return [share[which].mean() for which in (..., held) for share in (met, cheapest)]


@pytest.mark.slow
def test_the_rung_taken_is_right_in_ten_thousand_scenes():
    """Fewer, by hypothesis, are in test_properties."""
    met, cheapest, met_held, cheapest_held = scores(11_400, 2)
    assert met >= 0.995
    assert cheapest >= 0.90
    assert met_held >= 0.995
    assert cheapest_held >= 0.95
