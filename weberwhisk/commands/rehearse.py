"""`weberwhisk rehearse`: a planned experiment simulated from animals to conclusion."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import weberwhisk as ww

from ..campaign import all_cores
from ..design import plan_json, read_plan
from ..output import Run, atomic_write, to_json
from .options import command, draw, wrote


@command
def rehearse(
    file: Annotated[Path, "plan.json, as `weberwhisk design` writes it.", {"metavar": "PLAN"}],
    runs: Annotated[int, "Experiments simulated under each hypothesis."] = 100,
    workers: int | None = None,
    scheduler: str | None = None,
    seed: int = 1,
    out: Path | None = None,
    as_json: bool = False,
) -> None:
    """Simulate a planned experiment, fit it as planned, and count how often it ends right.

    With --out a study that was broken off goes on where it was when the command is given again.
    """
    if not file.is_file():
        raise ValueError(
            f"{str(file)!r} is not a file; name the plan.json that `weberwhisk design` wrote."
        )
    plan = read_plan(file)
    inputs = {"plan": str(file), "trials_sha256": plan.fingerprint, "runs": runs}
    with Run(out, "rehearse", inputs, seed) as run:
        stream = None if run.out_dir is None else _stream(run.out_dir, plan, runs, seed)
        found = ww.simulate_study(
            plan,
            runs,
            seed=seed,
            workers=all_cores(workers, scheduler),
            scheduler=scheduler,
            out=stream,
            progress=(lambda done: None) if as_json else None,
        )
        summary = found.summary().reset_index()
        run.table("rehearsal", found.table)
        run.table("rehearsal_summary", summary)
        if run.out_dir is not None:
            atomic_write(run.path("rehearsal.txt"), found.report())
            draw(run, "rehearsal", ww.figures.rehearsed(found))
    if stream is not None:
        stream.unlink(missing_ok=True)  # what it held is in rehearsal.csv now
    if as_json:
        print(to_json({"goal": str(plan.goal), "rows": summary.to_dict("records")}))
        return
    print(found.report(), end="")
    wrote(run)


def _stream(folder: Path, plan: Any, runs: int, seed: int) -> Path:
    """Where the runs are kept while they come: a name for each question, to go on with."""
    question = f"{plan_json(plan)} {runs} {seed}".encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"The output folder {str(folder)!r} cannot be made ({error.strerror}); name a folder "
            "that you may write to."
        ) from error
    return folder / f"rehearsal-{hashlib.sha256(question).hexdigest()[:8]}.jsonl"
