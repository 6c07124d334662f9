"""The map of all forces in space (§2g), against the rod of model 3."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from cue_checks import brute_force, keeps_the_protocol, small_noise_limit
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.cues import (
    ForceMap,
    Friction,
    Fused,
    SpaceMap,
    UnknownHinge,
    UnknownRoll,
    UnknownStiffness,
)
from weberwhisk.cues.force_map import IN_SPACE, SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.inference.coordinates import is_all_around
from weberwhisk.mechanics import rod
from weberwhisk.mechanics.curved_surface import SIX
from weberwhisk.receptors import GeneralisedWeber, Joint
from weberwhisk.sensitivity import prior_draws

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
CURVED = replace(W, curvature=8.0)
SPACE = (*SIGNALS, "moment_direction", "force_direction", "torsion_angle")
CONTACT = np.array([[20e-3, 0.3, -2.0], [30e-3, 0.5, 0.4], [40e-3, 0.2, 2.5]])


def test_the_protocol_is_kept():
    keeps_the_protocol(ww.Observer(W, SpaceMap()), CONTACT)


def test_signals_are_those_of_the_rod():
    r, theta, turn = CONTACT.T
    across = r * np.sin(theta)
    points = np.stack([r * np.cos(theta), across * np.cos(turn), across * np.sin(turn)], axis=-1)
    bent = rod.press(ww.Whisker(50e-3, 100e-6, 5e-6, curvature=1e-9), points)
    signals, _ = SpaceMap().signals(W, CONTACT)
    assert np.allclose(signals[:, 0], np.hypot(*bent.moment[:, 1:].T), rtol=1e-6)
    assert np.allclose(signals[:, 1], bent.axial_force, rtol=1e-6)
    assert np.allclose(signals[:, 2], np.hypot(*bent.force[:, 1:].T), rtol=1e-6)
    assert np.allclose(signals[:, 3], np.arctan2(-bent.moment[:, 1], bent.moment[:, 2]), atol=1e-6)
    assert np.allclose(signals[:, 4], np.arctan2(bent.force[:, 2], bent.force[:, 1]), atol=1e-6)


def test_posteriors_have_the_propagated_width_at_small_noise():
    sizes = default_noise(W, ForceMap(SIGNALS), 0.01)
    noise = Joint([sizes, GeneralisedWeber(0, floor=0.01)], sizes=[3, 2])
    small_noise_limit(ww.Observer(W, SpaceMap(), noise), CONTACT[:2], draws=10, bias=5e-3)


@pytest.mark.parametrize(
    "contact",
    [[20e-3, 0.2, np.nan], [np.nan, 0.2, 0.1], [0.0, 0.2, 0.1], [20e-3, 3.0, 0.1]],
)
def test_what_is_no_contact_has_an_outcome_and_no_signals(contact):
    """A direction that is no number was held with NaN among its signals, the base with infinity."""
    for cue, place in ((SpaceMap(), contact), (ForceMap(), contact[:2])):
        signals, outcome = cue.signals(W, np.array(place))
        assert np.isfinite(signals).all() == (outcome == Outcome.HELD)
        assert np.isfinite(signals).any() == (outcome == Outcome.HELD)


def rod_signals(whisker, place, friction=0.0):
    """The six signals and outcomes of a straight whisker's contacts, by the rod itself."""
    r, theta, turn = place.T
    across = r * np.sin(theta)
    points = np.stack([r * np.cos(theta), across * np.cos(turn), across * np.sin(turn)], axis=-1)
    bent = rod.press(replace(whisker, curvature=1e-9), points, friction, round_back=theta > np.pi)
    return np.concatenate([bent.force * [-1, 1, 1], bent.moment], axis=-1), bent.outcome


def off_by(found, exact):
    """Largest errors over the size of force and of moment."""
    size = [np.linalg.norm(exact[:, part], axis=1) for part in (slice(0, 3), slice(3, 6))]
    return np.max(np.abs(found - exact) / np.repeat(np.stack(size, axis=1), 3, axis=1))


@pytest.mark.parametrize("friction", slow_but([0.45, -0.45], (0,)))
def test_friction_of_a_straight_whisker_is_that_of_the_rod(friction):
    """Up to the fold, and where a force turns its sign."""
    cue, rng = Friction(SpaceMap(IN_SPACE), friction), np.random.default_rng(3)
    r = rng.uniform(3e-3, 48e-3, 24)
    last = cue.forward(W, np.zeros(3)).limit(r)
    place = np.stack([r, last * rng.uniform(0.02, 0.98, 24), rng.uniform(-3.1, 3.1, 24)], axis=-1)
    place[:6, 1] = 0.999 * last[:6]
    found, held = cue.signals(W, place)
    exact, outcome = rod_signals(W, place, friction)
    assert not held.any()
    assert not outcome.any()
    assert off_by(found[:, [IN_SPACE.index(name) for name in SIX]], exact) < 1e-4
    signals = dict(zip(IN_SPACE, found.T, strict=True))
    # Of a force that points away from the push it is the size that is negative.
    turning = "transverse_force" if friction > 0 else "axial_force"
    assert (signals[turning] < 0).any()
    assert signals["force_direction"] == pytest.approx(place[:, 2])
    assert signals["moment_direction"] == pytest.approx(place[:, 2])
    keeps_the_protocol(ww.Observer(W, Friction(SpaceMap(), friction)), CONTACT * [1, 0.5, 1])


FLOORED = Joint(
    [GeneralisedWeber(0.1, floor=[0.0, *2 * [0.01 * W.force_scale]]),
     GeneralisedWeber(0, floor=0.1)], sizes=[3, 2],
)  # fmt: skip


@pytest.mark.parametrize("unknown", [False, pytest.param(True, marks=pytest.mark.slow)])  # 1, 8 s
def test_posteriors_of_a_rubbing_straight_whisker_are_those_of_a_plain_sum(unknown):
    observer = ww.Observer(W, Friction(SpaceMap(), None if unknown else -0.3), FLOORED)
    place = np.array([[30e-3, 0.3, 1.0, 0.2], [20e-3, 0.5, -2.0, -0.2]])
    reading = observer.read(place[:, : 3 + unknown], seed=2)
    found = ww.posterior(observer, reading)
    assert (found.status == ww.Status.CONVERGED).all()
    assert found.estimates["azimuth"].mean == pytest.approx(reading[:, 3:].mean(axis=1), abs=1e-6)
    assert found.estimates["azimuth"].sd == pytest.approx(0.1 / np.sqrt(2), rel=1e-5)
    if unknown:  # a sum of three unknowns, as the azimuth has its own signals
        flat = ww.Observer(W, Friction(ForceMap(SIGNALS)), FLOORED.noises[0])
        mean, sd = brute_force(flat, reading[0, :3], points=1500)
        claim = max(2e-3, 3 * found.estimates["radial_distance"].mean_error[0] / sd)
        assert found.mean[0] == pytest.approx(mean, abs=claim * sd)
        assert found.sd[0] == pytest.approx(sd, rel=claim)
        names = found.solution.draws(4000, 1)[0].reshape(-1, 4).T, found.estimates.values()
        for draws, estimate in zip(*names, strict=True):
            assert draws.mean() == pytest.approx(estimate.mean[0], abs=0.03 * estimate.sd[0])
        return
    mean, sd, parts = brute(observer, reading[0], "profile", 33, ww.posterior(observer, reading[0]))
    for i, estimate in enumerate(parts):
        assert estimate.mean == pytest.approx(mean[i], abs=2e-3 * sd[i])
        assert estimate.sd == pytest.approx(sd[i], rel=2e-3)


@pytest.mark.slow
def test_a_curved_whisker_keeps_the_protocol():
    observer = ww.Observer(CURVED, SpaceMap(SPACE))
    keeps_the_protocol(observer, CONTACT * [1, 0.5, 1])
    assert observer.model == "rod"
    assert observer.why.endswith("the straight elastica has contacts lost that are held")


def test_signals_of_a_curved_whisker_are_those_of_the_rod():
    rng = np.random.default_rng(5)
    place = rng.uniform([10e-3, 0.02, -3.1], [45e-3, 0.1, 3.1], (40, 3))
    cue = SpaceMap(IN_SPACE)
    table, outcome = cue.signals(CURVED, place)
    exact, held = cue.signals(CURVED, place, model="rod")
    assert np.array_equal(outcome, held)
    sizes = np.abs(exact[:, [0, 2]])  # of moment and force
    for i, name in enumerate(IN_SPACE):
        unit = 1.0 if name.endswith(("direction", "angle")) else sizes[:, int("force" in name)]
        assert np.max(np.abs(table[:, i] - exact[:, i]) / unit) < 1e-4, name


@pytest.mark.parametrize(
    ("azimuth", "sign"), [(np.pi, -1), pytest.param(0.0, 1, marks=pytest.mark.slow)]
)
def test_in_the_plane_of_curvature_it_is_the_force_map(azimuth, sign):
    place = np.array([[15e-3, 0.4], [30e-3, 0.3], [42e-3, 0.1]])
    whole = np.column_stack([place, [azimuth] * 3])
    found, _ = SpaceMap(SPACE).signals(CURVED, whole)
    plane, _ = ForceMap(SIGNALS).signals(replace(W, curvature=sign * 8.0), place)
    assert found[:, :3] == pytest.approx(plane, rel=1e-4)
    assert found[:, 3:] == pytest.approx(np.tile([azimuth, azimuth, 0.0], (3, 1)), abs=1e-9)


def test_components_and_sizes_are_the_same_vectors_and_roll_turns_them():
    place = CONTACT * [1, 0.5, 1]
    for whisker in (W, CURVED):
        for roll in (0.0, 0.7):
            turned = place + np.array([0, 0, roll])
            found = SpaceMap(IN_SPACE, roll=roll).signals(whisker, turned)[0]
            s = dict(zip(IN_SPACE, found.T, strict=True))
            about, across = s["moment_direction"], s["force_direction"]
            assert s["moment_z"] == pytest.approx(s["moment"] * np.cos(about), rel=1e-9)
            assert s["moment_y"] == pytest.approx(-s["moment"] * np.sin(about), rel=1e-9)
            assert s["force_y"] == pytest.approx(s["transverse_force"] * np.cos(across), rel=1e-9)
            assert s["force_z"] == pytest.approx(s["transverse_force"] * np.sin(across), rel=1e-9)
            assert s["torsion"] == pytest.approx(
                s["moment"] * np.tan(s["torsion_angle"]), abs=1e-20
            )
            plain = SpaceMap(SPACE).signals(whisker, place)[0] + [0, 0, 0, roll, roll, 0]
            assert found[:, [0, 1, 2, 8, 9, 10]] == pytest.approx(plain, rel=1e-9)


def test_a_curved_whiskers_force_turns_round_without_a_leap():
    contact = np.tile([20.6e-3, 0.0, 1.44], (1000, 1))
    contact[:, 1] = np.linspace(0.6, 0.82, len(contact))
    found = SpaceMap().signals(CURVED, contact)[0]
    size, direction = found[:, 2], found[:, 4]
    assert np.ptp(direction) > 2.0
    assert size.min() > 0
    assert np.abs(np.diff(direction)).max() < 0.05
    assert np.abs(np.diff(size)).max() < 0.01 * size.max()


def brute(observer, reading, model, count, found):
    """Mean and sd of each unknown by midpoints in distance, deflection and azimuth themselves."""
    parts = [found.estimates[name] for name in observer.unknowns]
    share = (np.arange(count) + 0.5) / count * 2 - 1
    axes = [e.mean + 5.5 * e.sd * share for e in parts]
    place = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
    signals, outcome = observer.cue.signals(observer.whisker, place, model=model)
    held = outcome == Outcome.HELD
    log = observer.noise.log_likelihood(reading, np.where(held[:, None], signals, 1.0))
    weight = np.where(held, np.exp(log - log[held].max()), 0.0)
    mean = weight @ place / weight.sum()
    return mean, np.sqrt(weight @ (place - mean) ** 2 / weight.sum()), parts


@pytest.mark.parametrize(
    ("cue", "model", "count"),
    [
        pytest.param(SpaceMap(SPACE), None, 41, marks=pytest.mark.slow),
        (Friction(SpaceMap(SPACE), -0.3), None, 41),
        *(
            pytest.param(cue, "rod", 17, marks=pytest.mark.slow)
            for cue in (SpaceMap(), Friction(SpaceMap(), 0.3))
        ),
    ],
)
def test_posteriors_are_those_of_a_plain_sum(cue, model, count):
    observer = ww.Observer(CURVED, cue)
    reading = observer.read(np.array([30e-3, 0.25, 2.0]), seed=4)
    found = ww.posterior(observer, reading)
    assert found.status == ww.Status.CONVERGED
    mean, sd, parts = brute(observer, reading, model, count, found)
    for i, estimate in enumerate(parts):
        assert estimate.mean == pytest.approx(mean[i], abs=3e-3 * sd[i])
        assert estimate.sd == pytest.approx(sd[i], rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spread", "k"),
    [(0, 0.03), (0, 0.1), (0, 0.3), (0.3, 0.03), (0.3, 0.1), (0.3, 0.3), (10.0, 0.1)],
)
def test_intervals_hold_the_contact_as_often_as_they_say(spread, k):
    sizes = default_noise(CURVED, SpaceMap(SIGNALS), k)
    noise = Joint([sizes, GeneralisedWeber(0, floor=k)], sizes=[3, 2])
    cue = UnknownRoll(SpaceMap(), spread) if spread else SpaceMap()
    observer = ww.Observer(CURVED, cue, noise)
    place = prior_draws(observer, 300, seed=6)
    found = ww.posterior(observer, noise.sample(observer.signals(place)[0], 7))
    # Of an axial force near nothing, all but exactly known, and about the fold at k = 0.3.
    assert np.mean(found.status == ww.Status.IMPRECISE) <= (0.1 if k == 0.3 else 0.01)
    for i, name in enumerate(observer.unknowns):
        low, high = found.interval(0.95, of=name).T
        value = place[:, i]
        if name == "azimuth":  # in whichever turn
            value = value + 2 * np.pi * np.round(((low + high) / 2 - value) / (2 * np.pi))
        inside = np.mean((low <= value) & (value <= high))
        assert abs(inside - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 300), name


@pytest.mark.slow  # layers of two unknowns in space take a minute
def test_a_curved_whisker_that_rubs_is_the_rod_with_friction_and_rolls_with_it():
    cue = Friction(SpaceMap(IN_SPACE), -0.3)
    place = CONTACT * [1, 0.5, 1]
    keeps_the_protocol(ww.Observer(CURVED, Friction(SpaceMap(SPACE), -0.3)), place)
    found = cue.signals(CURVED, place)[0]
    assert found == pytest.approx(cue.signals(CURVED, place, model="rod")[0], rel=2e-4, abs=1e-9)
    assert np.abs(found / SpaceMap(IN_SPACE).signals(CURVED, place)[0] - 1).max() > 0.1
    known, rolled = (
        ww.Observer(CURVED, Friction(cue, -0.3))
        for cue in (SpaceMap(), UnknownRoll(SpaceMap(), 1e-6))
    )
    assert known.model == "rod"
    assert known.note == ""
    reading = known.read([30e-3, 0.25, 2.0], seed=4)
    one, other = ww.posterior(known, reading), ww.posterior(rolled, reading)
    for name, estimate in one.estimates.items():
        assert other.estimates[name].mean == pytest.approx(estimate.mean, abs=2e-3 * estimate.sd)
        assert other.estimates[name].sd == pytest.approx(estimate.sd, rel=2e-3)


def test_what_space_does_not_know_is_refused():
    hinged = replace(CURVED, hinge_stiffness=1e-4)
    for cue in (Friction(SpaceMap(), 0.2), UnknownHinge(SpaceMap(), 0.3)):
        with pytest.raises(ValueError, match="curved whisker takes whiskers with a clamped base"):
            ww.Observer(hinged, cue)
    with pytest.raises(ValueError, match="This cue is for straight whiskers"):
        ww.Observer(CURVED, Fused(SpaceMap(), ForceMap()))
    with pytest.raises(ValueError, match='write model="rod"'):
        ww.Observer(CURVED, SpaceMap(), model="profile").signals(CONTACT)
    with pytest.raises(ValueError, match="curved whisker takes whiskers with a clamped base, got"):
        ww.Observer(replace(CURVED, hinge_stiffness=1e-4), SpaceMap())
    with pytest.raises(ValueError, match="signal 'weight' is unknown"):
        SpaceMap(["moment", "weight"])
    with pytest.raises(ValueError, match="UnknownRoll has a prior of it"):
        SpaceMap(roll=None)
    for cue in (ForceMap(), UnknownRoll(SpaceMap(), 0.3), UnknownStiffness(SpaceMap())):
        with pytest.raises(ValueError, match="Only a SpaceMap informs of the roll"):
            UnknownRoll(cue, 0.3)
    with pytest.raises(ValueError, match="give the sd in rad"):
        UnknownRoll(SpaceMap(), 0.0)
    with pytest.raises(ValueError, match="sums over five take too long"):
        UnknownStiffness(UnknownRoll(SpaceMap(), 0.3))


def test_a_rolled_whisker_is_one_that_is_not_turned_about_its_base():
    cue, known = UnknownRoll(SpaceMap(IN_SPACE), 0.3), SpaceMap(IN_SPACE)
    roll = np.array([0.7, -0.4, 2.0])
    place = CONTACT * [1, 0.5, 1]
    found = cue.signals(CURVED, np.column_stack([place, roll]))[0]
    plain = known.signals(CURVED, place - [0, 0, 1] * roll[:, None])[0]
    signals = dict(zip(IN_SPACE, plain.T, strict=True))
    rolled = dict(zip(IN_SPACE, found.T, strict=True))
    for y, z in (("force_y", "force_z"), ("moment_y", "moment_z")):
        turned = (signals[y] + 1j * signals[z]) * np.exp(1j * roll)
        assert rolled[y] + 1j * rolled[z] == pytest.approx(turned, rel=1e-9)
    for name in ("moment", "axial_force", "transverse_force", "torsion", "torsion_angle"):
        assert rolled[name] == pytest.approx(signals[name], rel=1e-9)
    for i, angle in enumerate(roll):
        same = SpaceMap(IN_SPACE, roll=angle).signals(CURVED, place[i])[0]
        assert found[i] == pytest.approx(same, rel=1e-9)


def plain_sum(observer, reading, found, counts):
    """Means and sds by midpoints in distance, deflection, azimuth and azimuth from the plane."""
    cue = observer.cue.cue
    draws = found.solution.draws(2000, 1).reshape(-1, 4)
    columns = [draws[:, 0], draws[:, 1], draws[:, 2] - draws[:, 3], draws[:, 2]]
    low, high = ([c.mean() + s * 6.2 * c.std() for c in columns] for s in (-1, 1))
    if columns[2].std() > 0.5:
        low[2], high[2] = cue.roll - np.pi, cue.roll + np.pi
    axes = [
        a + (np.arange(n) + 0.5) / n * (b - a) for a, b, n in zip(low, high, counts, strict=True)
    ]
    place = np.stack(np.meshgrid(*axes[:3], indexing="ij"), axis=-1).reshape(-1, 3)
    place = place[place[:, 1] > 0]
    felt = cue.from_plane(observer.whisker, place)
    logs, whole = [], []
    for azimuth in axes[3]:
        turned = np.full(len(place), azimuth)
        signals, outcome = felt(turned)
        held = outcome == Outcome.HELD
        log = observer.noise.log_likelihood(reading, np.where(held[:, None], signals, 1.0))
        roll = (turned - place[:, 2] - cue.roll + np.pi) % (2 * np.pi) - np.pi
        log_prior = observer.prior["roll"].logpdf(roll + cue.roll)
        if not is_all_around(observer.prior["azimuth"]):
            log_prior = log_prior + observer.prior["azimuth"].logpdf(turned)
        logs.append(np.where(held, log, -np.inf) + log_prior)
        whole.append(np.column_stack([place[:, :2], turned, roll + cue.roll]))
    weight = np.exp(np.concatenate(logs) - np.max(logs))
    whole = np.concatenate(whole)
    mean = weight @ whole / weight.sum()
    return mean, np.sqrt(weight @ (whole - mean) ** 2 / weight.sum())


@pytest.mark.parametrize(
    ("signals", "roll", "spread", "k", "counts"),
    [
        pytest.param(SPACE[:5], 0.0, 0.3, 0.1, (25, 25, 27, 21), marks=pytest.mark.slow),
        pytest.param(SPACE, 0.5, 0.3, 0.03, (33, 33, 41, 33), marks=pytest.mark.slow),
        pytest.param(SPACE[:5], -1.0, 2.0, 0.1, (41, 41, 96, 29), marks=pytest.mark.slow),
        pytest.param(SPACE[:5], 0.0, 0.3, 0.3, (45, 45, 41, 29), marks=pytest.mark.slow),
        pytest.param(
            ("moment", "axial_force", "force_y", "force_z", "torsion"), 0.0, 0.3, 0.1,
            (41, 41, 61, 33), marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_posteriors_of_an_unknown_roll_are_those_of_a_plain_sum(signals, roll, spread, k, counts):
    cue = UnknownRoll(SpaceMap(signals, roll=roll), spread)
    if "torsion" in signals:  # components change sign
        noise = GeneralisedWeber(k, floor=[0.0, 1e-6, 2e-6, 2e-6, 4e-8])
    else:
        angles = GeneralisedWeber(0, floor=k)
        sizes = default_noise(CURVED, SpaceMap(SIGNALS), k)
        noise = Joint([sizes, angles], sizes=[3, len(signals) - 3])
    observer = ww.Observer(CURVED, cue, noise)
    reading = observer.read([30e-3, 0.25, 2.0, roll + 0.2], seed=4)
    found = ww.posterior(observer, reading)
    assert found.status == ww.Status.CONVERGED
    mean, sd = plain_sum(observer, reading, found, counts)
    for i, estimate in enumerate(found.estimates.values()):
        off = max(2e-3, 3 * float(estimate.mean_error / estimate.sd))
        assert estimate.mean == pytest.approx(mean[i], abs=off * sd[i])
        assert estimate.sd == pytest.approx(sd[i], rel=off)


@pytest.mark.parametrize("rolls", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_posterior_goes_on_beyond_half_a_turn(rolls):
    """Turned by −1 rad a contact has the same posterior: it ended at the prior's end, at π."""

    def observer(roll):
        cue = SpaceMap(roll=roll)
        return ww.Observer(CURVED, UnknownRoll(cue, 0.3) if rolls else cue)

    ahead, behind = observer(0.0), observer(-1.0)
    reading = ahead.cue.signals(CURVED, np.array([30e-3, 0.25, 3.12, 0.0][: 3 + rolls]))[0]
    reading[3:] = [3.18, -3.05]
    turned = reading - np.array([0, 0, 0, 1, 1])
    p, q = ww.posterior(ahead, reading), ww.posterior(behind, turned)
    assert p.status == q.status == ww.Status.CONVERGED
    for name, found in q.estimates.items():
        off = p.estimates[name].mean - found.mean - (name in ("azimuth", "roll"))
        off -= 2 * np.pi * np.round(off / (2 * np.pi))
        assert off == pytest.approx(0, abs=1e-3 * found.sd)
        assert p.estimates[name].sd == pytest.approx(found.sd, rel=1e-3)
    low, high = p.interval(of="azimuth")
    assert low < -np.pi < high or low < np.pi < high


@pytest.mark.parametrize(
    "shape", [pytest.param(W, marks=pytest.mark.slow), ww.mechanics.Profile.of(W)]
)
def test_torsion_of_a_straight_whisker_tells_nothing_and_is_refused_where_noise_has_no_floor(shape):
    """Of a straight profile its rounding errors were read: 29.6 ± 0.5 mm, converged."""
    sizes = ("torsion", *SIGNALS, "moment_direction", "force_direction")
    with pytest.raises(ValueError, match="A straight whisker has no torsion"):
        ww.Observer(shape, SpaceMap(sizes))
    angles = GeneralisedWeber(0, floor=0.1)
    forces = default_noise(W, ForceMap(SIGNALS))
    noise = Joint([GeneralisedWeber(0.1, floor=1e-9), forces, angles], [1, 3, 2])
    reading = np.array([2e-10, 1.98e-6, 2.26e-5, 5.65e-5, 1.18, 1.11])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = ww.posterior(ww.Observer(shape, SpaceMap(sizes), noise), reading)
    without = ww.posterior(
        ww.Observer(shape, SpaceMap(), Joint(noise.noises[1:], [3, 2])), reading[1:]
    )
    assert abs(found.mean - without.mean) < 2e-3 * without.sd
    assert np.isclose(found.sd, without.sd, rtol=2e-3)
