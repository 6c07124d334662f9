"""The short form of analyses/adaptive_peers.py, and its kept rows."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from analysis_scripts import FOLDER, load

peers = load("adaptive_peers")


def test_the_short_form_says_what_is_not_installed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(peers.METHODS, "SweetSpot", "no_such_module")
    table = peers.make(tmp_path, short=True)["adaptive_peers_trials"]
    assert "SweetSpot" in capsys.readouterr().out.split("not installed: ")[1]
    assert {"weberwhisk", "constant"} <= set(table["method"]) <= {*peers.METHODS} - {"SweetSpot"}


def test_the_kept_rows_say_what_the_page_says() -> None:
    table = peers.summary(pd.read_csv(FOLDER / "adaptive_peers.csv")).set_index("method")
    page = (FOLDER / "adaptive.md").read_text("utf-8")
    for method in ("weberwhisk", "questplus"):
        row = table.loc[method]
        assert f"| {row['trials_to_20_percent']:.0f} | {row['half_width_at_300']:.3f} |" in page
    assert np.isnan(table.loc["SweetSpot", "trials_to_20_percent"])
