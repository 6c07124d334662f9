"""A result as finished as a paper needs, and the files around the code."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import runpy
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from short_forms import slow_but

import weberwhisk as ww
from weberwhisk.cli import app, run_app
from weberwhisk.commands.plans import rig_trials
from weberwhisk.design import Evidence, Plan, Precision, Scheme, plan_json, taper
from weberwhisk.design.plan import AnalysisResult
from weberwhisk.design.session import bpod_table, psychopy_tables
from weberwhisk.recordings import methods_paragraph

ROOT = Path(__file__).parents[2]


def test_a_population_has_its_report() -> None:
    fit = ww.fit_population(ww.simulate_population(3, trials_per_level=10, seed=1)[0])
    lines = fit.report().splitlines()
    for row in fit.subjects.to_dict("records"):
        (line,) = (one for one in lines if one.startswith(f"{row['subject']}:"))
        assert f"{row['n']} trials" in line
        assert row["status"] in line
    assert sum(line.startswith("Population, ") for line in lines) == len(fit.parameters)


def test_cite_agrees_with_the_citation_file() -> None:
    given = (ROOT / "CITATION.cff").read_text("utf-8")
    for words in ("10.1098/rstb.2011.0166", "2011", "Hartmann"):
        assert words in given
        assert words in ww.cite()
        assert words in ww.cite(bibtex=True)
    assert ww.cite(bibtex=True).count("{") == ww.cite(bibtex=True).count("}")
    assert ww.__version__ in ww.cite()


def test_the_version_is_that_of_the_tag_and_a_release_has_one_number() -> None:
    assert ww.__version__ == importlib.metadata.version("weberwhisk")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    assert "version" in project["project"]["dynamic"]
    settings = project["tool"]["hatch"]["version"]
    assert settings["source"] == "vcs"
    released = re.findall(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert settings["fallback-version"] == released[0]
    assert f"version: {released[0]}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


@pytest.fixture(scope="module")
def planned(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, Plan, pd.Series, AnalysisResult]:
    """A plan on disk, what a tapered observer judges farther in each trial, and its analysis."""
    scheme = Scheme([15e-3, 40e-3], [-3e-3, -1.5e-3, 1.5e-3, 3e-3], trials=40)
    hypotheses = taper(ww.Whisker(50e-3, 100e-6, 5e-6))
    plan = Plan(scheme, hypotheses, Evidence(bayes_factor=10))
    folder = tmp_path_factory.mktemp("plan")
    (folder / "plan.json").write_text(plan_json(plan), "utf-8")
    encoding, lists, rng = hypotheses[0].encoding, plan.trials, np.random.default_rng(1)
    first, second = (
        encoding.mean(lists[s] / 1e3)
        + 0.1 * encoding.sd_per_weber_fraction(lists[s] / 1e3) * rng.normal(size=len(lists))
        for s in ("stimulus_1_mm", "stimulus_2_mm")
    )
    answer = pd.Series(np.where((second - first) * encoding.direction > 0, 2, 1))
    direct = plan.analyse(ww.read_trials(plan.trials.assign(choice=answer - 1)))
    return folder, plan, answer, direct


@pytest.mark.parametrize("rig", slow_but(["psychopy", "bpod's own", "bpod", "own"], (0, 1, 2)))
def test_a_plan_is_analysed_on_a_rigs_own_table(
    planned: tuple[Path, Plan, pd.Series, AnalysisResult],
    rig: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, plan, answer, direct = planned
    if rig == "psychopy":  # its data file has rows of other routines, and the keys pressed
        parts = [table for _, table in psychopy_tables(plan.trials)]
        table = pd.concat(parts, ignore_index=True)
        table["key_resp.keys"] = answer.map({1: "left", 2: "right"})
        table["key_resp_go.keys"] = None
        welcome = pd.DataFrame({"participant": ["s1"], "key_resp_go.keys": "space"})
        table = pd.concat([welcome, table], ignore_index=True)
    elif rig == "bpod":
        table = bpod_table(plan.trials).assign(response=answer)
    elif rig == "bpod's own":  # lists are made before, and longer than the session
        fields = bpod_table(plan.trials).assign(response=answer)
        session = {name: np.append(fields[name].to_numpy(float), 0) for name in fields}
        session |= {"nTrials": len(fields), "Info": {"BpodVersion": 2}}
        savemat(tmp_path / "data.mat", {"SessionData": session})
    else:
        table = plan.trials.drop(columns=["block", "level", "greater"]).assign(choice=answer - 1)
    data = tmp_path / ("data.mat" if rig == "bpod's own" else "data.csv")
    if data.suffix == ".csv":
        table.to_csv(data, index=False)
    answers = rig_trials([data], plan).frame["count"]
    assert answers.tolist() == (answer - 1).tolist()
    if rig != "own":
        return
    assert run_app(app, ["analyse", str(folder / "plan.json"), str(data), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert not direct.left_out
    for name, value in direct.log_evidence.items():
        assert value < -10
        assert found["log_evidence"][name] == pytest.approx(value, rel=1e-6)


@pytest.mark.usefixtures("few_draws")
def test_the_analysis_of_a_plan_is_written(
    planned: tuple[Path, Plan, pd.Series, AnalysisResult], tmp_path: Path
) -> None:
    folder, plan, answer, _ = planned
    plan.trials.assign(choice=answer - 1).to_csv(tmp_path / "data.csv", index=False)
    command = ["analyse", str(folder / "plan.json"), str(tmp_path / "data.csv")]
    assert run_app(app, [*command, "--out", str(tmp_path / "out")]) == 0
    report = (tmp_path / "out" / "analysis.txt").read_text("utf-8")
    assert report.startswith(plan.title)
    assert "with an answer of 1 animal, analysed as planned" in report
    assert "Best: tapered, by a Bayes factor of" in report
    assert not re.search(r"10\^|e\+|\(\w+_\w+\)|1 animals", report)
    assert "lapse_low ~ beta" in (tmp_path / "out" / "analysis_methods.txt").read_text("utf-8")
    assert (tmp_path / "out" / "analysis.svg").stat().st_size > 5_000


def test_a_table_without_an_answer_is_refused(
    planned: tuple[Path, Plan, pd.Series, AnalysisResult],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, plan, *_ = planned
    bpod_table(plan.trials).to_csv(tmp_path / "data.csv", index=False)
    assert run_app(app, ["analyse", str(folder / "plan.json"), str(tmp_path / "data.csv")]) == 2
    assert "there is no one column of answers" in capsys.readouterr().err
    bpod_table(plan.trials).assign(response=3).to_csv(tmp_path / "data.csv", index=False)
    assert run_app(app, ["analyse", str(folder / "plan.json"), str(tmp_path / "data.csv")]) == 2
    assert "column 'response', rows 1, 2, 3 and" in (said := capsys.readouterr().err)
    assert "'3' is no answer; write left, 1 where" in said


@pytest.mark.usefixtures("few_draws")
def test_every_answer_of_every_table_is_analysed_or_refused(
    planned: tuple[Path, Plan, pd.Series, AnalysisResult], tmp_path: Path
) -> None:
    _, plan, answer, _ = planned
    own = plan.trials.drop(columns=["block", "level", "greater"])
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    half = len(own) // 2
    sides = answer.map({1: "left", 2: "right"})
    own.assign(choice=sides)[:half].to_csv(first, index=False)  # sides under the name of a choice
    rest = own.assign(response=answer.astype(object))[half:]
    rest.iloc[3, -1] = None
    rest.to_csv(second, index=False)
    trials = rig_trials([first, second], plan)
    assert (trials.n_trials, trials.n_missing) == (len(own) - 1, 1)
    given = trials.frame["count"]
    assert given[given.notna()].tolist() == (answer - 1)[given.notna().to_numpy()].tolist()
    found = plan.analyse(trials, unit=1e-3)
    words = found.report()
    assert "1 trial without an answer" in words
    assert "planned 10" in words
    precise = replace(plan, goal=Precision(half_width=0.2), power=None)
    precisely = precise.analyse(trials, unit=1e-3).report()
    assert "the planned 10" not in precisely  # of Bayes factors there was none
    rest.assign(response=answer - 1).to_csv(second, index=False)  # 0 and 1: which is which?
    with pytest.raises(ValueError, match=r"'0' is no answer; write left, 1 where"):
        rig_trials([first, second], plan)
    with pytest.raises(ValueError, match="write in it whose trial each row is"):
        replace(plan, scheme=plan.scheme.with_animals(2)).analyse(
            replace(trials, frame=trials.frame.drop(columns="subject"))
        )


def test_links_of_the_index_page_are_absolute() -> None:
    absolute = runpy.run_path(str(ROOT / ".ci/absolute_links"))["absolute"]
    text = absolute((ROOT / "README.md").read_text("utf-8"), "https://a.b/c", "v1")
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    assert any(t.startswith("https://a.b/c/raw/v1/analyses/figures/") for t in targets)
    assert all(re.match("https?:|#", target) for target in targets)


def test_workflows_cover_what_is_supported() -> None:
    workflow = (ROOT / ".github/workflows/tests.yml").read_text("utf-8")
    for name in ("ubuntu", "windows", "macos"):
        assert f"{name}-latest" in workflow
    for minor in range(11, 15):
        assert f'"3.{minor}"' in workflow
    assert ".ci/run" in workflow
    assert ".ci/lowest" in workflow


def test_nothing_is_of_one_system_alone() -> None:
    """No module or call that Windows lacks, and no text read or written in a locale's encoding."""
    modules = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty"}
    calls = {"fork", "getuid", "geteuid", "killpg", "mkfifo", "setsid", "sched_getaffinity",
             "SIGALRM", "SIGHUP", "SIGKILL", "WNOHANG"}  # fmt: skip
    found = []
    for path in sorted((ROOT / "weberwhisk").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = set()
            if isinstance(node, ast.Import):
                names = {alias.name for alias in node.names} & modules
            elif isinstance(node, ast.ImportFrom):
                names = {node.module} & modules
            elif isinstance(node, ast.Attribute):
                names = {node.attr} & calls
            elif isinstance(node, ast.Call):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                text = ""
                if called in ("open", "read_text", "write_text"):
                    text = ast.unparse(node)
                plain = text and "os.open" not in text
                if plain and not re.search(r"utf-8|encoding=|[\"'][rwax]\+?b", text):
                    names = {text}
            found += [f"{path.relative_to(ROOT)}: {name}" for name in names]
    assert found == []


@pytest.mark.slow
def test_located_contacts_have_a_methods_paragraph() -> None:
    whisker = ww.Whisker(50e-3, 100e-6, 5e-6)
    bent = ww.press(whisker, [20e-3, 20e-3, 30e-3], 0.3)
    signals = {"moment_uNm": bent.moment * 1e6, "axial_force_uN": bent.axial_force * 1e6}
    table = pd.DataFrame(signals | {"touch": [1, 1, 2]})
    text = methods_paragraph(ww.locate(table, whisker, touch="touch", noise=0.1))
    for said in ("3 rows of a table (3 converged)", "2 touches located", "Weber(0.1).",
                 "its curvature has a normal prior",
                 "radial_distance flat from 0 to 50 mm", "stiffness lognorm(", "ForceMap(",
                 f"weberwhisk {ww.__version__} (NumPy {np.__version__}"):  # fmt: skip
        assert said in text
