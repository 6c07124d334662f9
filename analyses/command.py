"""What the scripts of this folder share: a command line (where to write, how much), and tables."""

from __future__ import annotations

import argparse
import inspect
import platform
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from weberwhisk._util.output import versions_in_words

ANALYSES = Path(__file__).parent


def options(
    script: str,
    description: str | None,
    *,
    folder: str | Path | None = None,
    short: str = "",
    sets: int | None = None,
    seed: int | None = None,
    workers: bool = False,
    drawn: Sequence[str] = (),
    parts: Sequence[str] = (),
) -> argparse.Namespace:
    """What was written after the script's name; `--help` prints its docstring and ends.

    Parameters
    ----------
    script, description : str
        Its ``__file__`` and ``__doc__``.
    folder : path, optional
        Where it writes if no folder is named: ``results/`` and its name, beside this folder.
    short : str
        What `--short` leaves out; without it there is no such option.
    sets, seed : int, optional
        Data sets of each kind and seed, by default.
    workers : bool
        Whether it takes `--workers` and `--scheduler`.
    drawn : sequence of str
        Columns of a table that it made, which `--draw` reads; without them no such option.
    parts : sequence of str
        Of which `--only` takes one, and may be said again.
    """
    parser = argparse.ArgumentParser(
        description=inspect.cleandoc(description or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    path = Path(script)
    own = path.parent.name if path.stem == "make" else path.stem
    usual = folder or ANALYSES.parent / "results" / own
    parser.add_argument("folder", type=Path, nargs="?", default=Path(usual))
    if short:
        parser.add_argument("--short", action="store_true", help=short)
    if sets is not None:
        parser.add_argument("--sets", type=int, default=sets, help=f"data sets; by default {sets}")
    if seed is not None:
        parser.add_argument("--seed", type=int, default=seed, help=f"by default {seed}")
    if workers:
        parser.add_argument("--workers", type=int, help="processes; by default one a core")
        parser.add_argument("--scheduler", help="of a dask.distributed cluster")
    if drawn:
        parser.add_argument(
            "--draw", type=partial(kept, drawn), help="draw this table, and compute nothing"
        )
    if parts:
        parser.add_argument(
            "--only",
            action="append",
            default=[],
            choices=parts,
            metavar="NAME",
            help="again for more",
        )
    return parser.parse_args()


def kept(columns: Sequence[str], path: str | Path) -> pd.DataFrame:
    """A table that a script made, with all of these columns; anything else is refused."""
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise argparse.ArgumentTypeError(f"{path} is no table: {str(error).strip()}") from error
    if missing := [name for name in columns if name not in table]:
        raise argparse.ArgumentTypeError(
            f"{path} lacks {', '.join(missing)}; give a table that this script made"
        )
    return table


def resumed(
    path: Path,
    one: Callable[..., dict[str, Any]],
    designs: Iterable[dict[str, Any]],
    digits: int = 5,
    columns: Sequence[str] = (),
) -> pd.DataFrame:
    """A row a design, by `one`: those that the table has, and the others, each kept once made.

    A table that lacks what designs have, or further columns, is another's: the script ends with a
    sentence, and the table stays as it is.
    """
    designs, rows = list(designs), []
    if path.exists():
        try:
            rows = kept([*next(iter(designs), {}), *columns], path).to_dict("records")
        except argparse.ArgumentTypeError as error:
            raise SystemExit(str(error)) from error
    for design in designs:
        if not any(design.items() <= row.items() for row in rows):
            rows.append(one(**design))  # type: ignore[arg-type]
            pd.DataFrame(rows).to_csv(path, index=False, float_format=f"%.{digits}g")
    return pd.DataFrame(rows)


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def with_units(
    table: pd.DataFrame, lengths: Iterable[str], angles: Iterable[str] = ()
) -> pd.DataFrame:
    """Lengths in mm and angles in degrees, with the unit in the names of their columns."""
    lengths, angles = list(lengths), list(angles)
    scaled = table.assign(**1e3 * table[lengths], **np.degrees(table[angles]))
    names = {name: f"{name}_mm" for name in lengths} | {name: f"{name}_deg" for name in angles}
    return scaled.rename(columns=names)


def machine(*packages: str) -> str:
    """`versions_in_words` and the kind of processor, for the foot of a figure of times."""
    words = versions_in_words("numpy", "scipy", "emcee", *packages)
    return f"{words}; {processor()}, one core, CPU time"


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
