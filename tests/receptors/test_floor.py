"""The floor of the noise of signals that change sign: where it stands, and where it does not."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import Observer, Whisker, receptors
from weberwhisk.cues import (
    Compliance,
    ForceMap,
    Friction,
    Fused,
    SpaceMap,
    UnknownCurvature,
    UnknownStiffness,
)
from weberwhisk.cues.force_map import SIGNALS
from weberwhisk.inference import default_noise
from weberwhisk.mechanics import Profile
from weberwhisk.receptors import (
    GeneralisedWeber,
    Joint,
    LogNormal,
    Weber,
)

W = Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
CONCAVE = replace(W, curvature=-12.0)
SPACE = ["axial_force", "force_y", "force_z", "torsion", "moment_y", "moment_z"]


@pytest.mark.parametrize(
    ("whisker", "cue", "floored"),
    [
        (W, ForceMap(), []),
        (W, Compliance(), []),
        (W, UnknownStiffness(ForceMap()), []),
        (replace(W, hinge_stiffness=2e-5), ForceMap(), []),
        (W.cylinder(), ForceMap(), []),
        (Profile.of(W), ForceMap(), []),
        (W, ForceMap(SIGNALS), ["transverse_force"]),
        (W, ForceMap(SIGNALS, deflection_angle=0.1), []),
        (replace(W, curvature=12.0), ForceMap(), []),
        (CONCAVE, ForceMap(), ["axial_force"]),
        (CONCAVE, ForceMap("moment"), []),
        (CONCAVE, Compliance(), []),
        (CONCAVE, Fused(Compliance(), ForceMap()), ["axial_force"]),
        (W, Friction(ForceMap(), 0.2), []),
        (W, Friction(ForceMap(), -0.2), ["axial_force"]),
        (W, Friction(ForceMap()), ["axial_force"]),
        (W, UnknownCurvature(ForceMap(), 1.0), ["axial_force"]),
        (W, SpaceMap(), ["transverse_force"]),
        (replace(W, curvature=8.0), SpaceMap(SPACE), SPACE),
    ],
    ids=repr,
)
def test_signals_that_change_sign_have_a_floor_and_no_others(whisker, cue, floored):
    own = cue.default_noise()
    noise = Observer(whisker, cue).noise
    assert noise == default_noise(whisker, cue)
    size = len(cue.signal_names)
    added = np.flatnonzero(noise.floors(size) > own.floors(size))
    assert [cue.signal_names[i] for i in added] == floored
    assert (noise == own) == (not floored)
    assert np.array_equal(noise.weber_fractions(size), own.weber_fractions(size))


def test_the_floor_is_a_hundredth_of_the_median_signal():
    """And as much of a signal in another unit: of a whisker that is ten times as stiff."""
    observer = Observer(CONCAVE, ForceMap())
    floor = observer.noise.floors(2)[1]
    contact = observer.space.constrain(observer.space.spread(np.linspace(0.02, 0.98, 40)))[0]
    size = np.abs(observer.signals(contact)[0][:, 1])
    assert floor == pytest.approx(0.01 * np.nanmedian(size), rel=0.2)
    stiff = replace(CONCAVE, youngs_modulus=10 * CONCAVE.youngs_modulus)
    assert Observer(stiff, ForceMap()).noise.floors(2)[1] == pytest.approx(10 * floor, rel=0.02)


@pytest.mark.parametrize(
    ("whisker", "cue", "noise"),
    [
        (CONCAVE, ForceMap(), Weber(0.05, correlation=0.3)),
        (CONCAVE, ForceMap(), Weber([0.05, 0.2])),
        (CONCAVE, ForceMap(), LogNormal(0.05)),
        (CONCAVE, ForceMap(), GeneralisedWeber(0.1, floor=[1e-9, 0.0], ceiling=[None, 1.0])),
        (CONCAVE, ForceMap(), receptors.Saturating(0.1, ceiling=[1e-4, 1.0])),
        (CONCAVE, Fused(Compliance(), ForceMap()), Joint([Weber(0.1), LogNormal(0.2)], [1, 2])),
        (W, ForceMap(SIGNALS), Weber(0.1)),
        (W, SpaceMap(), Joint([Weber(0.1), GeneralisedWeber(0, floor=0.1)], [3, 2])),
        (W, Friction(ForceMap(), -0.2), Weber(0.1)),
    ],
    ids=repr,
)
def test_noise_without_a_floor_is_refused_with_the_line_to_write(whisker, cue, noise):
    with pytest.raises(ValueError, match="changes within this whisker's reach") as error:
        Observer(whisker, cue, noise)
    said = str(error.value)
    assert "\n" not in said
    assert repr(noise) in said
    size = len(cue.signal_names)
    typed = eval(said.split("write ")[1].removesuffix("."), {"ww": ww})
    assert Observer(whisker, cue, typed).noise == typed
    assert np.array_equal(typed.weber_fractions(size), noise.weber_fractions(size))
    default = default_noise(whisker, cue).floors(size)
    assert np.array_equal(typed.floors(size), np.maximum(noise.floors(size), default))
    assert getattr(typed, "correlation", 0) == getattr(noise, "correlation", 0)
    assert type(typed) is type(noise) or isinstance(typed, GeneralisedWeber)


@dataclass(frozen=True, eq=False, repr=False)
class Root(receptors.Gaussian):
    """A law of another formula, without a Weber fraction or a floor."""

    size: float = 0.1
    correlation: float = 0.0

    def sd(self, signals):
        return self.size * np.sqrt(np.abs(signals))


@dataclass(frozen=True, eq=False, repr=False)
class RootAndFloor(Root):
    floor: float = 0.0

    def sd(self, signals):
        return np.hypot(self.floor, super().sd(signals))


def test_a_law_of_ones_own_is_kept_by_the_line_to_write():
    """It was told to be Weber's law with a k of 0.1, which nobody had given."""
    with pytest.raises(ValueError, match=r"give its law a field `floor`.* of \[0, 7.6e-07\]"):
        Observer(CONCAVE, ForceMap(), Root(1e-4))
    with pytest.raises(ValueError, match="changes within this whisker's reach") as error:
        Observer(CONCAVE, ForceMap(), RootAndFloor(1e-4))
    line = str(error.value).split("write ")[1].removesuffix(".")
    typed = eval(line, {"RootAndFloor": RootAndFloor})
    assert Observer(CONCAVE, ForceMap(), typed).noise == typed
    assert typed.floor == [0, 7.6e-07]
    assert (typed.size, typed.correlation) == (1e-4, 0.0)


def test_an_observer_made_from_another_has_the_floor_of_its_own_whisker():
    straight = Observer(W, ForceMap())
    concave = replace(straight, whisker=CONCAVE)
    assert concave == Observer(CONCAVE, ForceMap())
    assert replace(concave, whisker=W) == straight


@pytest.mark.parametrize(
    ("whisker", "cue"),
    [(CONCAVE, ForceMap()), (W, Friction(ForceMap(), -0.2)), (W, ForceMap(SIGNALS))],
    ids=repr,
)
def test_information_is_finite_where_a_signal_is_zero(whisker, cue):
    observer = Observer(whisker, cue)
    column = np.argmax(observer.noise.floors(len(cue.signal_names)))
    found = 0
    for r in observer.reach[1] * np.linspace(0.1, 0.9, 9):
        theta = np.linspace(0.001, 0.999, 500) * observer.space.angle_range(np.array(r))[1]
        contact = np.column_stack([np.full(500, r), theta])
        signal = observer.signals(contact)[0][:, column]
        for i in np.flatnonzero(signal[1:] * signal[:-1] < 0):
            low, high = theta[i], theta[i + 1]
            for _ in range(60):
                middle = (low + high) / 2
                same = observer.signals([r, middle])[0][column] * signal[i] > 0
                low, high = (middle, high) if same else (low, middle)
            near = np.array([[r, low], [r, low * (1 + 1e-9)], [r, low * (1 + 1e-3)]])
            information = observer.information(near)
            assert np.isfinite(information).all()
            assert np.linalg.norm(information[1] - information[0]) < 1e-3 * np.linalg.norm(
                information[0]
            )
            found += 1
    assert found > 3


def test_the_posterior_of_a_reading_of_no_axial_force_is_found():
    observer = ww.Observer(CONCAVE, ForceMap())
    found = ww.posterior(observer, [1.1e-6, 0.0])
    assert np.isfinite([found.mean, found.sd]).all()
