"""Who does the chunks: this process, or workers of its own. A cluster has a module to itself.

A crew takes chunks from the left of a queue, as many as it has room for, and reports what became of
them. A chunk that may have killed its worker is done alone, so that there is no doubt the next
time.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections import Counter, deque
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Protocol

from .job import Job, Report

MOST_DEATHS = 3  # of workers, before their chunk is given up
AHEAD = 0.75  # seconds of work that a worker holds, so that it need not wait for more
EVERY = 0.25  # seconds between two reports, where chunks are short
LEAST = 0.1  # seconds of work that are not shared out any further at the end
MOST = 1000  # chunks that a worker may hold
UNKNOWN = float("inf")  # seconds that a chunk takes, before one is done


class Crew(Protocol):
    """Whatever does chunks."""

    @property
    def busy(self) -> bool:
        """Whether there is anything to wait for."""

    def give(self, queue: deque[int], alone: set[int]) -> None:
        """Take from the left of the queue what there is room for; some only alone."""

    def take(self) -> Report:
        """Wait for news."""

    def close(self) -> None:
        """Stop, whatever is being done."""


def portion(queue: deque[int], alone: set[int], most: int) -> list[int]:
    """Chunks for one worker with nothing in hand: up to `most`, or one that is to be alone."""
    taken: list[int] = []
    while queue and len(taken) < most and not (taken and queue[0] in alone):
        taken.append(queue.popleft())
        if taken[-1] in alone:
            break
    return taken


def within(seconds: float, each: float) -> int:
    """How many chunks take so long, at so many seconds each; one at least."""
    return max(1, min(int(seconds / max(each, 1e-6)), MOST))


def fair(waiting: int, takers: int, seconds: float, each: float) -> int:
    """How many of the chunks that wait one of several should take: so long, and less at the end."""
    share = -(-waiting // (2 * takers))
    return min(within(seconds, each), max(share, within(LEAST, each)))


def one_thread() -> None:
    """Leave linear algebra one thread: others would add in another order, and fight for cores."""
    import scipy.linalg  # noqa: F401  # its library must be there to be told
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


class Serial:
    """This process, some chunks at a time."""

    def __init__(self, job: Job) -> None:
        import scipy.linalg  # noqa: F401
        from threadpoolctl import threadpool_limits

        self._job = job
        self._held: list[int] = []
        self._each = UNKNOWN
        self._threads = threadpool_limits(1)

    @property
    def busy(self) -> bool:
        return bool(self._held)

    def give(self, queue: deque[int], alone: set[int]) -> None:
        if not self._held:
            self._held = portion(queue, alone, within(EVERY, self._each))

    def take(self) -> Report:
        numbers, self._held = self._held, []
        report = self._job.do(numbers, EVERY)
        self._each = report.each
        return report

    def close(self) -> None:
        self._threads.restore_original_limits()


class Processes:
    """Processes of this machine, each replaced when it dies."""

    def __init__(self, job: Job, workers: int) -> None:
        self._job = job
        self._deaths: Counter[int] = Counter()
        self._still_born = 0
        self._hands = [_Hand(job) for _ in range(workers)]

    @property
    def busy(self) -> bool:
        return any(hand.held for hand in self._hands)

    def give(self, queue: deque[int], alone: set[int]) -> None:
        for hand in self._hands:
            if not queue:
                return
            if not hand.ready or (hand.held and alone & {*hand.held, queue[0]}):
                continue
            most = fair(len(queue), len(self._hands), AHEAD, hand.each)
            hand.give(portion(queue, alone, most - len(hand.held)))

    def take(self) -> Report:
        """News of one worker; an empty report where it has just begun."""
        ready = wait([hand.connection for hand in self._hands])
        hand = next(hand for hand in self._hands if hand.connection is ready[0])
        try:
            return hand.hear()
        except (EOFError, OSError):
            return self._replace(hand)

    def _replace(self, hand: _Hand) -> Report:
        hand.process.join(1.0)  # it is about to end, and how is worth knowing
        hand.end()
        self._still_born = 0 if hand.ready else self._still_born + 1
        if self._still_born >= MOST_DEATHS:
            raise WorkersDieAtBirth(hand.process.exitcode)
        self._hands[self._hands.index(hand)] = _Hand(self._job)
        killed = list(hand.held)
        if len(killed) == 1:
            self._deaths[killed[0]] += 1
            if self._deaths[killed[0]] >= MOST_DEATHS:
                return Report(deadly=killed[0])
        return Report(suspects=killed)

    def close(self) -> None:
        for hand in self._hands:
            hand.end()


class WorkersDieAtBirth(Exception):
    """No worker lives long enough to be given anything."""


class _Hand:
    """One worker process, and the chunks that it has."""

    def __init__(self, job: Job) -> None:
        # A fresh interpreter: a copy of this one would have its threads' locks, held for ever.
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(theirs, job), daemon=True)
        self.process.start()
        theirs.close()  # so that its end is the end of the connection
        self.ready = False
        self.held: dict[int, None] = {}
        self.each = UNKNOWN

    def give(self, numbers: list[int]) -> None:
        if not numbers:
            return
        self.held |= dict.fromkeys(numbers)
        with suppress(OSError):  # dead: the next `take` finds out
            self.connection.send(numbers)

    def hear(self) -> Report:
        report: Report = self.connection.recv()
        self.ready = True
        for number in (*report.ended, *report.back):
            del self.held[number]
        if report.ended:
            self.each = report.each
        return report

    def end(self) -> None:
        self.connection.close()
        self.process.terminate()
        self.process.join()


def _serve(connection: Connection, job: Job) -> None:
    """A worker's life: chunks by number in, reports out, until nobody is there."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asked decides what an interrupt means
    one_thread()
    with suppress(EOFError, OSError):
        connection.send(Report())
        numbers: list[int] = []
        each = UNKNOWN
        while True:
            while not numbers or connection.poll():
                numbers += connection.recv()
            most = within(EVERY, each)
            report = job.do(numbers[:most], EVERY)
            numbers, report.back = report.back + numbers[most:], []
            if report.failure:
                numbers, report.back = [], numbers
            each = report.each
            connection.send(report)
