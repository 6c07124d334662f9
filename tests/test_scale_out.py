"""Every sweep of the package, on a cluster: the same bits as in this process."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import load

import weberwhisk as ww
from weberwhisk import campaign
from weberwhisk._terminal import run_app
from weberwhisk.cli import app
from weberwhisk.design import Scheme, smallest, taper

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
PAIR = taper(WHISKER)
SCHEME = Scheme.spaced(PAIR[0].encoding, [15e-3, 45e-3], trials=4)


def test_power_and_recovery(cluster: str) -> None:
    alone, there = (
        ww.power(SCHEME, PAIR, trials=[2, 4], runs=8, seed=3, **how).runs
        for how in ({}, {"scheduler": cluster})
    )
    pd.testing.assert_frame_equal(there, alone)
    assert np.isfinite(alone["estimate"]).all()


def test_the_smallest_design(cluster: str) -> None:
    alone, there = (
        smallest(SCHEME, PAIR, runs=24, truths=["tapered"], seed=3, **how)
        for how in ({}, {"scheduler": cluster})
    )
    assert there.size == alone.size
    pd.testing.assert_frame_equal(there.path.runs, alone.path.runs)


def test_jnds(cluster: str) -> None:
    alone, there = (
        ww.jnd_sweep(WHISKER, [0.05, 0.1], [10e-3, 40e-3], n_readings=8, seed=1, **how)
        for how in ({}, {"scheduler": cluster})
    )
    pd.testing.assert_frame_equal(there, alone)


def test_calibration(cluster: str) -> None:
    calibration = load("calibration")
    chunks = [{"job": 5, "sizes": [4, 1, 1, 1, 1, 0, 2], "seed": 1}]
    alone, there = (
        campaign.run(calibration.one_job, chunks, seed=1, **how)
        for how in ({}, {"scheduler": cluster})
    )
    assert alone["rank"].between(0, 1).all()
    pd.testing.assert_frame_equal(there, alone)


def test_the_command(cluster: str, capsys: pytest.CaptureFixture[str]) -> None:
    few = ["--standard-mm", "10,30", "--level", "1,2", "--trials", "4", "--runs", "8", "--json"]
    answers = []
    for how in (["--workers", "1"], ["--scheduler", cluster]):
        assert run_app(app, ["design", *few, *how]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    assert answers[1] == answers[0]
    assert run_app(app, ["design", *few, "--scheduler", cluster, "--workers", "2"]) == 2
    assert capsys.readouterr() == (
        "",
        "weberwhisk: a cluster has its own workers, got workers=2 with a scheduler; leave one "
        "out.\n",
    )
