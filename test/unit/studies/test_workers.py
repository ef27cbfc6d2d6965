import contextlib
import functools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time

import psutil
import pytest

from bullet_lab.core.parameters import ParameterError
from bullet_lab.studies.workers import (
    LIVES,
    ClusterSettings,
    TaskLostError,
    WorkersError,
    this_process,
    workers,
)


def where(number):
    return os.getpid(), threading.get_ident(), os.environ.get("OPENBLAS_NUM_THREADS")


def square(number):
    return number * number


def deadly(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def dies_at_first(folder, times, number):
    if number == 3 and len(os.listdir(folder)) < times:
        tempfile.mkstemp(dir=folder)
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def unknown_library(number):
    raise ModuleNotFoundError("No module named 'bullet_lab'")


def unable_to_travel(number):
    return lambda: number


def endless(number):
    deadline = time.monotonic() + 300.0
    while time.monotonic() < deadline:
        pass


def interruptible(number):
    before = signal.getsignal(signal.SIGINT)
    return before == signal.SIG_IGN


def overlapping(number):
    """Whether another task runs in this process at the same time."""
    here = f"at work {number}"
    threading.current_thread().name = here
    time.sleep(0.05)
    others = [thread.name for thread in threading.enumerate() if thread.name.startswith("at work")]
    threading.current_thread().name = "idle"
    return others != [here]


@pytest.fixture(autouse=True, scope="module")
def ctrl_c():
    # Whoever runs the tests may have told this process to pass over it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def in_process_cluster(workers, **options):
    # Every worker process imports this file, and nearly none needs Dask.
    import dask
    from distributed import LocalCluster

    address = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    # Dask would leave a folder in the system's directory for temporary files.
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        stack.enter_context(dask.config.set(temporary_directory=folder))
        yield stack.enter_context(
            LocalCluster(n_workers=workers, processes=False, **address, **options)
        )


@pytest.mark.parametrize("run", [workers(2), workers(1), this_process])
def test_every_number_gets_its_result(run):
    assert dict(run(square, range(20))) == {n: n * n for n in range(20)}
    assert dict(run(square, [])) == {}


def test_each_worker_works_in_one_thread_with_one_thread_for_libraries():
    found = dict(workers(2)(where, range(30)))
    threads = {}
    for pid, thread, library in found.values():
        threads.setdefault(pid, set()).add(thread)
        assert library == "1"
    assert 1 <= len(threads) <= 2
    assert os.getpid() not in threads
    assert all(len(ids) == 1 for ids in threads.values())


def test_workers_leave_interrupts_to_their_master():
    assert all(dict(workers(2)(interruptible, range(4))).values())
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_task_that_kills_is_given_up_and_no_other_is_lost():
    found = dict(workers(2)(deadly, range(8)))
    assert isinstance(found.pop(3), TaskLostError)
    assert found == {n: n for n in range(8) if n != 3}


# Once more than others are given is what a task gets that is tried alone.
@pytest.mark.parametrize("times", [1, LIVES])
def test_a_task_whose_worker_dies_is_tried_again(tmp_path, times):
    task = functools.partial(dies_at_first, str(tmp_path), times)
    assert dict(workers(1)(task, range(6))) == {n: n for n in range(6)}
    assert len(list(tmp_path.iterdir())) == times


def test_interrupted_it_does_not_wait_for_its_tasks():
    def interrupt():
        own = psutil.Process()
        while len(own.children()) < 2:
            time.sleep(0.01)
        started.extend(own.children())
        os.kill(os.getpid(), signal.SIGINT)

    started = []
    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        list(workers(2)(endless, range(4)))
    assert len(started) >= 2
    _, alive = psutil.wait_procs(started, timeout=5.0)
    # What keeps track of resources of processes ends with this one.
    assert [p for p in alive if "resource_tracker" not in " ".join(p.cmdline())] == []


@pytest.mark.parametrize("task", [unknown_library, unable_to_travel])
def test_workers_that_cannot_do_it_are_an_error_of_one_line(task):
    with pytest.raises(WorkersError, match="a worker process failed: [A-Z]") as caught:
        list(workers(2)(task, range(3)))
    assert "\n" not in str(caught.value)


KILLED = """
import sys
sys.path.insert(0, sys.argv[1])
from test_workers import endless, workers
if __name__ == "__main__":
    list(workers(2)(endless, range(4)))
"""


def test_killed_it_leaves_no_worker_and_no_file(tmp_path):
    """Workers in the middle of endless tasks end as soon as their master is gone."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    script = tmp_path / "run.py"
    script.write_text(KILLED)
    master = subprocess.Popen(
        [sys.executable, str(script), os.path.dirname(__file__)],
        env=dict(os.environ, TMPDIR=str(temporary)),
    )
    process, deadline = psutil.Process(master.pid), time.monotonic() + 60.0
    # Two at work, beside what keeps track of resources.
    while sum(child.cpu_times().user > 1.5 for child in process.children()) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    children = process.children(recursive=True)
    assert not [c for child in children for c in child.net_connections()]
    master.kill()
    master.wait()
    _, alive = psutil.wait_procs(children, timeout=20.0)
    assert alive == []
    assert list(temporary.iterdir()) == []


# ---- Elsewhere ----


def test_a_cluster_of_somebody_else():
    with in_process_cluster(1, threads_per_worker=2) as cluster:
        run = workers(scheduler=cluster.scheduler_address)
        assert dict(run(square, range(9))) == {n: n * n for n in range(9)}
        assert not any(dict(run(overlapping, range(6))).values())
        # It is not ours to end.
        assert len(cluster.scheduler.workers) == 1


def test_a_cluster_that_goes_away_is_an_error(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_SCHEDULER", 1.0)
    with in_process_cluster(1) as cluster:
        results = workers(scheduler=cluster.scheduler_address)(square, range(100))
        next(results)
        cluster.close()
        with pytest.raises(WorkersError, match="connection to the Dask scheduler is lost"):
            list(results)


@pytest.mark.parametrize("scheduler", ["somewhere", "tcp://", "tcp://host", "127.0.0.1:8786"])
def test_what_is_no_address_is_refused(scheduler):
    with pytest.raises(ParameterError, match="tcp://host:8786"):
        ClusterSettings(scheduler=scheduler)
    assert ClusterSettings(scheduler="tcp://host:8786").scheduler == "tcp://host:8786"


def test_nobody_at_the_address(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_SCHEDULER", 0.5)
    with contextlib.closing(socket.socket()) as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(WorkersError, match="no Dask scheduler answers"):
            list(workers(scheduler=address)(square, [1]))


def test_a_scheduler_without_workers(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_WORKERS", 0.5)
    with in_process_cluster(0) as cluster, pytest.raises(WorkersError, match="no workers"):
        list(workers(scheduler=cluster.scheduler_address)(square, [1]))
