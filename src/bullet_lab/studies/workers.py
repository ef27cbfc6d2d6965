"""Tasks of a study on the processes of this machine, or on whatever a Dask scheduler has."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import signal
import threading
from collections import Counter
from concurrent.futures import CancelledError
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing import connection, get_context, parent_process, resource_tracker
from typing import Any, Callable, Dict, Iterable, Iterator, Sequence, Tuple

import cv2

from bullet_lab.core.parameters import checked, choice, integer
from bullet_lab.simulation.rendering.graphics import AUTO, CHOICES, check_choice
from bullet_lab.studies.study import Settings, UnfinishedError

SECONDS_FOR_SCHEDULER = 10.0
SECONDS_FOR_WORKERS = 30.0
LIVES = 2
"""How many processes a task may cost before it is suspected."""

MOST_WORKERS = 1024

_SPAWN = get_context("spawn")
_LOST = "every worker that tried it has died"

Task = Callable[[int], Any]
Results = Iterator[Tuple[int, Any]]
Run = Callable[[Task, Sequence[int]], Iterable[Tuple[int, Any]]]
"""Has a task done for each of some numbers; yields numbers and results as they come.

The result of one that was given up is a TaskLostError, not raised.
"""


class WorkersError(UnfinishedError):
    """There is nobody to do the work."""


class TaskLostError(UnfinishedError):
    """A task has cost every process that tried it its life."""


@dataclass(frozen=True)
class WorkerSettings(Settings):
    """Who does the work."""

    workers: int = integer(0, "processes; 0: one for each core", 0, MOST_WORKERS)
    renderer: str = choice(AUTO, "passed over: Panda3D draws all pictures", CHOICES)

    def __post_init__(self) -> None:  # noqa: D105 - inherited
        super().__post_init__()
        check_choice(self.renderer)


def _address(value: Any) -> str:
    # Of other words, Dask makes host names, and much noise.
    if value and not re.fullmatch(r"\w+://\S+:\d+", value, re.ASCII):
        raise ValueError
    return value


@dataclass(frozen=True)
class ClusterSettings(WorkerSettings):
    """Who does the work, here or elsewhere."""

    scheduler: str = checked(
        "", "Dask scheduler to use instead", "an address such as tcp://host:8786", _address
    )


def this_process(task: Task, numbers: Sequence[int]) -> Results:
    """Do the tasks here, one after the other: the simplest `Run`."""
    return ((number, task(number)) for number in numbers)


def workers(count: int = 0, scheduler: str = "") -> Run:
    """Return what runs tasks.

    A task whose process dies is tried again by another one, and at last alone, since it may have
    been another's fault. What is returned raises WorkersError where the tasks cannot be run at
    all, or nobody is left to run them.

    Args:
        count: processes of this machine; 0 for one per core. They share nothing, and end with
            this one, however it ends.
        scheduler: address such as tcp://host:8786 of a Dask cluster that does it instead.
    """
    run_round = partial(_on_dask, scheduler) if scheduler else partial(_on_processes, count)

    def run(task: Task, numbers: Sequence[int]) -> Results:
        suspects = []
        for number, result in run_round(task, numbers):
            if isinstance(result, TaskLostError):
                suspects.append(number)
            else:
                yield number, result
        for number in suspects:
            yield from run_round(task, [number])

    return run


def _on_processes(count: int, task: Task, numbers: Sequence[int]) -> Results:
    # A process has one core: no library in it shall start a thread for each.
    for library in ("MKL", "OMP", "OPENBLAS"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    most = count or len(os.sched_getaffinity(0))
    left, deaths = list(reversed(numbers)), Counter()
    busy: Dict[Any, _Worker] = {}
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
                    raise WorkersError(f"the workers cannot do it: {value}")
                yield number, value
    finally:
        for worker in busy.values():
            worker.end()


class _Worker:
    """A process that does tasks, one at a time."""

    def __init__(self, task: Task):
        self.pipe, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_work, args=(task, theirs), daemon=True)
        # It passes over Ctrl-C from the first moment on: this process ends it. The tracker, which
        # is started with the first process, would let it through again.
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        theirs.close()

    def give(self, number: int) -> None:
        """Have a task done."""
        self.number = number
        # Where the process has died, `result` says so.
        with contextlib.suppress(OSError):
            self.pipe.send(number)

    def result(self) -> Any:
        """Return what `_work` sends of the task, or None where the process has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def end(self) -> None:
        """End the process, in the middle of a task or not."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _work(task: Task, pipe: connection.Connection) -> None:
    """Do tasks as their numbers come: send each result with True, or False and what is wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)
    with contextlib.suppress(EOFError):
        while True:
            number = pipe.recv()
            try:
                pipe.send((True, task(number)))
            except Exception as error:  # whatever a task raises, or a result that does not travel
                pipe.send((False, f"{type(error).__name__}: {error}"))


def _end_with_parent() -> None:
    parent: Any = parent_process()
    parent.join()
    os._exit(1)


_TURN = threading.Lock()


def _in_turn(task: Task, number: int) -> Any:
    """Do a task while this process does no other: neither simulation nor pictures share one."""
    with _TURN:
        cv2.setNumThreads(1)
        return task(number)


def _on_dask(scheduler: str, task: Task, numbers: Sequence[int]) -> Results:
    """Keep each thread of a cluster busy with one task, until all are done."""
    from distributed import as_completed

    left = iter(numbers)
    number_of: Dict[str, int] = {}
    with _dask_client(scheduler) as client:
        waiting = as_completed(loop=client.loop)
        while True:
            free = _threads(client) - len(number_of)
            for number in islice(left, max(free, 0 if number_of else 1)):
                # Not pure: what the scheduler knows of another study is of no use to this one.
                future = client.submit(_in_turn, task, number, pure=False)
                number_of[future.key] = number
                waiting.add(future)
            if not number_of:
                return
            future = next(waiting)
            yield number_of.pop(future.key), _future_result(future)
            future.release()


@contextlib.contextmanager
def _dask_client(scheduler: str) -> Iterator[Any]:
    from distributed import Client, TimeoutError

    # What matters is raised.
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=SECONDS_FOR_SCHEDULER, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        raise WorkersError(f"no Dask scheduler answers at {scheduler}") from None
    with contextlib.closing(client):
        try:
            client.wait_for_workers(1, timeout=SECONDS_FOR_WORKERS)
        except TimeoutError:
            raise WorkersError(f"the Dask scheduler at {scheduler} has no workers") from None
        yield client


def _threads(client: Any) -> int:
    from distributed import TimeoutError

    try:
        return sum(client.nthreads().values())
    except (OSError, TimeoutError, CancelledError):
        raise WorkersError("the Dask scheduler is gone") from None


def _future_result(future: Any) -> Any:
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return TaskLostError(_LOST)
    except CancelledError:
        raise WorkersError("the Dask scheduler is gone") from None
    except Exception as error:  # whatever a worker without the right libraries raises
        kind = type(error).__name__
        raise WorkersError(f"the workers cannot do it: {kind}: {error}") from error
