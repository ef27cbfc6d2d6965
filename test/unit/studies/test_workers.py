import os
import signal
import socket
import tempfile
import threading
import time

import psutil
import pytest
from distributed import LocalCluster

from bullet_lab.studies.workers import LIVES, TaskLostError, WorkersError, completed, dask_client


def where(number):
    return os.getpid(), threading.get_ident(), os.environ.get("LP_NUM_THREADS")


def square(number):
    return number * number


def deadly(number):
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def dies_at_first(folder, times):
    def task(number):
        if number == 3 and len(os.listdir(folder)) < times:
            tempfile.mkstemp(dir=folder)
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    return task


def unknown_library(number):
    raise ModuleNotFoundError("No module named 'bullet_lab'")


def endless(number):
    deadline = time.monotonic() + 300.0
    while time.monotonic() < deadline:
        pass


def interruptible(number):
    before = signal.getsignal(signal.SIGINT)
    return before == signal.SIG_IGN


@pytest.fixture(autouse=True, scope="module")
def ctrl_c():
    # Whoever runs the tests may have told this process to pass over it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def client():
    with dask_client(workers=2) as client:
        yield client


def in_process_cluster(workers, **options):
    return LocalCluster(
        n_workers=workers,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        **options,
    )


def listening():
    """The addresses that this process and its children listen on."""
    own = psutil.Process()
    return [
        connection.laddr.ip
        for process in (own, *own.children(recursive=True))
        for connection in process.net_connections()
        if connection.status == psutil.CONN_LISTEN
    ]


def test_every_number_gets_its_result(client):
    assert dict(completed(client, square, range(20))) == {n: n * n for n in range(20)}
    assert dict(completed(client, square, [])) == {}


def test_each_worker_works_in_one_thread_with_one_thread_for_graphics(client):
    found = dict(completed(client, where, range(30)))
    threads = {}
    for pid, thread, graphics in found.values():
        threads.setdefault(pid, set()).add(thread)
        assert graphics == "1"
    assert len(threads) == 2
    assert os.getpid() not in threads
    assert all(len(ids) == 1 for ids in threads.values())


def test_workers_leave_interrupts_to_their_master(client):
    assert all(dict(completed(client, interruptible, range(4))).values())
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler


def test_a_task_that_kills_is_given_up_and_no_other_is_lost():
    with dask_client(workers=2) as client:
        found = dict(completed(client, deadly, range(8)))
    assert isinstance(found.pop(3), TaskLostError)
    assert found == {n: n for n in range(8) if n != 3}


# Once more than others are given is what a task gets that is tried alone.
@pytest.mark.parametrize("times", [1, LIVES])
def test_a_task_whose_worker_dies_is_tried_again(tmp_path, times):
    with dask_client(workers=1) as client:
        found = dict(completed(client, dies_at_first(str(tmp_path), times), range(6)))
    assert found == {n: n for n in range(6)}
    assert len(list(tmp_path.iterdir())) == times


def test_interrupted_it_does_not_wait_for_its_tasks():
    def interrupt():
        with dask_client(workers=2) as client:
            pids = set(client.run(os.getpid).values())
            results = completed(client, endless, range(4))
            threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
            try:
                next(results)
            finally:
                started.append(pids)

    started = []
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    (pids,) = started
    assert len(pids) == 2
    assert not any(map(psutil.pid_exists, pids))


def test_workers_that_cannot_do_it_are_an_error_of_one_line(client):
    with pytest.raises(WorkersError, match="No module named") as caught:
        list(completed(client, unknown_library, range(3)))
    assert "\n" not in str(caught.value)


def test_it_listens_on_the_loopback_only_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    with dask_client(workers=1) as client:
        assert dict(completed(client, square, [2])) == {2: 4}
        addresses = listening()
        assert len(addresses) >= 2
        assert set(addresses) == {"127.0.0.1"}
    assert list(tmp_path.iterdir()) == []


def test_a_cluster_of_somebody_else():
    with in_process_cluster(1, threads_per_worker=2) as cluster:
        with dask_client(scheduler=cluster.scheduler_address) as client:
            assert dict(completed(client, square, range(9))) == {n: n * n for n in range(9)}
        # It is not ours to end.
        assert len(cluster.scheduler.workers) == 1


def test_a_cluster_that_goes_away_is_an_error(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_SCHEDULER", 1.0)
    with in_process_cluster(1) as cluster, dask_client(
        scheduler=cluster.scheduler_address
    ) as client:
        results = completed(client, square, range(100))
        next(results)
        cluster.close()
        with pytest.raises(WorkersError, match="is gone"):
            list(results)


@pytest.mark.parametrize("scheduler", ["somewhere", "tcp://", "tcp://host", "127.0.0.1:8786"])
def test_what_is_no_address_is_refused_at_once(scheduler):
    start = time.monotonic()
    with pytest.raises(WorkersError, match="tcp://host:8786"), dask_client(scheduler=scheduler):
        pass
    assert time.monotonic() - start < 5.0


def test_nobody_at_the_address(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_SCHEDULER", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(WorkersError, match="no Dask scheduler answers"), dask_client(
            scheduler=address
        ):
            pass


def test_a_scheduler_without_workers(monkeypatch):
    monkeypatch.setattr("bullet_lab.studies.workers.SECONDS_FOR_WORKERS", 0.5)
    with in_process_cluster(0) as cluster, pytest.raises(
        WorkersError, match="no workers"
    ), dask_client(scheduler=cluster.scheduler_address):
        pass
