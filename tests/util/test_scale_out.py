"""A cluster: every sweep of the package has the same bits as in this process, and ends as well."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import campaign_work
import numpy as np
import pandas as pd
import pytest
from test_campaign import CHUNKS, logged, same

import weberwhisk as ww
from weberwhisk._util.campaign import CampaignError, run
from weberwhisk.cli import app, run_app
from weberwhisk.design import Scheme, taper
from weberwhisk.inference import quadrature

HERE = Path(__file__).parents[1]

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
PAIR = taper(WHISKER)
SCHEME = Scheme.spaced(PAIR[0].encoding, [15e-3, 45e-3], trials=4)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler, and a worker process that is replaced when it dies."""
    pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("cluster")
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(
            [str(HERE), *(str(HERE.parent / f) for f in ("", "analyses")), *sys.path]
        ),
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "2",
        # It stands idle until the last test has run, at a third of what watching itself costs.
        "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
        "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
    }
    file = folder / "scheduler.json"
    where = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(file)]
    commands = [
        ["scheduler", "--port", "0", *where],
        ["worker", "--nworkers", "1", "--nthreads", "1", "--no-dashboard",
         "--scheduler-file", str(file), "--local-directory", str(folder)],
    ]  # fmt: skip
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "dask", *c], env=environment, cwd=folder,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        for c in commands
    ]  # fmt: skip
    try:
        while not file.exists():
            assert processes[0].poll() is None
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()


# -- chunks that end, fail and kill


def test_a_cluster_gives_the_same_bits(cluster: str) -> None:
    alone = run(campaign_work.draw, CHUNKS, seed=7)
    same(run(campaign_work.draw, CHUNKS, seed=7, scheduler=cluster), alone)


@pytest.mark.slow
def test_exceptions_and_killers_on_the_cluster(cluster: str, tmp_path: Path) -> None:
    chunks = logged(tmp_path, 9, mended=str(tmp_path / "mended"))
    with pytest.raises(CampaignError, match=r"chunk 4 .* failed: ZeroDivisionError: by nothing"):
        run(campaign_work.stumble, chunks, seed=7, scheduler=cluster)
    with pytest.raises(CampaignError, match="has killed its workers"):
        run(campaign_work.kill_always, logged(tmp_path, 6), seed=7, scheduler=cluster)


def test_no_cluster_is_said_to_be_none(monkeypatch: pytest.MonkeyPatch) -> None:
    dask = pytest.importorskip("dask")
    pytest.importorskip("distributed")  # whose settings would go with this one's end
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "0.3s"}),
        pytest.raises(ValueError, match=r"no scheduler could be reached at 'tcp://127\.0\.0\.1:9'"),
    ):
        run(campaign_work.draw, CHUNKS, seed=7, scheduler="tcp://127.0.0.1:9")
    assert dask.config.get("scheduler", None) is None  # nor is it anybody else's from now on
    with pytest.raises(ValueError, match="no scheduler could be reached at 'nonsense'"):
        run(campaign_work.draw, CHUNKS, seed=7, scheduler="nonsense")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"pip install 'weberwhisk\[cluster\]'"):
        run(campaign_work.draw, CHUNKS, seed=7, scheduler="tcp://127.0.0.1:9")


# -- every sweep of the package


def test_power_and_recovery(cluster: str) -> None:
    alone, there = (
        ww.power(SCHEME, PAIR, trials=[2, 4], runs=8, seed=3, **how).runs
        for how in ({}, {"scheduler": cluster})
    )
    pd.testing.assert_frame_equal(there, alone)
    assert np.isfinite(alone["estimate"]).all()


def test_posteriors(cluster: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quadrature, "TOGETHER", 2)
    observer = ww.Observer(WHISKER, ww.cues.Compliance())
    y = observer.read([[15e-3], [25e-3], [35e-3]], seed=1)
    alone, there = (ww.posterior(observer, y, scheduler=where) for where in (None, cluster))
    pd.testing.assert_frame_equal(there.summary(), alone.summary())


FEW = ["design", "--standard-mm", "10,30", "--level", "1,2", "--trials", "4", "--runs", "8",
       "--json", "--find", "nothing"]  # fmt: skip


@pytest.mark.slow  # of power: as Python has it, above
def test_the_command(cluster: str, capsys: pytest.CaptureFixture[str]) -> None:
    answers = []
    for how in (["--workers", "1"], ["--scheduler", cluster]):
        assert run_app(app, [*FEW, *how]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    assert answers[1] == answers[0]


def test_workers_of_a_cluster_are_its_own(cluster: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(app, [*FEW, "--scheduler", cluster, "--workers", "2"]) == 2
    assert capsys.readouterr() == (
        "",
        "weberwhisk: a cluster has its own workers, got --workers 2 with a scheduler; leave one "
        "out.\n",
    )
