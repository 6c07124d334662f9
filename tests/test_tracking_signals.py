"""From a tracked video to signals and distances: a synthetic session, and its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import weberwhisk as ww

pytestmark = pytest.mark.once  # arithmetic in which ArviZ has no part

ROOT = Path(__file__).parents[1]
C2 = ww.Whisker.from_identity("C2", curved=True)


def test_a_simulated_session_is_the_beams() -> None:
    """Without noise: the curvature at the base is M/EI, and the whisker passes through the pole."""
    exact = {"frames": 50, "noise_px": 0.0, "spacing_px": 4.0, "missing": 0.0}
    tracking, truth = ww.simulate_tracking(C2, [12e-3, 20e-3], **exact)
    assert truth["contact"].sum() == 21
    free = tracking.loc[truth.index[~truth["contact"]][0]]
    for i in truth.index[truth["contact"]]:
        row, true = tracking.loc[i], truth.loc[i]
        z = (row["x"] + 1j * row["y"]) / 20e3
        angle = np.unwrap(np.angle(np.diff(z)))
        rest = np.unwrap(np.angle(np.diff(free["x"] + 1j * free["y"])))
        # Change of curvature over the first steps, extrapolated to the base.
        change = np.diff(angle - rest)[:8] / 0.2e-3
        at_base = np.polyfit(0.2e-3 * np.arange(1, 9), change, 3)[-1]
        assert 1e6 * C2.stiffness * at_base == pytest.approx(true["moment_uNm"], rel=1e-3)
        off = np.hypot(row["x"] - true["pole_x"], row["y"] - true["pole_y"]).min()
        assert off < 2.01
        assert abs(row["length_px"] - 20e3 * C2.length) < 4


def test_noise_and_missing_frames_are_as_asked() -> None:
    smooth = {"frames": 40, "missing": 0.0, "spacing_px": 1.0}
    exact, _ = ww.simulate_tracking(C2, 20e-3, noise_px=0.0, **smooth)
    own, _ = ww.simulate_tracking(C2, 20e-3, noise_px=0.3, **smooth)
    alike, _ = ww.simulate_tracking(C2, 20e-3, noise_px=0.3, noise_length_px=30.0, **smooth)
    for table, together in ((own, 0.0), (alike, np.exp(-1 / 30))):
        noise = np.array([a - b for a, b in zip(table["y"], exact["y"], strict=True)])
        assert noise.std() == pytest.approx(0.3, rel=0.1)
        share = (noise[:, 1:] * noise[:, :-1]).mean() / noise.var()
        assert share == pytest.approx(together, abs=0.02)
    tracking, truth = ww.simulate_tracking(C2, 20e-3, frames=300, spacing_px=20.0, missing=0.2)
    assert truth["tracked"].sum() == len(tracking)
    assert 0.7 < truth["tracked"].mean() < 0.9
    assert tracking.attrs == {"pixels_per_mm": 20.0, "frame_rate": 500.0}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [({"deflection": 0.6}, "pressed by less"), ({"noise_px": -1}, "noise_px"),
     ({"radial_distances": 33e-3}, "does not stay")],
)  # fmt: skip
def test_a_session_that_cannot_be(options: dict, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        ww.simulate_tracking(C2, **{"radial_distances": 20e-3, "frames": 40} | options)


def test_the_session_beside_the_choices_is_read() -> None:
    tracking = ww.read_tracking(ROOT / "data_synthetic" / "tracked_session.csv")
    truth = pd.read_csv(ROOT / "data_synthetic" / "tracked_session_truth.csv")
    assert tracking["frame"].tolist() == truth.loc[truth["tracked"], "frame"].tolist()
    assert tracking["length_px"].between(640, 690).all()
