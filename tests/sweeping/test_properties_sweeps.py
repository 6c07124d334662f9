"""Properties of sweeps over objects."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from property_strategies import POWERS, floats, scaled, whiskers

import weberwhisk as ww
from weberwhisk import Outcome
from weberwhisk.sweeping import Body, cylinder, peg, sweep, wall

# Whiskers of every size may be as little curved as a slip of units would be.
pytestmark = pytest.mark.filterwarnings("ignore:curvature is in 1/m")

#: A sweep takes a tenth of a second: few examples.
few_examples = settings(max_examples=max(settings.default.max_examples // 5, 3))


@st.composite
def swept(draw: st.DrawFn) -> tuple[ww.Whisker, str, tuple[float, ...]]:
    """A whisker, and an object by name, its numbers in lengths of the whisker and rad.

    Units go from metres down: a wall is some metres long.
    """
    w = draw(whiskers(curved=draw(st.booleans())))
    assume(w.tip_radius > 1e-2 * w.base_radius)
    name = draw(st.sampled_from(["peg", "cylinder", "wall"]))
    x, y = draw(floats(0.2, 0.95)), draw(floats(-0.3, -0.02))
    if name == "wall":
        return w, name, (x, y, draw(floats(-0.2, 0.6)))
    return w, name, (x, y, draw(floats(0.005, 0.015)))


def made(name: str, numbers: tuple[float, ...], unit: float) -> Body:
    x, y, third = numbers
    if name == "wall":
        return wall(x * unit, y * unit, third)
    if name == "peg":
        return peg(x * unit, y * unit)
    return cylinder(x * unit, y * unit, third * unit)


ROTATIONS = np.concatenate([[-0.5], np.linspace(0.0, 1.0, 5)])


@few_examples
@given(swept(), st.integers(-6, 0).map(lambda n: 2.0**n), POWERS)
def test_a_sweep_is_whole_touches_its_object_and_knows_no_unit(
    scene: tuple[ww.Whisker, str, tuple[float, ...]], size: float, stiff: float
) -> None:
    w, name, numbers = scene
    body = made(name, numbers, w.length)
    assume(body.depth(0.0, 0.0) < 0)
    s = sweep(w, body, ROTATIONS)
    b, held = s.bending, np.asarray(s.bending.held)
    for value in (b.moment, b.force, b.axial_force, s.contact[:, 0]):
        assert (np.isfinite(value) == held).all()
    # Held in one stretch, from first contact to the end.
    assert (np.diff(np.flatnonzero(held)) == 1).all()
    if held.any():
        depth = np.array([body.depth(x, y) for x, y in s.contact[held]])
        assert np.abs(depth).max() < 1e-5 * w.length
        assert s.rotation[held].min() >= s.first_contact - 1e-9
        assert (b.force[held] >= 0).all()
    if np.isfinite(s.end):
        assert s.ended_by not in (Outcome.HELD, Outcome.OUT_OF_REACH)
        assert not held[s.rotation > s.end].any()
    other = sweep(scaled(w, size, stiff), made(name, numbers, w.length * size), ROTATIONS)
    np.testing.assert_array_equal(other.bending.outcome, b.outcome)
    np.testing.assert_allclose(
        other.bending.moment[held], b.moment[held] * stiff * size**3,
        rtol=1e-5, atol=1e-8 * stiff * size**3 * w.moment_scale,
    )  # fmt: skip
