"""Sweeps: the same work on many chunks, serially, on all cores, or on a cluster; and their threads.

Recovery, power, calibration and surfaces of JNDs are all of one kind: a function of a chunk (what
to do) and a seed (its own) that returns a table. `run` does it for every chunk, and the answer is
the same to the bit whatever does it and in what order.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, as_completed
from contextlib import closing, contextmanager, nullcontext
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from . import checks, output
from .output import Log, shown
from .refusals import Refusal, argument, named
from .values import pd

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

__all__ = ["CampaignError", "all_cores", "run"]

Chunk = dict[str, Any]
Work = Callable[[Chunk, np.random.SeedSequence], "pd.DataFrame"]
Task = tuple[Work, int, Chunk, np.random.SeedSequence, dict[str, str | None]]  # as `_line` takes it
Pool = tuple[Callable[..., Any], Callable[..., Iterator[Any]]]  # submit and as_completed


class CampaignError(RuntimeError):
    """A sweep that could not be finished; what it has done is in its file."""


def run(
    work: Work,
    chunks: Iterable[Chunk],
    *,
    seed: int | np.random.SeedSequence,
    workers: int = 1,
    scheduler: str | None = None,
    out: str | os.PathLike[str] | None = None,
    title: str = "",
    progress: Callable[[float], None] | None = None,
) -> pd.DataFrame:
    """Do the same work on every chunk, and put the tables under one another.

    The result is the same to the bit whatever the workers and their order, and whether or not the
    sweep was interrupted: the seed of a chunk depends on `seed` and its number alone.

    Parameters
    ----------
    work : callable
        ``work(chunk, seed) -> DataFrame``, always of the same columns: a function at the top level
        of a module, or a `functools.partial` of one. With `out`, chunks must name the
        arguments of the partial: the file is compared by chunks alone.
    chunks : iterable of dict
        What may be written as JSON.
    seed : int or SeedSequence
    workers : int
        1: this process. More: so many processes; a script that starts them needs
        ``if __name__ == "__main__":``. In a browser all is done serially.
    scheduler : str, optional
        Address of a `dask.distributed` scheduler such as ``tcp://node1:8786``, whose workers have
        the same weberwhisk, NumPy and SciPy.
    out : path, optional
        A file to stream into, JSON lines. Where it holds part of the same sweep (work, chunks, seed
        and versions), the rest is done.
    title : str
        Shown beside the progress bar.
    progress : callable, optional
        Told how many more chunks are done. By default a bar with the time left, on standard error
        where that is a terminal, and a plain line every 15 s where it is not.

    Returns
    -------
    DataFrame
        Rows in the order of the chunks.

    Raises
    ------
    ValueError
        For what cannot be asked, a file of another sweep, or a cluster that cannot be reached.
    CampaignError
        When a chunk raises an exception, naming the chunk, or workers are lost.

    Examples
    --------
    `weberwhisk.power` gives some hundred experiments of one size to each chunk:

    >>> from functools import partial
    >>> from weberwhisk import Whisker
    >>> from weberwhisk.design import Evidence, Scheme, SubjectPopulation, taper
    >>> from weberwhisk.design.simulation import experiments
    >>> work = partial(experiments, scheme=Scheme([15e-3], [-2e-3, 2e-3]), goal=Evidence(10),
    ...                hypotheses=taper(Whisker(50e-3, 1e-4, 5e-6)), animals=SubjectPopulation())
    >>> chunks = [{"truth": "tapered", "trials": n, "animals": 1, "runs": 2} for n in (5, 10)]
    >>> run(work, chunks, seed=1)["trials"].tolist()
    [5, 5, 10, 10]
    """
    # Nothing is sent anywhere: what the function is given need not be picklable.
    is_here = out is None and workers == 1 and scheduler is None
    name = _name(getattr(work, "func", work) if is_here else work)
    plain = [_plain(number, chunk) for number, chunk in enumerate(chunks)]
    if not plain:
        raise Refusal("there are no chunks", remedy="give one dict or more")
    root = _root(seed)
    checks.whole("workers", workers, "write 2")
    if workers > 1 and in_browser():
        warnings.warn("a browser has no processes: the chunks are done serially.", stacklevel=2)
        workers = 1
    if scheduler is not None and workers != 1:
        raise Refusal(
            "a cluster has its own workers",
            argument("workers", workers) + " with a scheduler",
            "leave one out",
        )
    versions = output.versions("numpy", "scipy")  # what the bits of a result depend on
    question = {
        "work": name, "chunks": plain, "versions": versions,
        "seed": {"entropy": np.asarray(root.entropy, dtype=object).tolist(),
                 "spawn_key": root.spawn_key},
    }  # fmt: skip
    with nullcontext() if out is None else Log(out, "sweep", question) as log:
        lines = _by_number(log.lines if log else [], len(plain))
        tasks = [
            (work, number, chunk, own, versions)
            for number, (chunk, own) in enumerate(zip(plain, root.spawn(len(plain)), strict=True))
            if number not in lines
        ]
        if progress and tasks and lines:
            progress(len(lines))
        bar = shown(title or "Sweep", len(plain), done=len(lines))
        with nullcontext(progress) if progress else bar as advance:
            try:
                with closing(_done(tasks, workers, scheduler)) as done:
                    for number, line in done:
                        if log:
                            log.append(line)
                        lines[number] = line
                        advance(1)
            except CampaignError as error:
                if log:
                    kept = f"{len(lines)} chunks are done and kept in {str(log.path)!r}."
                    error.args = (f"{error} {kept}",)
                raise
    return _decoded(lines)


def all_cores(workers: int | None, scheduler: str | None) -> int:
    """As many workers as requested; by default one a core, or those of the cluster.

    Examples
    --------
    >>> all_cores(3, None), all_cores(None, "tcp://node1:8786")
    (3, 1)
    """
    if workers is not None:
        return workers
    return core_count() if scheduler is None else 1


# -- one chunk -----------------------------------------------------------------------------------


def _name(work: Work) -> str:
    """Module and name of the work, or of the function of a partial."""
    own = getattr(work, "func", work)
    try:
        pickle.dumps(work)  # as a worker gets it
        return f"{own.__module__}:{own.__qualname__}"
    except (pickle.PicklingError, AttributeError, TypeError):
        raise Refusal(
            "work must be a function at the top level of a module",
            f"{work!r}",
            "move it there, and what it needs to know into the chunks",
        ) from None


def _plain(number: int, chunk: Chunk) -> Chunk:
    """A chunk as JSON has it, so that a resumed sweep works on the very same one."""
    try:
        if not isinstance(chunk, dict):
            raise TypeError
        return dict(json.loads(json.dumps(chunk, allow_nan=False)))
    except (TypeError, ValueError):
        raise Refusal(
            f"chunk {number} must be a dict of plain finite numbers, text, lists and dicts",
            f"{chunk!r}",
            "write arrays as lists",
        ) from None


def _root(seed: int | np.random.SeedSequence) -> np.random.SeedSequence:
    """The root of the chunks' seeds, which has no children yet."""
    if isinstance(seed, np.random.SeedSequence):
        return np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key)
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise Refusal(
            named("seed") + " must be a whole number or a SeedSequence",
            f"{seed!r}",
            "a sweep that is resumed must find the same seeds again: write 1, say",
        )
    return np.random.SeedSequence(int(seed))


def _line(
    work: Work, number: int, chunk: Chunk, seed: np.random.SeedSequence, wanted: dict[str, Any]
) -> str:
    """The table of a chunk as one line of JSON, every number to its last bit."""
    versions = output.versions("numpy", "scipy")
    if versions != wanted:
        raise CampaignError(f"a worker has {versions}, not {wanted}.")
    try:
        with limited_blas():
            table = work(dict(chunk), seed)
        return json.dumps({"chunk": number, "rows": len(table), "columns": _encoded(table)})
    except Exception as error:
        text = f"{chunk}" if len(f"{chunk}") <= 300 else f"{str(chunk)[:300]}…"
        wrong = CampaignError(f"chunk {number} {text} failed: {type(error).__name__}: {error}.")
        wrong.add_note("".join(traceback.format_exception(error)))
        raise wrong from None


def _encoded(table: pd.DataFrame) -> dict[Any, tuple[str, list[Any]]]:
    """Type and values of each column by its name."""
    if not isinstance(table, pd.DataFrame):
        raise TypeError(f"work must return a DataFrame, got {type(table).__name__}")
    if not table.columns.is_unique or not all(isinstance(name, str) for name in table):
        raise TypeError(f"work must return columns with different names, got {[*table]}")
    columns = {}
    for name, column in table.items():
        if isinstance(column.dtype, np.dtype) and column.dtype.kind in "biuf":
            columns[name] = column.dtype.name, column.tolist()
            continue
        text = column.astype(object).where(column.notna(), None).tolist()
        if not all(value is None or isinstance(value, str) for value in text):
            raise TypeError(
                f"work must return numbers, booleans or text, got a column {name!r} of "
                f"{column.dtype}"
            )
        columns[name] = "text", text
    return columns


def _by_number(lines: Sequence[str], count: int) -> dict[int, str]:
    """Lines of chunks by their number."""
    found = {int(json.loads(line)["chunk"]): line for line in lines}
    if found and max(found) >= count:
        raise Refusal(
            f"the file has a line for chunk {max(found)} of {count}: it was changed by hand",
            remedy="name another file, or remove this one",
        )
    return found


def _decoded(lines: dict[int, str]) -> pd.DataFrame:
    """The tables of all chunks in one, in the order of the chunks."""
    tables = [json.loads(line) for _, line in sorted(lines.items())]
    tables = [table for table in tables if table["rows"]] or tables[:1]
    if len({tuple(table["columns"]) for table in tables}) > 1:
        raise Refusal(
            "chunks returned different columns", remedy="let work return the same ones always"
        )
    columns: dict[str, Any] = {}
    for name in tables[0]["columns"]:
        parts = [table["columns"][name] for table in tables]
        if any(kind == "text" for kind, _ in parts):
            columns[name] = [value for _, values in parts for value in values]
        else:
            columns[name] = np.concatenate([np.array(values, kind) for kind, values in parts])
    return pd.DataFrame(columns)


# -- who does them -------------------------------------------------------------------------------


def _done(
    tasks: Sequence[Task], workers: int, scheduler: str | None
) -> Generator[tuple[int, str], None, None]:
    """Number and line of each chunk, as they are done."""
    if scheduler is None and (workers == 1 or len(tasks) < 2):
        for task in tasks:
            yield task[1], _line(*task)
        return
    pool = _processes(min(workers, len(tasks))) if scheduler is None else _cluster(scheduler)
    with pool as (submit, completed):
        numbers = {submit(_line, *task): task[1] for task in tasks}
        for future in completed(numbers):
            yield numbers[future], future.result()


@contextmanager
def _processes(workers: int) -> Iterator[Pool]:
    """Processes of this machine, which end however this ends."""
    from concurrent.futures import ProcessPoolExecutor  # a browser's Python lacks it

    # A fresh interpreter: a copy of this one would have its threads' locks, held for ever.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin)
    try:
        yield pool.submit, as_completed
    except BrokenExecutor:
        raise CampaignError(
            "a worker process was killed, as want of memory does, or could not start; a script "
            'that starts workers needs `if __name__ == "__main__":`.'
        ) from None
    finally:
        processes = list((getattr(pool, "_processes", None) or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


def _begin() -> None:
    """Leave an interrupt to the parent process, and end when it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def _cluster(address: str) -> Iterator[Pool]:
    """The workers of a dask scheduler."""
    try:
        import distributed
    except ImportError:
        raise Refusal(
            "a scheduler needs dask.distributed, which is not installed",
            remedy="write pip install 'weberwhisk[cluster]'",
        ) from None
    try:
        client = distributed.Client(address, set_as_default=False)
    except (OSError, ValueError) as error:
        raise Refusal(
            f"no scheduler could be reached at {address!r} ({type(error).__name__})",
            remedy="start one with `dask scheduler`, and give the address that it prints",
        ) from error
    try:
        with client, client.as_current():
            yield partial(client.submit, pure=False, retries=0), distributed.as_completed
    except distributed.KilledWorker as error:
        raise CampaignError(f"a chunk has killed its workers: {error}") from None
    except (OSError, CancelledError):
        raise CampaignError("the cluster was lost: the scheduler does not answer.") from None


# -- cores and threads ---------------------------------------------------------------------------


def in_browser() -> bool:
    """Whether this is Python in WebAssembly (Pyodide), which has neither threads nor processes."""
    return sys.platform == "emscripten"


def core_count() -> int:
    """Cores that this process may run on, which may be fewer than the machine has."""
    if in_browser():
        return 1
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra."""
    import scipy.linalg  # noqa: F401  # its library must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_lock = threading.Lock()
_holders: list[Any] = []  # the limit, once for each thread within it


@contextmanager
def limited_blas() -> Iterator[None]:
    """Let linear algebra use one thread: more would add in another order.

    The limit is the whole process's: it ends when the last thread that needs it leaves.
    """
    if in_browser():
        yield
        return
    with _lock:
        first = not _holders
        _holders.append(_libraries().limit(limits=1, user_api="blas") if first else _holders[0])
    try:
        yield
    finally:
        with _lock:
            limit = _holders.pop()
            if not _holders:
                limit.restore_original_limits()


#: As a decorator: products are many and small, and waking a second thread for each takes longer.
one_blas_thread = limited_blas()
