"""The package where a browser runs it, and what the pages of docs/browser compute.

Here on CPython; `test_browser_pages.py` opens the pages in Chromium.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import subprocess
import sys
import zipfile
from importlib.metadata import Distribution
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.behaviour import CueEncoding

pytestmark = pytest.mark.usefixtures("few_draws")

ROOT = Path(__file__).parents[2]
BROWSER, DATA = ROOT / "docs" / "browser", ROOT / "data_synthetic"
WHISKER = {"length_mm": "50", "base_radius_um": "100", "tip_radius_um": "5"}

#: What Python in WebAssembly is like: `sys.platform`, no thread starts, no processes, and of our
#: dependencies NumPy, SciPy, pandas and Matplotlib alone.
LIKE_PYODIDE = """
import sys, threading, warnings
import matplotlib.figure, numpy, pandas, scipy.stats

class Absent:
    names = {"arviz", "xarray", "emcee", "cattrs", "attrs", "filelock", "threadpoolctl", "typer",
             "rich", "h5netcdf", "h5py", "_multiprocessing", "_posixshmem"}

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
from weberwhisk import plots
trials = ww.simulate_trials(trials_per_level=20, seed=1)
fit = ww.fit_weber(trials)
plots.psychometrics(fit)
assert 0.05 < fit.weber_fraction < 0.3 and "Weber fraction" in fit.report()
"""
CONTACTS = """
observer = ww.Observer(ww.Whisker.from_identity("C2"), ww.cues.ForceMap())
assert ww.posterior(observer, observer.read([[20e-3, 0.26]] * 8, seed=1)).sd.shape[0] == 8
tap = ww.Observer(observer.whisker, ww.cues.Compliance())
assert (ww.jnd_curve(tap, [5e-3, 25e-3], n_readings=4, seed=1)["posterior"] > 0).all()
"""
PLAN = """
import json, tempfile
with tempfile.TemporaryDirectory() as folder:
    plan = ww.plan_experiment("C2", standards=[20e-3], levels=[-1, 1], trials=10, runs=8, seed=1)
    ww.write_plan(plan, folder)
    with open(folder + "/plan.json", encoding="utf-8") as file:
        assert json.load(file)["trials_sha256"] == plan.fingerprint
"""
CAMPAIGN = """
from weberwhisk._util.campaign import run, all_cores
from functools import partial
from weberwhisk.design import Evidence, Scheme, SubjectPopulation, taper
from weberwhisk.design.simulation import experiments
pair = taper(ww.Whisker(50e-3, 100e-6, 5e-6))
work = partial(experiments, scheme=Scheme([15e-3], [-2e-3, 2e-3]), hypotheses=pair,
               animals=SubjectPopulation(), goal=Evidence(10))
chunks = [{"truth": "tapered", "trials": n, "animals": 1, "runs": 2} for n in (5, 10)]
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    asked = run(work, chunks, seed=1, workers=2)
assert [str(w.message) for w in said] == [
    "a browser has no processes: the chunks are done serially."]
assert asked.equals(run(work, chunks, seed=1)) and all_cores(None, None) == 1
"""


def test_it_runs_on_what_a_browser_has() -> None:
    """In one process, as what they import takes a second each."""
    work = LIKE_PYODIDE + FIT + CONTACTS + PLAN + CAMPAIGN
    done = subprocess.run([sys.executable, "-c", work], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def pages() -> ModuleType:
    return _module("pages")


def _module(name: str) -> ModuleType:
    spec = spec_from_file_location(name, BROWSER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _guessed(pages: ModuleType, file: str) -> dict[str, str]:
    """What the page of fits sends when nobody touches its menus."""
    path = str(DATA / file)
    menus = json.loads(pages.call("columns", json.dumps({"file": path})))["menus"]
    chosen = {menu["name"]: menu["value"] for menu in menus}
    return WHISKER | chosen | {"file": path, "scale": "linear"}


@pytest.mark.parametrize("scale", slow_but(["linear", "whisker"], (0,)))
def test_the_page_of_fits_answers_as_the_library_does(pages: ModuleType, scale: str) -> None:
    fields = _guessed(pages, "distance_tapered.csv") | {"scale": scale}
    shown = json.loads(pages.call("fit", json.dumps(fields)))
    tap = ww.Observer(ww.Whisker(50e-3, 100e-6, 5e-6), ww.cues.Compliance())
    fit = ww.fit_weber(
        ww.read_trials(DATA / "distance_tapered.csv"),
        encoding=None if scale == "linear" else CueEncoding(tap, unit=1e-3),
    )
    assert [text["body"] for text in shown["texts"]] == [
        fit.report(),
        fit.methods(),
    ]
    estimates = shown["tables"][0]
    row = dict(zip(estimates["columns"], estimates["rows"][0], strict=True))
    assert row["parameter"] == "weber_fraction"
    assert float(row["median"]) == pytest.approx(fit.weber_fraction, rel=1e-3)
    assert shown["figures"][0]["svg"].lstrip().startswith("<?xml")


def test_the_page_of_fits_maps_columns_and_labels(pages: ModuleType, tmp_path: Path) -> None:
    table = pd.read_csv(DATA / "weights_three_standards.csv")
    said = table["choice"].map({1: "R", 0: "L"})
    own = pd.DataFrame({"left": table["stimulus_1"], "right": table["stimulus_2"], "said": said})
    own.to_csv(tmp_path / "own.csv", index=False)
    fields = _guessed(pages, "weights_three_standards.csv")
    asked = json.loads(pages.call("columns", json.dumps({"file": str(tmp_path / "own.csv")})))
    greater = next(menu for menu in asked["menus"] if menu["name"] == "greater")
    assert sorted(greater["values"]["said"]) == ["L", "R"]
    chosen = {"first": "left", "second": "right", "answer": "said", "greater": "R", "session": ""}
    own_fields = fields | chosen | {"file": str(tmp_path / "own.csv")}
    found = [json.loads(pages.call("fit", json.dumps(f))) for f in (fields, own_fields)]
    assert found[0]["tables"] == found[1]["tables"]
    refused = json.loads(pages.call("fit", json.dumps(own_fields | {"greater": ""})))
    assert refused.keys() == {"error"}
    assert "is not an answer" in refused["error"]


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_page_of_fits_takes_percent_correct_and_several_animals(
    pages: ModuleType, tmp_path: Path, whole: bool
) -> None:
    """Animals together in the whole form."""
    fields = _guessed(pages, "weights_percent_correct.csv")
    assert fields["kind"] == "correct"
    assert "Weber fraction" in json.loads(pages.call("fit", json.dumps(fields)))["texts"][0]["body"]
    animals = pd.read_csv(DATA / "animals_six.csv")
    two = animals[animals["subject"].isin(["s1", "s2"])]
    two.groupby("subject").head(90).to_csv(tmp_path / "two.csv", index=False)
    fields = _guessed(pages, str(tmp_path / "two.csv"))
    one = json.loads(pages.call("fit", json.dumps(fields | {"of": "s2"})))
    assert "90 trials" in one["texts"][0]["body"]
    if not whole:
        return
    together = json.loads(pages.call("fit", json.dumps(fields)))
    assert [row[0] for row in together["tables"][1]["rows"]] == ["s1", "s2"]


def test_the_page_of_jnds_says_what_the_closed_form_does(pages: ModuleType) -> None:
    fields = WHISKER | {"weber_fraction": "0.05", "criterion": "d'=1", "identity": ""}
    shown = json.loads(pages.call("jnd", json.dumps(fields)))
    length, apex = 50.0, 50.0 / (1 - 1 / 20)
    for row in shown["tables"][0]["rows"]:
        r = float(row[1])
        closed = 0.05 * r * (1 - r / apex if row[0] == "tapered" else 1)
        assert float(row[2]) == pytest.approx(closed, rel=1e-3)
        if row[0] == "tapered" and 0.1 < r / length < 0.8:
            assert float(row[3]) == pytest.approx(closed, rel=0.03)
    mean = json.loads(pages.call("mean_whisker", json.dumps({"identity": "C2"})))["set"]
    assert mean == {"length_mm": 33.6, "base_radius_um": 69.5, "tip_radius_um": 1.75}


def test_the_page_of_plans_gives_the_lists_that_the_library_gives(pages: ModuleType) -> None:
    fields = WHISKER | {
        "goal": "taper", "standards_mm": "15, 40", "trials": "6", "animals": "1",
        "weber_fraction": "0.1", "trials_per_session": "100", "runs": "0", "seed": "3",
    }  # fmt: skip
    shown = json.loads(pages.call("plan", json.dumps(fields)))
    content = base64.b64decode(shown["files"][0]["base64"])
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        lists = archive.read("plan/trials.csv")
    plan = ww.plan_experiment(
        ww.Whisker(50e-3, 100e-6, 5e-6), standards=[15e-3, 40e-3], trials=6, runs=0, seed=3
    )
    assert hashlib.sha256(lists).hexdigest() == plan.fingerprint
    assert len(shown["tables"][0]["rows"]) == len(plan.levels)


def test_the_pages_are_whole_and_may_send_nothing(tmp_path: Path) -> None:
    _module("build").build(tmp_path / "pages")
    made = {path.name for path in (tmp_path / "pages").iterdir()}
    for name in ("jnd", "fit", "plan"):
        page = (tmp_path / "pages" / f"{name}.html").read_text("utf-8")
        linked = set(re.findall(r'(?:href|src|data-sample)="([\w.]+)"', page))
        assert {"style.css", "page.js", "jnd.html", "fit.html", "plan.html"} <= linked <= made
        policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
        assert policy is not None
        rules = dict(rule.split(" ", 1) for rule in policy[1].split("; "))
        assert rules["default-src"] == rules["form-action"] == "'none'"
        # jsDelivr serves Pyodide and takes nothing; with Pyodide beside them not even that.
        assert rules["connect-src"].split() == ["'self'", _module("build").CDN]
        called = re.findall(r'data-(?:call|preset|menus)="(\w+)"', page)
        assert set(called) <= set(_module("pages").CALLS)
    with zipfile.ZipFile(tmp_path / "pages" / "weberwhisk.zip") as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path)
    (told,) = Distribution.discover(name="weberwhisk", path=[str(tmp_path)])
    assert told.version == ww.__version__
    assert {"pages.py", "weberwhisk/__init__.py", "weberwhisk/data/whisker_morphology.csv"} <= names


def test_pyodide_that_is_not_what_its_lock_file_says_is_refused(tmp_path: Path) -> None:
    build = _module("build")
    with pytest.raises(ValueError, match=r"has no pyodide\.mjs"):
        build.build(tmp_path / "pages", str(tmp_path))
    for name in (*build.RUNTIME, "a.whl"):
        (tmp_path / name).write_text("x")
    package = {"file_name": "a.whl", "sha256": hashlib.sha256(b"y").hexdigest(), "depends": []}
    lock = {"packages": dict.fromkeys(build.PACKAGES, package)}
    (tmp_path / build.LOCK).write_text(json.dumps(lock))
    with pytest.raises(ValueError, match=r"a\.whl' is not the file that pyodide-lock"):
        build.build(tmp_path / "pages", str(tmp_path))
