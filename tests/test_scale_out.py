"""Every sweep of the package, on a cluster: the same bits as in this process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from analysis_scripts import load
from typer.testing import CliRunner

import weberwhisk as ww
from weberwhisk import campaign
from weberwhisk.cli import app
from weberwhisk.design import Scheme, read_plan, smallest, taper

WHISKER = ww.Whisker(50e-3, 100e-6, 5e-6)
PAIR = taper(WHISKER)
SCHEME = Scheme.spaced(PAIR[0].percept, [15e-3, 45e-3], trials=8)


def test_power_and_recovery(cluster: str) -> None:
    alone, there = (
        ww.power(SCHEME, PAIR, trials=[4, 8], runs=24, seed=3, **how).runs
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
        ww.jnd_sweep(WHISKER, [0.05, 0.1], [10e-3, 40e-3], draws=8, seed=1, **how)
        for how in ({}, {"scheduler": cluster})
    )
    pd.testing.assert_frame_equal(there, alone)


def test_calibration(cluster: str) -> None:
    calibration = load("calibration")
    chunks = [{"job": i, "sizes": [4, 1, 1, 1, 1, 0, 2], "seed": 1} for i in (0, 5)]
    alone, there = (
        campaign.run(calibration.one_job, chunks, seed=1, **how)
        for how in ({}, {"scheduler": cluster})
    )
    assert alone["name"].nunique() == 2
    pd.testing.assert_frame_equal(there, alone)


def test_the_command(cluster: str, tmp_path: Path) -> None:
    for folder, how in (("alone", ["--workers", "1"]), ("there", ["--scheduler", cluster])):
        asked = ["design", "--trials", "4", "--runs", "24", "--out", str(tmp_path / folder), *how]
        assert CliRunner().invoke(app, asked).exit_code == 0
    plans = [read_plan(tmp_path / folder / "plan.json") for folder in ("alone", "there")]
    assert plans[0].fingerprint == plans[1].fingerprint
    pd.testing.assert_frame_equal(plans[1].power, plans[0].power)
    both = CliRunner().invoke(app, ["design", "--scheduler", cluster, "--workers", "2"])
    assert both.exit_code == 2 or "has its own workers" in str(both.exception)
