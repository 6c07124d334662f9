"""The short forms of `analyses/contacts/make.py`: 95 % intervals hold what they should."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from analysis_scripts import load as load_script
from short_forms import slow_but

import weberwhisk as ww

contacts = load_script("contacts.make")
EACH = [(signals, shape, touch) for signals in (2, 3) for shape in (True, False)
        for touch in (True, False)]  # fmt: skip


@pytest.mark.parametrize(("signals", "shape", "touch"), slow_but(EACH, {0, 4}))
def test_tables_whose_noise_nobody_gave(signals: int, shape: bool, touch: bool) -> None:
    """The bar: 90 % of the distances held, and at most 10 % outside by over 2 mm."""
    table, found = contacts.located(1, signals, shape, touch)
    for of in ("", "touch_") if touch else ("",):
        score = contacts.held(found, of)
        assert score[f"{of}held"] >= 0.9
        assert score[f"{of}far_outside"] <= 0.1
        # Wide is easy: intervals say more than the prior does.
        assert score[f"{of}width_mm"] < 0.8 * 0.95e3 * contacts.WHISKER.length
    said = " ".join(found.attrs["notes"])
    assert "was not given and " in said
    assert ("redundant signals" in said) == (signals == 3)
    assert ("rows of one touch" in said) == touch
    assert ("misfit_sd" in found) == (signals == 3)
    sure = ww.locate(table, contacts.CURVED, noise=0.03, known_stiffness=True)
    assert contacts.held(sure)["held"] < 0.7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "left_out", "least"),
    slow_but([(contacts.SENSORS[2], (1, 5, 9), 3),
              *((sensor, range(11), 9) for sensor in contacts.SENSORS)], {0}),
)  # fmt: skip
def test_taps_left_out_of_a_sensor_that_the_model_does_not_describe(
    sensor: tuple, left_out: Sequence[int], least: int
) -> None:
    """The bar: at least 9 of 11 distances are held; at once, three of the inner ones."""
    found = contacts.taps(1, [sensor], left_out)
    assert len(found) == 1
    assert (found["touches_held"] >= least).all()
    assert (found["rows_held"] >= 0.88).all()
    if sensor[1:3] == (1.0, 2):  # a misfit as large as a real sensor's
        assert (found["p_value"] < 1e-20).all()


def test_touches_located_by_a_calibration_with_gross_taps() -> None:
    """The bar: those 9 sds off are named and no others, and 9 of 11 touches are held."""
    (found,) = contacts.calibrations(1, ["gross"]).to_dict("records")
    assert found["gross"] > 0
    assert found["gross_named"] == found["gross"]
    assert found["falsely_named"] == 0
    assert found["touches_held"] >= 9
