"""The comparisons of `weberwhisk fit --compare`, by name."""

from __future__ import annotations

from typing import Any

import pandas as pd

import weberwhisk as ww

from .. import _checks
from ..behaviour import CueEncoding, compare_cues, compare_drift, compare_noise, compare_taper

NAMES = ("noise", "drift", "law", "taper", "cues")


def compared(
    name: str, fit: ww.WeberFit, whisker: ww.Whisker | None, priors: dict[str, Any] | None
) -> tuple[pd.DataFrame, str]:
    """A table and a verdict on the trials of a fit, with its encoding, bias and priors."""
    _checks.one_of("--compare", name, NAMES)
    trials = fit.trials
    options: dict[str, Any] = {"bias": fit.bias, "priors": priors}
    if name == "law":
        test = fit.weber_law_test()
        return test.by_standard, test.report()
    if name == "noise":
        found = compare_noise(trials, encoding=fit.encoding, **options)
    elif name == "drift":
        found = compare_drift(trials, encoding=fit.encoding, noise=fit.noise, **options)
    else:
        if whisker is None or not isinstance(fit.encoding, CueEncoding):
            raise ValueError(
                f"--compare {name} needs a whisker to feel with, got none; write --identity C2, or "
                "a shape."
            )
        if name == "taper":
            found = compare_taper(trials, whisker, unit=fit.encoding.unit, **options)
        else:
            if fit.encoding.deflection_angle is None:
                raise ValueError(
                    "--compare cues needs the deflection angle of the contacts; write "
                    "--cue force-map --deflection-angle-deg 10, say."
                )
            found = compare_cues(
                trials, whisker, deflection_angle=fit.encoding.deflection_angle,
                unit=fit.encoding.unit, **options,
            )  # fmt: skip
    return found.table.reset_index(), found.report()
