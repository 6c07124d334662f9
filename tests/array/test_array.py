"""Arrays of whiskers: where they stand, and where an object is that some of them touch."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import kstest, powerlaw, uniform
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk import Status, cues, receptors
from weberwhisk.array.follicles import TURNS, WhiskerArray, published
from weberwhisk.mechanics.shape import Spiral

# C2 by hand, from the equations as printed, with r = 3 and c = 3.
C2 = {
    "rat": (-8.4, 2.51, 6.7432, 27.845, 0.012784, 61.5887, 9.2904, 32.6626),
    "mouse": (-6.1, 5.9, 4.43537, 13.058, 0.014743, 79.4758, 16.1, 45.118),
}


def measured(species: str) -> list[tuple[str, float, float]]:
    """Identity, arc length (mm) and the coefficient of the parabola through the measured shape."""
    path = resources.files("weberwhisk").joinpath("data/whisker_curvature.csv")
    out = []
    for row in csv.DictReader(path.read_text("utf-8").splitlines()):
        if row["species"].lower() == species:
            name = f"{'ABCDE'[int(row['row']) - 1]}{int(row['column']) - 1}"
            length = float(row["arc_length_mm"])
            bow = Spiral(float(row["B_per_mm"]), float(row["A_per_mm2"]))
            x, z = bow.point(np.linspace(0.0, length, 200))
            out.append((name, length, float(np.sum(z * x**2) / np.sum(x**4))))
    return out


@pytest.mark.parametrize("species", ["rat", "mouse"])
def test_c2_is_row_3_column_3_of_every_equation(species: str) -> None:
    np.testing.assert_allclose(published("C2", species), C2[species], rtol=2e-4)


@pytest.mark.parametrize(("species", "median"), [("rat", -0.01), ("mouse", -0.07)])
def test_columns_count_from_one_at_the_greek_arc(species: str, median: float) -> None:
    """Arc lengths agree in the median so, and are a fifth or more off with any other count."""
    table = [row for row in measured(species) if row[0][1] != "0" and row[0] != "E1"]
    off = [np.log(n / published(name, species).arc_length) for name, n, _ in table]
    one_less = [f"{name[0]}{int(name[1]) - 1}" for name, _, _ in table]
    other = [np.log(row[1] / published(name, species).arc_length)
             for row, name in zip(table, one_less, strict=True)]  # fmt: skip
    assert abs(np.median(off) - median) < 0.06
    assert np.std(off) < 0.22
    assert np.median(other) < -0.2


def test_a_pole_is_met_where_the_base_tangent_crosses_it() -> None:
    rng = np.random.default_rng(1)
    r, angle = rng.uniform(1e-3, 40e-3, 50), rng.uniform(-1.5, 1.5, 50)
    for whisker in WhiskerArray("mouse").protract(0.4).whiskers.values():
        found = whisker.in_plane(whisker.place(r, angle))
        np.testing.assert_allclose(found, (r, angle), rtol=1e-9, atol=1e-12)
        # By vectors: the point in the plane of tangent and horizontal at that angle is over it.
        flat = np.array([*whisker.direction[:2], 0.0]) / np.cos(whisker.elevation)
        behind = whisker.mirror * np.array([-flat[1], flat[0], 0.0]) * -1.0
        tip = np.cos(angle)[:, None] * whisker.direction + np.sin(angle)[:, None] * behind
        np.testing.assert_allclose(
            (whisker.base + r[:, None] * tip)[:, :2], whisker.place(r, angle), atol=1e-12
        )


def test_protraction_turns_rostrally_and_rolls_by_row() -> None:
    rest, forward = WhiskerArray("rat", "right"), WhiskerArray("rat", "right").protract(0.5)
    for name, before in rest.whiskers.items():
        after = forward.whiskers[name]
        assert after.direction[1] > before.direction[1]
        assert after.swept == 0.5
        assert np.isclose(after.roll - before.roll, 0.5 * TURNS[name[0]][1])
    assert rest.protract(0.2).protract(0.3) == forward
    assert rest.only(["C2"]).whiskers.keys() == {"C2"}


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: ww.WhiskerArray("cat"), "species 'cat' is unknown"),
        (lambda: ww.WhiskerArray(sides="top"), "sides 'top' is unknown"),
        (lambda: ww.WhiskerArray(identities=["C9"]), "'C9' is unknown"),
        (lambda: ww.WhiskerArray(protraction=np.nan), "protraction must be finite"),
        (lambda: published("C2", "cat"), "species 'cat' is unknown"),
    ],
)
def test_what_there_is_not_is_refused(make, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()


# -- the place of an object --------------------------------------------------------------------


def observer(*names: str, angle_sd: float = np.radians(1.0), **how: Any) -> ww.ArrayObserver:
    """Straight whiskers of the right side, protracted by 40°."""
    array = WhiskerArray("rat", "right", identities=names or None).protract(np.radians(40))
    return ww.ArrayObserver(array, angle_sd=angle_sd, **how)


def brute_force(
    o: ww.ArrayObserver, readings: Mapping[str, Any], box: Any, count: int, angles: int
) -> tuple[Any, Any, float]:
    """Mean, sd and ln evidence by midpoints of places, and of each whisker's own deflection."""
    sides = [np.linspace(*ends, 2 * count + 1)[1::2] for ends in box]
    place = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    log, s = np.zeros(len(place)), o.angle_sd
    for name, y in readings.items():
        follicle, own = o.array.whiskers[name], o.sensors[name].observer
        r, theta = follicle.in_plane(place)
        top = np.zeros(len(r))
        near = r < own.reach[1]
        top[near] = np.minimum(own.space.angle_range(r[near])[1], follicle.swept_in_plane)
        if y is None:
            touch = (theta > 0) & (theta < top)
            if s:
                touch = (ndtr((top - theta) / s) - ndtr(-theta / s)) * (top > 0)
            with np.errstate(divide="ignore"):
                log += np.log1p(-1.0 * touch)
            continue
        value = np.full(len(r), -np.inf)
        if s == 0:
            some = np.flatnonzero((theta > 0) & (theta < top))
            value[some] = own.log_likelihood(y, np.stack([r, theta], axis=-1)[some])
        else:
            for some in np.array_split(np.flatnonzero(top > 0), 20):
                phi = (np.arange(angles) + 0.5) / angles * top[some, None]
                contact = np.stack(np.broadcast_arrays(r[some, None], phi), axis=-1)
                each = own.log_likelihood(y, contact) + np.log(top[some, None] / angles)
                each = each - 0.5 * ((phi - theta[some, None]) / s) ** 2
                value[some] = np.logaddexp.reduce(each, axis=1) - np.log(s * np.sqrt(2 * np.pi))
        log += value
    weight = np.exp(log - log.max())
    evidence = log.max() + np.log(weight.mean() * np.prod(np.diff(box, axis=1)))
    weight /= weight.sum()
    mean = weight @ place
    return mean, np.sqrt(weight @ (place - mean) ** 2), float(evidence)


def around(found: ww.array.Place, sds: float = 7.0) -> Any:
    ends = found.mean[:, None] + sds * found.sd[:, None] * np.array([-1.0, 1.0])
    return np.clip(ends, found.observer.box[:, :1], found.observer.box[:, 1:])


@pytest.mark.parametrize(
    ("place", "angle_sd", "k"),
    slow_but(
        [
            ([16e-3, -2e-3], 0.0, 0.1),
            ([16e-3, -2e-3], 1.0, 0.1),
            ([28e-3, 0.0], 0.0, 0.3),
            ([16e-3, -2e-3], 3.0, 0.3),
        ],
        (2,),
    ),
)
def test_place_is_that_of_brute_force(place: Any, angle_sd: float, k: float) -> None:
    """Some whiskers touch and some do not, azimuths known or not; and the error is as stated."""
    o = observer("C1", "C2", "C3", "D2", angle_sd=np.radians(angle_sd), noise=receptors.Weber(k))
    readings = o.read(place, seed=4)
    found = ww.place(o, readings)
    assert 0 < len(found.touching) < 4
    assert found.status is Status.CONVERGED
    mean, sd, evidence = brute_force(o, readings, around(found), 50 if angle_sd else 200, 160)
    off = np.abs([(found.mean - mean) / sd, found.sd / sd - 1])
    assert np.max(off) < max(3 * found.error, 2e-3)
    assert abs(found._log_evidence - evidence) < 3e-3


def test_the_error_holds_where_a_sweep_ends_in_the_posterior() -> None:
    """Found by a search: 0.8 % of the mass was missed with a claim of 0.1 %."""
    names = ["E5", "C5", "E6", "E1", "B4"]
    array = WhiskerArray("rat", "right", identities=names).protract(1.1536218934957845)
    readings: dict[str, Any] = dict.fromkeys(names)
    readings["E1"] = [2.3432511116914602e-05, 0.002770240884591334]
    o = ww.ArrayObserver(array)
    rough, fine = (ww.place(o, readings, tolerance=t) for t in (2e-3, 1e-4))
    assert abs(rough._log_evidence - fine._log_evidence) < 3 * rough.error < 6e-3


def test_the_height_of_a_short_pole_is_told_by_who_touches() -> None:
    """Beside a midpoint sum over x, y and z, planes of whisking by vectors."""
    o = observer("B2", "C2", "D2", "C3", "D3", "E2", pole_length=6e-3, missed=0.01)
    readings = o.read([16e-3, -2e-3, 3e-3], seed=3)
    found = ww.place(o, readings)
    assert 0 < len(found.touching) < 6
    assert found.status is Status.CONVERGED
    (low, high), plain = o.heights, replace(o, pole_length=None)
    ends = (
        np.linspace(m - 6 * s, m + 6 * s, 161) for m, s in zip(found.mean, found.sd, strict=True)
    )
    x, y = ((a[1:] + a[:-1]) / 2 for a in ends)
    at = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    z = low + (high - low) * (np.arange(300) + 0.5) / 300
    log, total = np.zeros((len(at), 1)), np.zeros((len(at), len(z)))
    for name, reading in readings.items():
        sensor = plain.sensors[name]
        tangent, base = sensor.follicle.direction, sensor.follicle.base
        across = np.array([-tangent[1], tangent[0], 0.0])
        normal = np.cross(tangent, across)
        plane = base[2] - (at - base[:2]) @ normal[:2] / normal[2]
        level = np.abs(plane[:, None] - z) < 3e-3
        if reading is None:
            total += np.where(level, np.log1p(-0.99 * sensor.touch_probability(at))[:, None], 0.0)
        else:
            log += plain.log_likelihood({name: reading})(at)[:, None]
            total = np.where(level, total, -np.inf)
    mass = np.exp(log + total - (log + total).max())
    mass /= mass.sum()
    for i, mean in enumerate(mass.sum(axis=1) @ at):
        assert found.mean[i] == pytest.approx(mean, abs=0.02 * found.sd[i])
    over = mass.sum(axis=0)
    mean = over @ z
    sd = np.sqrt(over @ (z - mean) ** 2)
    assert found.height[0] == pytest.approx(mean, abs=0.02 * sd)
    assert found.height[1] == pytest.approx(sd, rel=0.02)
    ends = np.interp([0.025, 0.975], np.cumsum(over) - over / 2, z)
    np.testing.assert_allclose(found.height[2], ends, atol=0.05 * sd)
    assert found.height[2][0] < 3e-3 < found.height[2][1]
    assert list(found.summary()["coordinate"]) == ["x", "y", "z"]
    assert np.isnan(ww.place(plain, readings).height[0])
    with pytest.raises(ValueError, match=r"A place is x, y and z in metres, got shape \(2,\)"):
        o.read([16e-3, 0.0])
    with pytest.raises(ValueError, match="Fisher information is of poles as high as all"):
        o.information([16e-3, 0.0])


def test_one_whisker_alone_says_what_its_posterior_says() -> None:
    """Places are flat where the distance has a density that grows with it."""
    o = observer("C2", angle_sd=0.0)
    sensor = o.sensors["C2"]
    swept, reach = sensor.follicle.swept_in_plane, sensor.observer.reach[1]
    reading = o.read([16e-3, -2e-3], seed=3)["C2"]
    flat = {"radial_distance": powerlaw(2, scale=reach), "deflection_angle": uniform(0.0, swept)}
    own = ww.posterior(replace(sensor.observer, prior=flat), reading)
    found = ww.place(o, {"C2": reading}, tolerance=3e-4)
    r, theta = sensor.contact(found.places)
    for name, values in (("radial_distance", r), ("deflection_angle", theta)):
        mean = found.weights @ values
        sd = np.sqrt(found.weights @ (values - mean) ** 2)
        estimate = own.estimates[name]
        assert abs(mean - estimate.mean) < 1e-3 * sd
        assert abs(sd / estimate.sd - 1) < 1e-3
    # And an azimuth that is all but known makes next to no difference.
    near = ww.place(observer("C2", angle_sd=2e-4), {"C2": reading})
    np.testing.assert_allclose(near.mean, found.mean, atol=0.01 * found.sd.min())


def test_a_turned_whisker_finds_the_turned_place() -> None:
    sensor = observer("E2").sensors["E2"]
    turned = replace(sensor, follicle=replace(sensor.follicle, azimuth=sensor.follicle.azimuth + 1))
    rng = np.random.default_rng(1)
    place = sensor.follicle.place(rng.uniform(5e-3, 30e-3, 50), rng.uniform(-0.1, 0.6, 50))
    reading = sensor.read(place[0], np.random.default_rng(2))
    base, c, s = sensor.follicle.base[:2], np.cos(1.0), np.sin(1.0)
    moved = (place - base) @ np.array([[c, s], [-s, c]]) + base  # rostrally, on the right
    np.testing.assert_allclose(
        turned.evidence(reading)(moved), sensor.evidence(reading)(place), rtol=1e-6, atol=1e-6
    )


def test_no_touch_leaves_the_region_that_is_not_excluded() -> None:
    o = observer("C1", "C2", angle_sd=0.0)
    found = ww.place(o, {"C1": None, "C2": None})
    rng = np.random.default_rng(0)
    drawn = o.box[:, 0] + np.diff(o.box, axis=1)[:, 0] * rng.random((20_000, 2))
    left = np.mean([s.touch_probability(drawn) == 0 for s in o.sensors.values()], axis=0) == 1
    assert found.status is Status.NO_CONTACT
    assert "% of the region is left" in found.note
    assert abs(found.area(1.0) / np.prod(np.diff(o.box, axis=1)) - left.mean()) < 0.01
    np.testing.assert_allclose(found.mean, drawn[left].mean(axis=0), atol=0.4e-3)
    assert np.isclose(found.bits, -np.log2(left.mean()), atol=0.02)


def test_readings_that_contradict_each_other_are_said_to_in_words_of_places() -> None:
    """One pole on both sides of the head; sums of ln densities of −1e5 overflowed."""
    both = ww.ArrayObserver(WhiskerArray("rat", identities=["C2"]).protract(np.radians(40)))
    touches = {
        f"{side} C2": both.read([sign * 16e-3, -2e-3], seed=1)[f"{side} C2"]
        for side, sign in (("left", -1), ("right", 1))
    }
    found = ww.place(both, touches)
    assert found.status is Status.IMPROBABLE_READING
    assert "no one place explains all readings within 5 sd" in repr(found)
    nowhere = repr(ww.place(both, dict.fromkeys(touches)))
    assert "whiskers; no contact; no whisker touches: 94 % of the region" in nowhere


@pytest.mark.slow
def test_information_predicts_the_spread_of_posteriors() -> None:
    o = observer("C2", "C3", "D3", noise=receptors.Weber(0.02), angle_sd=np.radians(0.2))
    place = np.array([16e-3, -1e-3])
    told = np.linalg.inv(o.information(place)[0].sum(axis=0))
    sds = [ww.place(o, o.read(place, seed)).sd for seed in range(4)]
    np.testing.assert_allclose(np.mean(sds, axis=0), np.sqrt(np.diag(told)), rtol=0.1)


def coverage(count: int) -> Any:
    """Credibilities of the true places of readings, of which one whisker or more touches."""
    o = observer("C2", "D2", "C3", region=((8e-3, 30e-3), (-8e-3, 6e-3)))
    rng, out = np.random.default_rng(7), []
    while len(out) < count:
        place = o.box[:, 0] + np.diff(o.box, axis=1)[:, 0] * rng.random(2)
        readings = o.read(place, rng)
        if any(y is not None for y in readings.values()):
            out.append(ww.place(o, readings).credibility(place))
    return np.array(out)


@pytest.mark.slow
def test_regions_cover_what_they_say() -> None:
    found = coverage(12)
    assert kstest(found, "uniform").pvalue > 0.01


@pytest.mark.slow
def test_regions_of_95_per_cent_cover_95_per_cent() -> None:
    found = coverage(600)
    assert kstest(found, "uniform").pvalue > 0.01
    assert abs(np.mean(found < 0.95) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 600)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: ww.ArrayObserver("rat"), "array must be a WhiskerArray"),
        (lambda: observer("C2", angle_sd=-1.0), "angle_sd must not be negative"),
        (lambda: observer("C2", missed=1.0), "missed must be below 1"),
        (lambda: observer("C2", region=((1.0, 0.0), (0.0, 1.0))), "region must be two ends"),
        (lambda: observer("C2", cue={"C3": cues.ForceMap()}).sensors, "C2 has no cue"),
        (lambda: observer("C2", cue=cues.Compliance(), angle_sd=0.0).sensors, "C2 taps"),
        (lambda: observer("C2", cue=cues.Friction(cues.ForceMap())).sensors, "distance and defl"),
        (lambda: ww.place(observer("C2"), [1.0]), "Readings are a mapping"),
        (lambda: ww.place(observer("C2"), {"C3": None}), "whisker 'C3' is unknown"),
        (lambda: ww.place(observer("C2"), {"C2": [1e-7]}), "has 2 numbers"),
        (lambda: ww.place(observer("C2"), {"C2": [1e-7, np.nan]}), "must be finite"),
        (lambda: ww.place(observer("C2", cue=cues.Compliance()), {"C2": [1.0]}), "is a tap"),
        (lambda: observer("C2").read([1e-3]), "A place is x and y"),
        (
            lambda: observer("C2").read([16, -2]),
            "place is in metres from the middle of a head, got",
        ),
        (lambda: observer("C2", region=((0, 40), (-20, 20))), "region is in metres"),
        (lambda: ww.place(observer("C2"), {}), "Readings are a mapping"),
        (lambda: ww.place(observer("C2"), {"C2": [[1e-7, 1e-6]] * 2}), "one reading of one place"),
    ],
)
def test_places_refuse_what_is_no_reading(make, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make()
