"""New users on their first day: what they type, what it costs, and whether it is true.

    python tests/first_day/play.py [folder]

makes a fresh environment in the folder (default: a temporary one), installs this repository there,
and plays own choices, designs of distances, durations and levels, the paper with a receptor of
one's own, and a tracked video. It
prints the CPU seconds of every command, and fails where an answer is wrong or a bar is missed.
"""

from __future__ import annotations

import csv
import json
import math
import os
import random
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import venv
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "data_synthetic"
#: What the users may need at most: commands, and CPU seconds of the dearest.
BARS: dict[str, tuple[int, float]] = {
    "own choices": (1, 30.0),
    "a design": (1, 60.0),
    "a design that cannot work": (1, 3.0),
    "durations: a plan": (1, 60.0),
    "durations: its analysis": (1, 5.0),
    "durations: trial by trial": (3, 10.0),
    "a rodent lab: a plan": (1, 60.0),
    "a rodent lab: its analysis": (1, 5.0),
    "the paper, and an own receptor": (2, 60.0),
    "a tracked video": (1, 30.0),
}
RECEPTOR = """
from dataclasses import dataclass
import numpy as np
import weberwhisk as ww
from weberwhisk.receptors import Gaussian

@dataclass(frozen=True, eq=False, repr=False)
class SquareRoot(Gaussian):
    size: float = 1e-4
    correlation: float = 0.0

    def sd(self, signals):
        return self.size * np.sqrt(np.abs(signals))

whisker = ww.Whisker(50e-3, 100e-6, 5e-6, curvature=0)
observer = ww.Observer(whisker, ww.cues.Compliance(), SquareRoot())
print(ww.jnd_curve(observer, [10e-3, 20e-3, 30e-3], n_readings=READINGS, seed=1).table.to_json())
"""


@dataclass
class Day:
    """An environment's Python, a folder to work in, and what was typed there."""

    python: Path
    folder: Path
    typed: list[tuple[str, float, str]] = field(default_factory=list)

    def types(self, user: str, *words: str, ends: int = 0, stdin: str = "") -> str:
        """Run a command; what it printed. Its CPU seconds are kept."""
        command = [str(self.python), "-m", "weberwhisk.cli"] if words[0] == "weberwhisk" else [
            str(self.python)]  # fmt: skip
        before = _cpu_seconds()
        done = subprocess.run(
            [*command, *words[1:]],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            input=stdin,
        )
        self.typed.append((user, _cpu_seconds() - before, " ".join(words)[:90].splitlines()[0]))
        assert done.returncode == ends, f"{words}: {done.stdout}{done.stderr}"
        return done.stderr if ends else done.stdout

    def missed(self) -> list[str]:
        """Bars that were missed."""
        found = []
        for user, (commands, seconds) in BARS.items():
            own = [cpu for one, cpu, _ in self.typed if one == user]
            if len(own) > commands:
                found.append(f"{user}: {len(own)} commands, at most {commands}")
            if max(own, default=0.0) > seconds:
                found.append(f"{user}: {max(own):.1f} s of CPU, at most {seconds:g}")
        return found


def _cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def own_choices(day: Day) -> None:
    """From a table with names and labels of one's own to report, figure and methods."""
    with (DATA / "weights_three_standards.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with (day.folder / "own.csv").open("w", encoding="utf-8", newline="") as file:
        own = csv.writer(file)
        own.writerow(["left", "right", "said"])
        said = {"0": "L", "1": "R"}
        own.writerows(
            [row["stimulus_1"], row["stimulus_2"], said.get(row["choice"], "")] for row in rows
        )
    columns = ("stimulus_1=left", "stimulus_2=right", "choice=said")
    mapped = [word for column in columns for word in ("--column", column)]
    labels = ["--label", "L=first", "--label", "R=second"]
    printed = day.types("own choices", "weberwhisk", "fit", "own.csv", *mapped, *labels,
                        "--out", "own")  # fmt: skip
    assert "Weber fraction: " in printed
    assert "and 9 without an answer" in printed
    assert {p.name for p in (day.folder / "own").iterdir()} > {"fit_report.txt", "psychometric.png"}
    with (day.folder / "own" / "fit.csv").open(encoding="utf-8") as file:
        k = next(row for row in csv.DictReader(file) if row["parameter"] == "weber_fraction")
    assert float(k["lower"]) < 0.1 < float(k["upper"])  # as it was simulated


def a_design(day: Day, *options: str) -> None:
    """Trials, lists and power of an experiment that can work."""
    day.types("a design", "weberwhisk", "design", "--identity", "C2", "--question", "whiskers",
              *options, "--out", "plan")  # fmt: skip
    plan = json.loads((day.folder / "plan" / "plan.json").read_text("utf-8"))
    assert plan["trials_sha256"]
    made = {path.name for path in (day.folder / "plan").iterdir()}
    assert {"trials.csv", "preregistration.txt"} <= made, made


def an_infeasible_design(day: Day) -> None:
    """Four animals whose k differ cannot tell it to 20 %; what is advised can."""
    said = day.types("a design that cannot work", "weberwhisk", "design", "--identity", "C2",
                     "--question", "precision", "--half-width", "0.2", "--animals", "4",
                     ends=2)  # fmt: skip
    assert "write --animals " in said


#: What nothing that is said of another magnitude has a word of.
WHISKERS = re.compile(r"millimet|\bmm\b|_mm\b|(?<!weber)whisk|distance|farther|nearer", re.I)


def _answered(table: Path, chance: Callable[[dict[str, str]], float], *columns: str) -> None:
    """A trial list with the answers of someone who says so with this chance."""
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    draws = random.Random(1)
    with table.open("w", encoding="utf-8", newline="") as file:
        kept = csv.DictWriter(file, [*rows[0], *columns])
        kept.writeheader()
        for row in rows:
            yes = int(draws.random() < chance(row))
            kept.writerow(row | dict.fromkeys(columns, yes))


def _longer(first: float, second: float, k: float = 0.12) -> float:
    """Chance of an answer that the second of two is the greater."""
    z = (second - first) / (k * math.hypot(first, second))
    return 0.02 + 0.96 * 0.5 * math.erfc(-z / math.sqrt(2))


def durations(day: Day, *options: str) -> None:
    """A psychophysicist of durations: Weber's law against a rival, people, and one session."""
    user = "durations"
    command = ("weberwhisk", "design", "--magnitude", "duration", "--unit", "ms", "--standards",
               "300,600,1200", "--people", "1", "--rival", "exponent:0.5")  # fmt: skip
    said = day.types(f"{user}: a plan", *command, *options, "--out", "durations")
    plan = day.folder / "durations"
    for path in plan.iterdir():
        if path.suffix in (".csv", ".txt"):
            said += path.read_text("utf-8")
    page = re.sub(r'src="data:[^"]*"', "", (plan / "plan.html").read_text("utf-8"))
    assert "which of two durations is the longer" in page
    lists = plan / "trials.csv"
    _answered(lists, lambda row: _longer(float(row["stimulus_1_ms"]), float(row["stimulus_2_ms"])),
              "choice")  # fmt: skip
    found = day.types(f"{user}: its analysis", "weberwhisk", "analyse", str(plan / "plan.json"),
                      str(lists), "--out", "analysed")  # fmt: skip
    # As few trials as the short play has can say either.
    winners = "Weber's law|exponent 0.5" if "10" in options else "Weber's law"
    assert re.search(f"Best: ({winners}), by a Bayes factor of", found), found
    assert "not the preregistered verdict" not in found
    placed = day.types(f"{user}: trial by trial", "weberwhisk", "next", "--magnitude", "duration",
                       "--unit", "ms", "--standards", "300,600", "--most", "30", "--log",
                       "p1.jsonl", stdin="1\n0\n1\n" * 10)  # fmt: skip
    first, *_, last = map(json.loads, placed.splitlines())
    assert "comparison_ms" in first
    again = day.types(f"{user}: trial by trial", *shlex.split(last["repeat"]), "--json")
    k = json.loads(again)["weber_fraction"]
    assert math.isclose(k, last["weber_fraction"], rel_tol=0.03), (k, last)
    of_log = day.types(f"{user}: trial by trial", "weberwhisk", "analyse", str(plan / "plan.json"),
                       "p1.jsonl")  # fmt: skip
    assert "not the preregistered verdict" in of_log
    for text in (said, page, found, placed, again, of_log):
        assert not WHISKERS.search(text), WHISKERS.findall(text)


def a_rodent_lab(day: Day, *options: str) -> None:
    """Rats that hear levels, go or no-go, with and without a drug."""
    user = "a rodent lab"
    said = day.types(f"{user}: a plan", "weberwhisk", "design", "--magnitude", "sound level",
                     "--unit", "dB", "--standards", "60", "--task", "go/no-go", "--animals", "4",
                     "--conditions", "saline,drug", "--ratio", "1.5", *options, "--out",
                     "levels")  # fmt: skip
    plan = day.folder / "levels"
    assert "4 animals" in said
    text = " ".join((plan / "preregistration.txt").read_text("utf-8").split())
    assert "whether a sound level is louder than the standard held in mind" in text

    def go(row: dict[str, str]) -> float:
        off = float(row["stimulus_2_dB"]) - float(row["standard_dB"])
        return _longer(1.0, 10 ** (off / 20), 0.25 if row["condition"] == "drug" else 0.1)

    _answered(plan / "trials.csv", go, "choice")
    found = day.types(f"{user}: its analysis", "weberwhisk", "analyse", str(plan / "plan.json"),
                      str(plan / "trials.csv"), "--out", "levels_analysed")  # fmt: skip
    assert "the conditions are told apart" in found
    for words in (said, text, found):
        assert not WHISKERS.search(words), WHISKERS.findall(words)


def the_paper(day: Day, *, readings: int = 200) -> None:
    """The paper's claims beside what is found, and JNDs under a noise law of one's own."""
    if readings >= 200:
        printed = day.types("the paper, and an own receptor", "python",
                            str(ROOT / "analyses" / "paper" / "make.py"), "--short",
                            "paper")  # fmt: skip
        assert len(printed.splitlines()) > 10
        assert list((day.folder / "paper").glob("*.png"))
    script = RECEPTOR.replace("READINGS", str(readings))
    table = json.loads(day.types("the paper, and an own receptor", "python", "-c", script))
    apex, scale = 50e-3 / (1 - 1 / 20), 3 * 3.34e9 * math.pi / 4 * (100e-6) ** 4  # of (2.1)
    for distance, found in table["posterior_mm"].items():
        r = 1e-3 * float(distance)
        rate = scale * (1 / r - 1 / apex)
        expected = 1e3 * 1e-4 * r * (1 - r / apex) / math.sqrt(rate)
        assert math.isclose(found, expected, rel_tol=0.02), (found, expected)


def a_tracked_video(day: Day) -> None:
    """From a tracker's points to distances that are the true ones."""
    video = str(DATA / "tracked_session.csv")
    scale = ("--pixels-per-mm", "20", "--frame-rate", "500")
    printed = day.types("a tracked video", "weberwhisk", "locate", video, "--identity", "C2",
                        *scale, "--out", "located")  # fmt: skip
    assert "rows: converged." in printed
    with (DATA / "tracked_session_truth.csv").open(encoding="utf-8") as file:
        truth = {row["frame"]: row for row in csv.DictReader(file)}
    with (day.folder / "located" / "located.csv").open(encoding="utf-8") as file:
        found = [row for row in csv.DictReader(file) if row["radial_distance_mm"]]
    touching = [(row, truth[row["frame"]]) for row in found if row["frame"] in truth]
    inside = [
        float(row["lower_mm"]) <= float(true["radial_distance_mm"]) <= float(row["upper_mm"])
        for row, true in touching
        if true["contact"] == "True"
    ]
    assert len(inside) > 50
    assert sum(inside) >= 0.85 * len(inside)


USERS: tuple[Callable[[Day], None], ...] = (
    own_choices, a_design, an_infeasible_design, durations, a_rodent_lab, the_paper,
    a_tracked_video,
)  # fmt: skip


def fresh_environment(folder: Path) -> Path:
    """The Python of a new environment with this repository in it."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # compiled modules are kept, as for a user
    venv.create(folder / "env", with_pip=True)
    python = folder / "env" / ("Scripts" if os.name == "nt" else "bin") / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", str(ROOT)], check=True)
    return python


def main(folder: Path) -> list[str]:
    """Play all of them; the bars that were missed."""
    day = Day(fresh_environment(folder), folder)
    for plays in USERS:
        plays(day)
    for user, cpu, command in day.typed:
        print(f"{cpu:6.1f} s  {user}: {command}")
    return day.missed()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        work = Path(sys.argv[1])
        work.mkdir(parents=True, exist_ok=True)
        wrong = main(work.resolve())
    else:
        with tempfile.TemporaryDirectory() as made:
            wrong = main(Path(made))
    sys.exit("\n".join(wrong) or 0)
