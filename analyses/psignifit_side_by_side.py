"""This package and psignifit on the same data: RMSE, bias, coverage and time.

    pip install psignifit
    OMP_NUM_THREADS=1 python analyses/psignifit_side_by_side.py [folder] [--sets N]

Writes `psignifit_side_by_side.md` and psignifit's answers, `psignifit_side_by_side.csv`, into this
folder, or the one named; answers that the table has already are not made again. The animals and
designs are those of `plain_grid.py`. psignifit fits a cumulative normal against ln(stimulus 2 /
stimulus 1) with equal asymptotes; its width, over 1.645 √2 twice, is its Weber fraction. Times are
CPU seconds.
"""

from __future__ import annotations

import csv
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import plain_grid as animals
from command import ANALYSES, markdown_table, options
from numpy.typing import NDArray
from scipy.stats import norm

from weberwhisk.behaviour import Trials, fit_weber, read_trials

Array = NDArray[np.float64]

COLUMNS = ["kind", "name", "set", "k", "lower", "upper", "seconds"]
OURS = {"weberwhisk": None, "weberwhisk, levels": {"weber_fraction": "levels"}}
TOOLS = (*OURS, "psignifit")
KINDS = {"train": "training", "held": "held out"}


def psignifit_answer(trials: Trials) -> tuple[float, float, float]:
    """psignifit's estimate and 95 % interval of the width, as a Weber fraction."""
    c = trials.cells()
    return psignifit_of(np.log(c.stimulus_2 / c.stimulus_1), c.count, c.n)


def psignifit_of(level: Array, count: Array, n: Array) -> tuple[float, float, float]:
    """The same of counts at levels on a log scale, all (C,)."""
    import psignifit

    table = np.column_stack([level, count, n])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = psignifit.psignifit(table, experiment_type="equal asymptote")
    ends = found.confidence_intervals["width"]["0.95"]
    # From 5 to 95 %, in sds of the difference of two signals; ln(I2/I1) has an sd of √2 k.
    per_width = 1 / (2 * norm.ppf(0.95) * np.sqrt(2))
    middle, low, high = (per_width * float(v) for v in (found.parameter_estimate["width"], *ends))
    return middle, low, high


def our_answer(design: animals.Design, count: Array, priors: Any = None) -> list[float]:
    """The same by `fit_weber`, by default or with other priors."""
    frame = pd.DataFrame(
        {"standard": 1.0, "stimulus_1": design.first, "stimulus_2": design.second,
         "n": design.per_level, "n_greater": count.astype(int)}
    )  # fmt: skip
    fit = fit_weber(read_trials(frame), priors=priors)
    return [fit.weber_fraction, *fit.interval()]


def data(kind: str, name: str, sets: int) -> tuple[animals.Design, Array, Array]:
    """A design, answers (sets, C), and the Weber fractions (sets,)."""
    if kind == "cell":
        design, count, k = animals.cell(name, sets)
        return design, count, np.full(sets, k)
    design, count, truth = animals.population(KINDS[kind], int(name), sets)
    return design, count, truth[0]


def bracketed(kind: str, name: str, sets: int) -> NDArray[np.bool_]:
    """Whether the animal's own answers, lapses and bias included, cross 25 and 75 %, (sets,)."""
    if kind == "cell":
        return np.ones(sets, dtype=bool)
    design, _, (k, low, high, bias) = animals.population(KINDS[kind], int(name), sets)
    rise = norm.cdf(design.drive / k[:, None] + bias[:, None])
    p = low[:, None] + (1 - low - high)[:, None] * rise
    return (p.min(axis=1) < 0.25) & (p.max(axis=1) > 0.75)


def make(path: Path, cells: int, each: int) -> None:
    """What the table of psignifit's answers lacks."""
    kept = (
        pd.read_csv(path, dtype={"name": str}) if path.is_file() else pd.DataFrame(columns=COLUMNS)
    )
    done = set(kept[["kind", "name", "set"]].itertuples(index=False, name=None))
    wanted = [("cell", name, i) for i in range(cells) for name in animals.CELLS]
    wanted += [(kind, str(n), i) for i in range(each) for kind in KINDS for n in range(8)]
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not done:
            writer.writerow(COLUMNS)
        for kind, name, i in wanted:
            if (kind, name, i) not in done:
                design, count, _ = data(kind, name, i + 1)
                start = time.process_time()
                n = np.full(design.first.size, design.per_level)
                answer = psignifit_of(np.log(design.second / design.first), count[i], n)
                seconds = time.process_time() - start
                writer.writerow([kind, name, i, *(f"{a:.6g}" for a in answer), f"{seconds:.3f}"])
                file.flush()


def side_by_side(kept: pd.DataFrame, kind: str, names: list[str]) -> dict[str, Any]:
    """Errors of all on the sets that psignifit has answered."""
    both: dict[str, list[Array]] = {tool: [] for tool in TOOLS}
    truth: list[Array] = []
    inside: list[NDArray[np.bool_]] = []
    times: dict[str, list[float]] = {tool: [] for tool in TOOLS}
    for name in names:
        own = kept[(kept["kind"] == kind) & (kept["name"] == name)].sort_values("set")
        if own.empty:
            continue
        at = own["set"].to_numpy()
        design, count, k = data(kind, name, int(at.max()) + 1)
        truth.append(k[at])
        inside.append(bracketed(kind, name, int(at.max()) + 1)[at])
        both["psignifit"].append(own[["k", "lower", "upper"]].to_numpy(float))
        times["psignifit"] += own["seconds"].dropna().tolist()  # further sets have none
        for tool, priors in OURS.items():
            start = time.process_time()
            both[tool].append(np.array([our_answer(design, count[i], priors) for i in at]))
            times[tool].append((time.process_time() - start) / at.size)
    k = np.concatenate(truth)
    return {
        "bracketed": np.concatenate(inside),
        **{tool: np.concatenate(rows) / k[:, None] for tool, rows in both.items()},
        "seconds": {tool: float(np.mean(t)) for tool, t in times.items()},
    }


def in_per_cent(relative: Array) -> str:
    """RMSE of estimates over their truth, and the standard error of it."""
    square = (relative - 1) ** 2
    rmse = np.sqrt(square.mean())
    return f"{100 * rmse:.1f} ({100 * square.std() / np.sqrt(square.size) / (2 * rmse):.1f})"


def lines_of(title: str, found: dict[str, Any], bracketed: bool | None = None) -> list[list[str]]:
    """Rows of the table, of some sets or all; the bias is that of the median."""
    out = []
    for tool in TOOLS:
        which = slice(None) if bracketed is None else found["bracketed"] == bracketed
        relative = found[tool][which]
        inside = (relative[:, 1] < 1) & (relative[:, 2] > 1)
        rmse = np.sqrt(np.mean(np.log(relative[:, 0]) ** 2))
        out.append([
            title, tool, str(len(relative)), in_per_cent(relative[:, 0]), f"{rmse:.3f}",
            f"{100 * (np.median(relative[:, 0]) - 1):+.1f}", f"{100 * inside.mean():.1f}",
            f"{1e3 * found['seconds'][tool]:.0f}",
        ])  # fmt: skip
    return out


def report(kept: pd.DataFrame) -> str:
    """The page of text."""
    heads = ["data", "tool", "sets", "RMSE of k, %, and its error", "RMSE of ln k", "bias, %",
             "covers, %", "CPU ms"]  # fmt: skip
    lines: list[list[str]] = []
    above: dict[str, list[str]] = {tool: [] for tool in OURS}
    sets = [(name, "cell", [name], None) for name in animals.CELLS]
    for kind, part in KINDS.items():
        for words, which in (("levels bracket 25 and 75 %", True), ("they do not", False)):
            title = f"animals and designs, {part}: {words}"
            sets.append((title, kind, [str(n) for n in range(8)], which))
    found: dict[str, Any] = {}
    for title, kind, names, which in sets:
        if which is not False:  # the same answers serve both rows of a part
            found = side_by_side(kept, kind, names)
        lines += lines_of(title, found, which)
        rows = slice(None) if which is None else found["bracketed"] == which
        loss = {tool: (found[tool][rows, 0] - 1) ** 2 for tool in TOOLS}
        for tool, titles in above.items():
            more = loss[tool] - loss["psignifit"]  # on the same answers
            by = more.mean() / more.std() * np.sqrt(more.size)
            titles += [f"{title} (by {by:.1f} standard errors)"] if by > 0 else []
    said = {tool: "; ".join(titles) or "none" for tool, titles in above.items()}
    return TEXT.format(table=markdown_table(heads, lines), above=said["weberwhisk"],
                       by_levels=said["weberwhisk, levels"])  # fmt: skip


TEXT = """# The same data fitted by weberwhisk and by psignifit

Made by `psignifit_side_by_side.py`, psignifit 4.3 at its defaults with equal asymptotes; the cells
are single animals, the last rows the population of `lapse_prior.py`, those apart whose answers
(lapses and bias included) do not cross 25 and 75 % at the levels shown. Lapses are 0.02 at each end
where nothing else is said. All had the same answers.

{table}

*weberwhisk* has its default priors; *weberwhisk, levels* believes that the levels bracket the
thresholds, `priors={{"weber_fraction": "levels"}}`, as psignifit does unasked (its prior of the
width spans the levels shown). The RMSE of k is above psignifit's, by so many standard errors of the
difference of squared errors on the same sets,

- by default: {above};
- with the levels: {by_levels}.

By default the cell k = 0.2, 117 trials stays above: with 117 trials that end 0.9 sd from the
standard even an observer informed of both lapses and the bias has an RMSE of 21 % there (plain
grid, `lapse_prior.py`), and what is gained is gained by the prior. It has 272 data sets more than
the others, which were made to see whether that was chance: on these alone psignifit has 17.8 (1.2),
the default 24.7 (1.5), the belief about the levels 16.8 (0.6) %. Why the belief about the levels
is not the default, although it loses less in nearly every row: it would be wrong for staircases,
for one level and wherever levels do not bracket the thresholds (`lapse_prior.md`, which also has
mixtures of both, other estimates and other priors: none is right in both).
"""


def main() -> None:
    asked = options(__file__, __doc__, folder=ANALYSES, sets=150)
    asked.folder.mkdir(parents=True, exist_ok=True)
    path = asked.folder / "psignifit_side_by_side.csv"
    make(path, asked.sets, max(asked.sets // 3, 1))
    text = report(pd.read_csv(path, dtype={"name": str}))
    (asked.folder / "psignifit_side_by_side.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
