"""Tasks of a study on processes of this machine."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import threading
from collections import Counter
from dataclasses import dataclass
from functools import partial
from multiprocessing import connection, get_context, parent_process, resource_tracker
from typing import Any, Callable, Iterable, Iterator, Sequence, Tuple

import cv2

from bullet_lab.core.parameters import integer
from bullet_lab.errors import LabError
from bullet_lab.studies.study import Settings, Tell, UnfinishedError, progress

# Number of processes that may die on a task; another task may have been the cause.
LIVES = 3
MOST_WORKERS = 1024

_SPAWN = get_context("spawn")
_LOST = "each worker process that ran the task has died"

Task = Callable[[int], Any]
Results = Iterator[Tuple[int, Any]]
Run = Callable[[Task, Sequence[int]], Iterable[Tuple[int, Any]]]
"""Runs a task for each of some numbers; yields numbers and results in the order of completion.

If every process that ran the task has died, the result is a TaskLostError, which is not raised.
"""


class TaskLostError(UnfinishedError):
    """Every process that ran a task has died."""


@dataclass(frozen=True)
class WorkerSettings(Settings):
    """Number of processes on this machine."""

    workers: int = integer(0, "processes; 0: one for each core", 0, MOST_WORKERS)


def this_process(task: Task, numbers: Sequence[int]) -> Results:
    """Run the tasks here, one after the other: the simplest `Run`."""
    return ((number, task(number)) for number in numbers)


def run_tasks(task: Task, count: int, run: Run, tell: Tell, things: str) -> list[Any]:
    """Run a task for the numbers from 0 on and return the results in this order.

    Args:
        task: to run; its argument is a number.
        count: how many numbers.
        run: runs the tasks.
        tell: prints a line.
        things: name of the tasks.

    Raises:
        TaskLostError: every process that ran one of the tasks has died.
    """
    results: dict[int, Any] = {}
    for number, result in progress(run(task, range(count)), things, count, tell):
        if isinstance(result, TaskLostError):
            raise TaskLostError(f"number {number} of {things}: {result}")
        results[number] = result
    return [results[number] for number in range(count)]


def workers(count: int = 0) -> Run:
    """Return a function that runs tasks on processes of this machine.

    If a process dies, another one runs its task again. The function raises UnfinishedError if the
    tasks cannot be run. The processes share nothing, and end with this one, however it ends.

    Args:
        count: of processes; 0 for one per core.
    """
    return partial(_on_processes, count)


def _on_processes(count: int, task: Task, numbers: Sequence[int]) -> Results:
    # Each process uses one core: its libraries must not start a thread per core.
    for library in ("MKL", "OMP", "OPENBLAS"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    most = count or len(os.sched_getaffinity(0))
    left, deaths = list(reversed(numbers)), Counter()
    busy: dict[Any, _Worker] = {}
    try:
        while left or busy:
            while left and len(busy) < most:
                worker = _Worker(task)
                busy[worker.pipe] = worker
                worker.give(left.pop())
            for pipe in connection.wait(list(busy)):
                number, found = busy[pipe].number, busy[pipe].result()
                if found is not None and left:
                    busy[pipe].give(left.pop())
                else:
                    busy.pop(pipe).end()
                if found is None:
                    deaths[number] += 1
                    if deaths[number] < LIVES:
                        left.append(number)
                        continue
                    found = True, TaskLostError(_LOST)
                done, value = found
                if not done:
                    raise UnfinishedError(value)
                yield number, value
    finally:
        for worker in busy.values():
            worker.end()


class _Worker:
    """A process that runs tasks, one at a time."""

    def __init__(self, task: Task):
        self.pipe, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_work, args=(task, theirs), daemon=True)
        # It ignores Ctrl-C from its start on: this process ends it. The resource tracker, which
        # starts with the first process, would unblock the signal.
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        theirs.close()

    def give(self, number: int) -> None:
        """Send the number of a task."""
        self.number = number
        # If the process has died, `result` returns None.
        with contextlib.suppress(OSError):
            self.pipe.send(number)

    def result(self) -> Any:
        """Return what `_work` sends, or None if the process has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def end(self) -> None:
        """Kill the process, even while it runs a task."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _work(task: Task, pipe: connection.Connection) -> None:
    """Run the tasks of the numbers that arrive; send (True, result) or (False, error)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    # Each process would repeat them.
    logging.disable(logging.WARNING)
    with contextlib.suppress(EOFError):
        while True:
            number = pipe.recv()
            try:
                pipe.send((True, task(number)))
            except Exception as error:  # of the task, or of a result that cannot be pickled
                pipe.send((False, _reason(error)))


def _reason(error: Exception) -> str:
    """Return why a task failed, in one line."""
    if isinstance(error, LabError):
        return str(error)
    return f"a worker process failed: {type(error).__name__}: {error}"


def _end_with_parent() -> None:
    parent: Any = parent_process()
    parent.join()
    os._exit(1)
