"""Sweeps: the same bits whoever computes them, nothing lost, nothing twice."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import campaign_work
import numpy as np
import pandas as pd
import pytest

from weberwhisk._util.campaign import CampaignError, run
from weberwhisk._util.output import Log

HERE = Path(__file__).parents[1]
CHUNKS = [{"i": i, "rows": i % 4} for i in range(23)]


def same(a: pd.DataFrame, b: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(a, b, check_exact=True)
    for name in a:  # bits: zeros have signs, NaN equals itself
        if a[name].dtype.kind == "f":
            assert a[name].to_numpy().tobytes() == b[name].to_numpy().tobytes()


def done(log: Path) -> Counter[int]:
    return Counter(map(int, log.read_text().split())) if log.exists() else Counter()


def logged(tmp_path: Path, n: int = 23, **more: Any) -> list[dict[str, Any]]:
    return [{"i": i, "log": str(tmp_path / "log"), **more} for i in range(n)]


# -- the answer ----------------------------------------------------------------------------------


def test_is_what_a_plain_loop_gives() -> None:
    children = np.random.SeedSequence(7).spawn(len(CHUNKS))
    frames = [campaign_work.draw(c, s) for c, s in zip(CHUNKS, children, strict=True)]
    plain = pd.concat([f for f in frames if len(f)], ignore_index=True)
    same(run(campaign_work.draw, CHUNKS, seed=7), plain)
    same(run(campaign_work.draw, CHUNKS, seed=np.random.SeedSequence(7)), plain)


def test_the_same_bits_from_any_number_of_workers(tmp_path: Path) -> None:
    alone = run(campaign_work.draw, CHUNKS, seed=7)
    same(run(campaign_work.draw, CHUNKS, seed=7, workers=2, out=tmp_path / "s"), alone)
    same(run(campaign_work.draw, CHUNKS, seed=7, out=tmp_path / "s"), alone)


def test_a_part_of_the_sweep_has_the_seeds_of_its_root() -> None:
    """Children of the same root differ from the root's own, and from each other's."""
    a, b = np.random.SeedSequence(7).spawn(2)
    tables = [run(campaign_work.draw, CHUNKS[:3], seed=s) for s in (7, a, b)]
    assert len({t["x"][0] for t in tables}) == 3


def test_linear_algebra_has_one_thread_everywhere() -> None:
    """In an interpreter that may use more, serial and parallel sums agree to the last bit."""
    code = (
        f"import sys; sys.path.insert(0, {str(HERE)!r})\n"
        "import campaign_work\n"
        "from weberwhisk._util.campaign import run\n"
        "if __name__ == '__main__':\n"
        "    chunks = [{'n': 3}, {'n': 40}]\n"
        "    for workers in (1, 2):\n"
        "        t = run(campaign_work.matrices, chunks, seed=1, workers=workers)\n"
        "        print(t['sum'].to_numpy().tobytes().hex())\n"
    )
    environment = {k: v for k, v in os.environ.items() if "THREADS" not in k}
    environment["OMP_NUM_THREADS"] = "2"
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
    )
    serial, parallel = ended.stdout.split()
    assert serial == parallel


def test_progress_counts_every_chunk_once(tmp_path: Path) -> None:
    told: list[float] = []
    run(campaign_work.draw, CHUNKS, seed=7, out=tmp_path / "s", progress=told.append)
    assert sum(told) == len(CHUNKS)
    again: list[float] = []
    run(campaign_work.draw, CHUNKS, seed=7, out=tmp_path / "s", progress=again.append)
    assert again == []


def test_a_worker_that_is_killed_ends_the_sweep_and_what_is_done_is_kept(tmp_path: Path) -> None:
    out = tmp_path / "s"
    with pytest.raises(CampaignError, match=r"a worker process was killed.* are done and kept in"):
        run(campaign_work.kill_always, logged(tmp_path, 9), seed=7, workers=2, out=out)
    assert 5 not in {json.loads(line)["chunk"] for line in out.read_bytes().splitlines()[1:]}


# -- interruptions -------------------------------------------------------------------------------


def cut(path: Path, lines: int, more: bytes = b"") -> None:
    """Leave so many lines of a file."""
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:lines]) + more)


def test_goes_on_where_it_was(tmp_path: Path) -> None:
    out, chunks = tmp_path / "s", logged(tmp_path)
    whole = run(campaign_work.draw, chunks, seed=7, out=out)
    full = out.read_bytes()
    for lines, more in ((11, b""), (11, b'{"chunk": 10, "ro'), (1, b"\0\0\n"), (0, b"")):
        cut(out, lines, more)
        same(run(campaign_work.draw, chunks, seed=7, out=out), whole)
        assert sorted(out.read_bytes().splitlines()[1:]) == sorted(full.splitlines()[1:])
    # Once, and once more each time that it was missing.
    assert done(tmp_path / "log") == {i: 3 if i < 10 else 5 for i in range(23)}


def test_killed_outright_and_resumed(tmp_path: Path) -> None:
    """kill -9 of the process with its two workers: no chunk in the file is computed again."""
    out, log = tmp_path / "s", tmp_path / "log"
    chunks = logged(tmp_path, 24, seconds=0.03)
    code = (
        "import json, sys; sys.path.insert(0, sys.argv[1])\n"
        "import campaign_work\n"
        "from weberwhisk._util.campaign import run\n"
        "if __name__ == '__main__':\n"
        "    run(campaign_work.draw, json.loads(sys.argv[3]), seed=7, workers=2, out=sys.argv[2])\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    process = subprocess.Popen(
        [sys.executable, str(script), str(HERE), str(out), json.dumps(chunks)],
        stderr=subprocess.PIPE,
    )
    while not out.exists() or out.read_bytes().count(b"\n") < 1 + 3:
        assert process.poll() is None, process.stderr.read() if process.stderr else ""
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()  # its workers hold the other end: they have ended too
    kept = {json.loads(line)["chunk"] for line in out.read_bytes().split(b"\n")[1:-1]}
    assert 3 <= len(kept) < 24
    before = done(log)
    whole = run(campaign_work.draw, chunks, seed=7, out=out)
    same(whole, run(campaign_work.draw, [{"i": i} for i in range(24)], seed=7))
    again = done(log) - before
    assert not kept & set(again)
    assert set(again) == set(range(24)) - kept


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_an_exception_names_its_chunk_and_can_be_mended(tmp_path: Path, workers: int) -> None:
    out, mended = tmp_path / "s", tmp_path / "mended"
    chunks = logged(tmp_path, 9, mended=str(mended))
    with pytest.raises(
        CampaignError, match=r"chunk 4 .* failed: ZeroDivisionError: by nothing"
    ) as e:
        run(campaign_work.stumble, chunks, seed=7, workers=workers, out=out)
    assert "campaign_work.py" in e.value.__notes__[0]
    mended.touch()
    table = run(campaign_work.stumble, chunks, seed=7, workers=workers, out=out)
    assert len(table) == 27
    assert max(done(tmp_path / "log").values()) <= workers  # what others were at is done again


def test_an_interrupt_leaves_no_workers_and_a_good_file(tmp_path: Path) -> None:
    out = tmp_path / "s"

    def interrupt(more: float) -> None:
        if out.exists() and out.read_bytes().count(b"\n") > 4:
            raise KeyboardInterrupt

    before = children()
    with pytest.raises(KeyboardInterrupt):
        run(campaign_work.draw, logged(tmp_path, seconds=0.02), seed=7, workers=2, out=out,
            progress=interrupt)  # fmt: skip
    assert children() == before
    run(campaign_work.draw, logged(tmp_path, seconds=0.02), seed=7, out=out)
    assert set(done(tmp_path / "log")) == set(range(23))


def children() -> set[int]:
    import multiprocessing

    return {p.pid or 0 for p in multiprocessing.active_children()}


# -- what is refused -----------------------------------------------------------------------------


def test_another_question_in_the_same_file_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "s"
    run(campaign_work.draw, CHUNKS[:4], seed=7, out=out)
    content = out.read_bytes()
    for work, chunks, seed, words in (
        (campaign_work.stumble, CHUNKS[:4], 7, "its work is campaign_work:draw"),
        (campaign_work.draw, CHUNKS[:3], 7, "its chunks is [{'i': 0"),
        (campaign_work.draw, CHUNKS[:4], 8, "its seed is {'entropy': 7"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            run(work, chunks, seed=seed, out=out)
    out.write_bytes(
        content.replace(b'"versions": {"weberwhisk": "', b'"versions": {"weberwhisk": "0.')
    )
    with pytest.raises(ValueError, match="its versions is"):
        run(campaign_work.draw, CHUNKS[:4], seed=7, out=out)


@pytest.mark.parametrize(
    "content",
    [b"a,b\n1,2\n", b"no newline", b'{"weberwhisk_campaign": 2}\n', b"{}\n", b"\xff\xfe\n"],
)
def test_other_files_are_left_alone(tmp_path: Path, content: bytes) -> None:
    out = tmp_path / "mine.csv"
    out.write_bytes(content)
    with pytest.raises(ValueError, match="is not the file of a sweep"):
        run(campaign_work.draw, CHUNKS, seed=7, out=out)
    assert out.read_bytes() == content


def test_a_line_changed_by_hand_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "s"
    run(campaign_work.draw, CHUNKS[:4], seed=7, out=out)
    lines = out.read_bytes().splitlines(keepends=True)
    out.write_bytes(b"".join([*lines[:2], lines[2][:-9] + b"\n", *lines[3:]]))
    with pytest.raises(ValueError, match="changed by hand \\(line 3\\)"):
        run(campaign_work.draw, CHUNKS[:4], seed=7, out=out)
    out.write_bytes(b"".join(lines).replace(b'"chunk": 3', b'"chunk": 30'))
    with pytest.raises(ValueError, match="a line for chunk 30 of 4"):
        run(campaign_work.draw, CHUNKS[:4], seed=7, out=out)


def test_two_sweeps_do_not_write_one_file(tmp_path: Path) -> None:
    with (
        Log(tmp_path / "s", "sweep", {}),
        pytest.raises(ValueError, match="is being written by another process"),
    ):
        run(campaign_work.draw, CHUNKS, seed=7, out=tmp_path / "s")
    assert [path.name for path in tmp_path.iterdir()] == ["s"]


def test_bad_input_in_one_sentence(tmp_path: Path) -> None:
    draw: Any = campaign_work.draw

    def nested(chunk: Any, seed: Any) -> Any: ...

    for work, chunks, options, words in (
        (lambda c, s: None, CHUNKS, {}, "work must be a function at the top level"),
        (nested, CHUNKS, {}, "work must be a function at the top level"),
        (draw, [], {}, "there are no chunks"),
        (draw, [{"k": np.ones(2)}], {}, "chunk 0 must be a dict of plain"),
        (draw, [{"k": 1}, {"k": np.nan}], {}, "chunk 1 must be a dict of plain"),
        (draw, [3], {}, "chunk 0 must be a dict"),
        (draw, CHUNKS, {"workers": 0}, "workers must be a whole number"),
        (draw, CHUNKS, {"workers": 2, "scheduler": "tcp://x:1"}, "a cluster has its own workers"),
        (draw, CHUNKS, {"seed": None}, "seed must be a whole number"),
        (draw, CHUNKS, {"seed": -1}, "seed must be a whole number"),
        (draw, CHUNKS, {"out": tmp_path / "no" / "s"}, "cannot be written"),
        (draw, CHUNKS, {"out": tmp_path}, "cannot be written"),
    ):
        with pytest.raises(ValueError, match=words):
            run(work, chunks, **{"seed": 1} | options)
    for what, words in (
        ("list", "must return a DataFrame, got list"),
        ("dates", "got a column 'd' of datetime64"),
        ("number", "different names"),
    ):
        with pytest.raises(CampaignError, match=words):
            run(campaign_work.shapeless, [{"what": what}], seed=1)


def test_workers_that_cannot_start_say_why(tmp_path: Path) -> None:
    """A script without the guard that fresh interpreters need."""
    script = tmp_path / "unguarded.py"
    script.write_text(
        "from weberwhisk._util.campaign import run\n"
        "run(print, [{'i': 0}, {'i': 1}], seed=1, workers=2)\n"  # nobody comes to it
    )
    ended = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert ended.returncode == 1
    assert "could not start" in ended.stderr
    assert 'if __name__ == "__main__":' in ended.stderr
