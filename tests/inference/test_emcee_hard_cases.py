"""emcee where it is known to fail in silence: several peaks, ridges, shelves, bent tails."""

import numpy as np
import pytest
from cue_checks import brute_force
from scipy import stats
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.cues import Compliance, ForceMap, Fused, Vibration
from weberwhisk.inference import Status
from weberwhisk.receptors import Weber

W = ww.Whisker(length=50e-3, base_radius=100e-6, tip_radius=5e-6)
CYLINDER = W.cylinder()
#: Two modes of a vibration leave two distances; a poor map does not tell which.
TWO = Fused(Vibration(2), ForceMap())


class TwoPlaces:
    """A prior of two narrow places, 100 sds apart."""

    parts = ((0.3, stats.norm(10e-3, 0.3e-3)), (0.7, stats.norm(40e-3, 0.3e-3)))

    def support(self):
        return 0.0, 50e-3

    def pdf(self, r):
        return sum(share * part.pdf(r) for share, part in self.parts)

    def logpdf(self, r):
        with np.errstate(divide="ignore"):
            return np.log(self.pdf(r))

    def cdf(self, r):
        return sum(share * part.cdf(r) for share, part in self.parts)

    def ppf(self, p):
        r = np.concatenate([np.linspace(*part.interval(1 - 1e-15), 2001) for _, part in self.parts])
        return np.interp(p, self.cdf(r), r)


#: Observer, contacts of which readings are taken.
CASES = {
    "two places": (
        ww.Observer(W, Compliance(), Weber(0.9), {"radial_distance": TwoPlaces()}),
        [[15e-3]] * 2,
    ),
    "two distances": (ww.Observer(W, TWO, TWO.joint(Weber(0.1), Weber(1.5))), [[20e-3, 0.2]] * 2),
    "shelf": (ww.Observer(W, Compliance(), Weber(0.3)), [[47.5e-3]] * 2),
    "ridge": (ww.Observer(CYLINDER, ForceMap(), Weber(0.1)), [[25e-3, 0.4]] * 2),
    "bent tail": (ww.Observer(W, ForceMap(), Weber(0.1)), [[4e-3, 0.7], [5e-3, 0.85]]),
    "near the fold": (ww.Observer(W, ForceMap(), Weber(0.1)), [[35e-3, 0.42]] * 2),
}


@pytest.mark.slow  # of ensembles by themselves: tests/util/test_ensemble.py
@pytest.mark.parametrize("case", slow_but(CASES, (2,)))
def test_no_wrong_sd_is_called_converged(case):
    observer, contact = CASES[case]
    readings = observer.read(np.array(contact), seed=1)
    p = ww.posterior(observer, readings, "emcee", seed=2)
    points = 200_000 if len(observer.unknowns) == 1 else 90_000
    exact = np.array([brute_force(observer, y, points=points) for y in readings])
    off = np.maximum(np.abs(p.mean - exact[:, 0]) / exact[:, 1], np.abs(p.sd / exact[:, 1] - 1))
    # Outside the domain (k above 0.6) converged posteriors say that instead.
    said = [Status.CONVERGED, Status.UNIDENTIFIED, Status.OUTSIDE_DOMAIN]
    reliable = np.isin(p.status, said)
    assert np.all(off[reliable] < 0.1)
    # Along a ridge the angle does not converge, and is said not to.
    assert reliable.any() == (case != "ridge")
    assert (p.status == Status.NOT_CONVERGED).all() == (case == "ridge")
