"""Tasks of a study on the processes of this machine, or on whatever a Dask scheduler has."""

from __future__ import annotations

import contextlib
import functools
import itertools
import logging
import os
import re
import signal
import tempfile
import threading
from concurrent.futures import CancelledError, ThreadPoolExecutor
from typing import Any, Callable, Dict, Iterable, Iterator, Tuple

import cv2
import dask
from distributed import Client, KilledWorker, LocalCluster, TimeoutError, as_completed

from bullet_lab.errors import LabError


def in_own_thread(call: Callable[..., Any], *arguments: Any) -> Any:
    """Call something in the one thread of this process that draws, and return what it returns.

    PyBullet and the graphics library do not like to change threads, and who runs tasks (Dask)
    does not promise to keep to one.
    """
    return _thread().submit(call, *arguments).result()


@functools.lru_cache(maxsize=None)
def _thread() -> ThreadPoolExecutor:
    # Graphics and vision would start a thread for each core; the cores have a process each.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    cv2.setNumThreads(1)
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="drawing")


SECONDS_FOR_SCHEDULER = 10.0
SECONDS_FOR_WORKERS = 30.0
LIVES = 2
"""How many workers a task may cost, on a cluster of our own, before it is suspected."""

_SECONDS_TO_CLOSE = 3.0
_LOOPBACK = "127.0.0.1"
_ANY_PORT = f"{_LOOPBACK}:0"
_CONFIGURATION = {
    # A worker at work does not answer for a while, and that is all right.
    "distributed.admin.tick.limit": "1h",
    "distributed.scheduler.allowed-failures": LIVES - 1,
    "distributed.worker.profile.enabled": False,
    # One thread for each library that would start one per core. Dask's own choice also has
    # memory given back at every turn (MALLOC_TRIM_THRESHOLD_), which costs a third of the time
    # where images come and go.
    "distributed.nanny.pre-spawn-environ": {
        "LP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    },
}


class WorkersError(LabError):
    """There is nobody to do the work."""


class AddressError(WorkersError):
    """What should be the address of a scheduler is none."""


class TaskLostError(LabError):
    """A task has cost every worker that tried it its life."""


@contextlib.contextmanager
def dask_client(workers: int = 0, scheduler: str = "") -> Iterator[Client]:
    """Provide a client of a cluster, and clear away what was started for it.

    Args:
        workers: processes of a cluster of our own, each with one thread, that listens on the
            loopback only; 0 for one per core.
        scheduler: address such as tcp://host:8786 of a cluster to use instead.

    Raises:
        WorkersError: the scheduler does not answer or has no workers.
    """
    _silence_dask()
    maker = _remote_client(scheduler) if scheduler else _local_client(workers)
    with dask.config.set(_CONFIGURATION), maker as client:
        yield client


def completed(
    client: Client, task: Callable[[int], Any], numbers: Iterable[int]
) -> Iterator[Tuple[int, Any]]:
    """Have `task(number)` run for each number; yield numbers and results as they come.

    A task whose worker dies is tried again on another, and at last alone, since it may have
    been another's fault. The result of one that was given up is a TaskLostError, not raised.

    Raises:
        WorkersError: the cluster is gone, or its workers cannot run the task at all.
    """
    suspects = []
    for number, result in _round(client, task, numbers):
        if isinstance(result, TaskLostError):
            suspects.append(number)
        else:
            yield number, result
    for number in suspects:
        yield from _round(client, task, [number])


def _round(
    client: Client, task: Callable[[int], Any], numbers: Iterable[int]
) -> Iterator[Tuple[int, Any]]:
    """Keep each thread of the cluster busy with one task, until all are done."""
    left = iter(numbers)
    number_of: Dict[str, int] = {}
    waiting = as_completed(loop=client.loop)
    while True:
        free = _threads(client) - len(number_of)
        for number in itertools.islice(left, max(free, 0 if number_of else 1)):
            # Not pure: what the scheduler knows of another campaign is of no use to this one.
            future = client.submit(task, number, pure=False)
            number_of[future.key] = number
            waiting.add(future)
        if not number_of:
            return
        future = next(waiting)
        yield number_of.pop(future.key), _result_of(future)
        future.release()


def _threads(client: Client) -> int:
    try:
        return sum(client.nthreads().values())
    except (OSError, TimeoutError, CancelledError):
        raise WorkersError("the Dask scheduler is gone") from None


def _result_of(future: Any) -> Any:
    try:
        return future.result()
    except KilledWorker:
        return TaskLostError("every worker that tried it has died")
    except CancelledError:
        raise WorkersError("the Dask scheduler is gone") from None
    except Exception as error:  # whatever a worker without the right libraries raises
        kind = type(error).__name__
        raise WorkersError(f"the workers cannot do it: {kind}: {error}") from error


@contextlib.contextmanager
def _remote_client(scheduler: str) -> Iterator[Client]:
    # Of other words, Dask makes host names, and much noise.
    if not re.fullmatch(r"\w+://\S+:\d+", scheduler, re.ASCII):
        raise AddressError(f"'{scheduler}' is no address such as tcp://host:8786")
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


@contextlib.contextmanager
def _local_client(workers: int) -> Iterator[Client]:
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lab-dask-"))
        stack.enter_context(dask.config.set({"temporary-directory": folder}))
        with _interrupts_ignored():
            cluster = LocalCluster(
                n_workers=workers or len(os.sched_getaffinity(0)),
                threads_per_worker=1,
                processes=True,
                host=_LOOPBACK,
                dashboard_address=_ANY_PORT,
                worker_dashboard_address=_ANY_PORT,
                scheduler_kwargs={"dashboard": False},
                memory_limit=None,
                local_directory=folder,
                silence_logs=logging.CRITICAL,
            )
        stack.callback(_close, cluster)
        client = stack.enter_context(contextlib.closing(Client(cluster, set_as_default=False)))
        try:
            yield client
        except BaseException:
            _kill_workers(cluster)
            raise


def _kill_workers(cluster: LocalCluster) -> None:
    """End workers in the middle of their tasks, for which Dask itself would wait."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        if nanny.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(nanny.pid, signal.SIGKILL)


def _close(cluster: LocalCluster) -> None:
    # On a busy machine the processes may take longer to end; they do so all the same.
    with contextlib.suppress(TimeoutError):
        cluster.close(_SECONDS_TO_CLOSE)


def _silence_dask() -> None:
    """Have Dask say nothing: what matters is raised."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Have processes that are started meanwhile ignore Ctrl-C: this one stops them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
