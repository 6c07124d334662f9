"""Work for sweeps, where every worker can import it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd


def draw(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """Every kind of column, from the seed; takes `seconds`, and notes in `log` that it ran."""
    rng = np.random.default_rng(seed)
    time.sleep(chunk.get("seconds", 0.0))
    if "log" in chunk:
        with open(chunk["log"], "a") as log:
            log.write(f"{chunk['i']}\n")
    x = rng.standard_normal(chunk.get("rows", 3)) / 3
    table = {
        "i": chunk["i"],
        "x": x,
        "half": x.astype(np.float32),
        "odd": [np.nan, np.inf, -0.0][: x.size],
        "big": rng.integers(2**62, size=x.size),
        "yes": x > 0,
        "word": ["é,\n\"'", None, "b\u2028"][: x.size],
    }
    return pd.DataFrame(table)


def matrices(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """Sums whose last bits depend on how many threads add them up."""
    a = np.random.default_rng(seed).standard_normal((chunk["n"], 30_000))
    return pd.DataFrame({"sum": (a @ a.T).sum(axis=1)})


def kill_always(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """Chunk 5 kills every worker."""
    if chunk["i"] == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return draw(chunk, seed)


def stumble(chunk: dict[str, Any], seed: np.random.SeedSequence) -> pd.DataFrame:
    """Chunk 4 raises an exception unless `mended`."""
    if chunk["i"] == 4 and not Path(chunk["mended"]).exists():
        raise ZeroDivisionError("by nothing")
    return draw(chunk, seed)


def shapeless(chunk: dict[str, Any], seed: np.random.SeedSequence) -> Any:
    """What is not a table of plain columns."""
    return {
        "list": [1],
        "dates": pd.DataFrame({"d": pd.to_datetime(["2020-01-01"])}),
        "number": pd.DataFrame([[1]]),
    }[chunk["what"]]
