"""The claims of analyses/adaptive.py, in its short form."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

adaptive = load("adaptive")


@pytest.mark.slow  # placement by itself: tests/design/test_placement.py
def test_the_short_form_writes_what_it_says_and_resumes(tmp_path: Path) -> None:
    first = adaptive.make(tmp_path, short=True)
    again = adaptive.make(tmp_path, short=True)
    for name in ("estimation", "discrimination", "trials"):
        pd.testing.assert_frame_equal(first[name], again[name])
        assert (tmp_path / f"adaptive_{name}.csv").exists()
    assert (tmp_path / "adaptive.png").stat().st_size > 10_000
    table = first["estimation"]
    assert len(table) == 5 * 2 * 2
    assert (table["low"] < table["median"]).all()
    assert np.isfinite(first["discrimination"]["log_bayes_factor"]).all()
    assert set(first["discrimination"]["truth"]) == {0, 1}


def test_trials_needed_are_read_off_the_curve() -> None:
    curve = pd.Series([0.8, 0.4, 0.2], index=[10, 20, 40])
    assert adaptive.crossing(curve, 0.3) == pytest.approx(30)
    assert adaptive.crossing(curve, 0.9) == 10
    assert np.isnan(adaptive.crossing(curve, 0.1))
