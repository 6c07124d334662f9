"""Tables of choices, as counts, that tests of fits share."""

from __future__ import annotations

import numpy as np
import pandas as pd

from weberwhisk.behaviour import Trials, read_trials, response_probability, task_named
from weberwhisk.behaviour.encodings import IdentityEncoding

#: Comparisons beside a standard of 1.
NINE = np.linspace(0.7, 1.3, 9)


def counted(s2: list[float], n: list[int] | int, k: list[int], **columns: object) -> Trials:
    """A table of counts against standard 1."""
    frame = pd.DataFrame({"standard": 1.0, "comparison": s2, "n": n, "n_greater": k, **columns})
    return read_trials(frame)


def expected_counts(
    s2: np.ndarray, n: int, k: float, lapse: float = 0.0, bias: float = 0.0
) -> list[int]:
    p = response_probability(
        task_named("2AFC"), IdentityEncoding(), 1.0, s2, weber_fraction=k, lapse_low=lapse,
        lapse_high=lapse, bias=bias,
    )  # fmt: skip
    return np.round(n * p).astype(int).tolist()
