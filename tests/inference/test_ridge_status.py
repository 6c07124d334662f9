"""A ridge whose integral failed says so: "unidentified" is no excuse for numbers."""

from __future__ import annotations

import numpy as np
import pytest

import weberwhisk as ww
from weberwhisk import Observer, Status, Whisker, cues, receptors


@pytest.mark.slow
def test_a_ridge_of_unknown_width_is_imprecise() -> None:
    """A cylinder's map: an sd of 0.11 m with an error of 4800 m, on a whisker of 1 m.

    It passed for UNIDENTIFIED, as all of a cylinder's readings do (M² = 2EI·Fx at every contact).
    """
    rod = Whisker(1.0, 2e-3, 2e-3, 3e9)
    contacts = np.array([[0.3, 0.2], [0.6, 0.3], [0.9, 0.1]])
    for k in (0.003, 0.03, 0.1):
        observer = Observer(rod, cues.ForceMap(), receptors.Weber(k))
        p = ww.posterior(observer, observer.read(contacts, 3))
        lost = p.sd_error > 0.5 * p.sd
        assert not np.isin(p.status[lost], (Status.CONVERGED, Status.UNIDENTIFIED)).any()
        known = p.sd_error < 0.05 * p.sd
        assert (p.status[known & (p.mean_error < 0.05 * p.sd)] == Status.UNIDENTIFIED).all()
