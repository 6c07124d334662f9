"""The package where a browser runs it: no threads, no processes, and only what Pyodide brings."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: What Python in WebAssembly is like: `sys.platform`, no thread starts, no processes, and of our
#: dependencies NumPy, SciPy, pandas and Matplotlib alone.
LIKE_PYODIDE = """
import sys, threading, warnings
import matplotlib.figure, numpy, pandas, scipy.stats

class Absent:
    names = {"arviz", "xarray", "emcee", "filelock", "threadpoolctl", "typer", "rich", "h5netcdf",
             "h5py", "_multiprocessing", "_posixshmem"}

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.names:
            raise ModuleNotFoundError(name)

def refuse(self):
    raise RuntimeError("can't start new thread")

for name in [n for n in sys.modules if n.partition(".")[0] in Absent.names]:
    del sys.modules[name]
sys.meta_path.insert(0, Absent())
threading.Thread.start = refuse
sys.platform = "emscripten"
warnings.simplefilter("error")
import weberwhisk as ww
"""

FIT = """
from weberwhisk import figures
trials = ww.simulate_trials(trials_per_level=20, seed=1)
fit = ww.fit_weber(trials)
figures.psychometrics(fit)
assert 0.05 < fit.weber_fraction < 0.3 and "Weber fraction" in fit.report()
"""
CONTACTS = """
observer = ww.Observer(ww.Whisker.from_identity("C2"), ww.cues.ForceMap())
assert ww.posterior(observer, observer.read([[20e-3, 0.26]] * 40, seed=1)).sd.shape[0] == 40
tap = ww.Observer(observer.whisker, ww.cues.Compliance())
assert (ww.jnd_curve(tap, [5e-3, 25e-3], n_readings=20, seed=1)["posterior"] > 0).all()
"""
PLAN = """
import tempfile
with tempfile.TemporaryDirectory() as folder:
    plan = ww.plan_experiment("C2", trials=10, runs=8, seed=1)
    ww.write_plan(plan, folder)
    assert ww.read_plan(folder + "/plan.json").fingerprint == plan.fingerprint
"""
CAMPAIGN = """
from weberwhisk.campaign import run, all_cores
from weberwhisk.jnd_surface import jnd_rows
tap = {"whisker": {"length": 50e-3, "base_radius": 1e-4, "tip_radius": 5e-6},
       "radial_distance": [5e-3], "deflection_angle": None, "method": "quadrature",
       "criterion": "d'=1", "n_readings": 4}
chunks = [tap | {"weber_fraction": k} for k in (0.05, 0.1)]
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    asked = run(jnd_rows, chunks, seed=1, workers=2)
assert [str(w.message) for w in said] == [
    "a browser has no processes: the chunks are done serially."]
assert asked.equals(run(jnd_rows, chunks, seed=1)) and all_cores(None, None) == 1
"""


@pytest.mark.parametrize(
    "work", [FIT, CONTACTS, PLAN, CAMPAIGN], ids=["fit", "contacts", "plan", "campaign"]
)
def test_it_runs_on_what_a_browser_has(work: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIKE_PYODIDE + work], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
