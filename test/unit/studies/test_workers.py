"""Tasks on processes of this machine."""

import functools
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
import pytest
from shared import refuses
from study_runs import backwards

from bullet_lab.errors import LabError
from bullet_lab.studies.study import LIVES, TaskLostError, UnfinishedError, run_tasks, workers

PATIENCE = 300.0
"""Longest that anything here takes, s, on whatever machine."""


def square(number):
    return number * number


def about(number):
    """Process, thread, number of threads for libraries, and whether Ctrl-C is ignored."""
    library = os.environ.get("OPENBLAS_NUM_THREADS")
    ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    return os.getpid(), threading.get_ident(), library, ignored


def dies(folder, number):
    """Kills its process: for 1 always, for 2 all but the last time."""
    deaths = len(list(Path(folder).glob(f"{number}_*")))
    if deaths < {1: 100, 2: LIVES - 1}.get(number, 0):
        tempfile.mkstemp(prefix=f"{number}_", dir=folder)
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def unknown_library(number):
    raise ModuleNotFoundError("No module named 'bullet_lab'")


def refusing(number):
    raise LabError(f"square {number} is too small")


def unable_to_travel(number):
    return lambda: number


def endless(folder, number):
    (Path(folder) / str(number)).touch()
    while time.process_time() < PATIENCE:
        pass


def interrupting(folder, number):
    # The last of two workers to get its first task.
    if number == 1:
        os.kill(os.getppid(), signal.SIGINT)
    endless(folder, number)


def test_without_numbers_there_are_no_results():
    assert list(workers(2)(square, [])) == []


def test_results_are_in_the_order_of_the_numbers_and_none_may_be_lost():
    about = (print, "cells")

    assert run_tasks(square, 3, backwards, *about) == [0, 1, 4]
    with refuses("number 0 of cells: gone", TaskLostError):
        run_tasks(square, 3, lambda *_: [(0, TaskLostError("gone"))], *about)


@pytest.fixture(scope="module")
def found():
    """What 30 tasks on two workers say about themselves."""
    return dict(workers(2)(about, range(30)))


def test_each_worker_works_in_one_thread_with_one_thread_for_libraries(found):
    assert sorted(found) == list(range(30))
    threads = {}
    for pid, thread, library, _ in found.values():
        threads.setdefault(pid, set()).add(thread)
        assert library == "1"
    assert 1 <= len(threads) <= 2
    assert os.getpid() not in threads
    assert all(len(ids) == 1 for ids in threads.values())


def test_workers_leave_interrupts_to_their_master(found):
    assert all(ignored for *_, ignored in found.values())
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_task_that_kills_is_given_up_and_no_other_is_lost(tmp_path):
    found = dict(workers(2)(functools.partial(dies, str(tmp_path)), range(4)))
    assert isinstance(found.pop(1), TaskLostError)
    assert found == {0: 0, 2: 2, 3: 3}
    deaths = sorted(path.name[0] for path in tmp_path.iterdir())
    assert deaths == ["1"] * LIVES + ["2"] * (LIVES - 1)


def test_interrupted_it_ends_its_workers(tmp_path):
    multiprocessing.resource_tracker.ensure_running()
    before = psutil.Process().children()
    with pytest.raises(KeyboardInterrupt):
        list(workers(2)(functools.partial(interrupting, str(tmp_path)), range(4)))
    assert psutil.Process().children() == before


@pytest.mark.parametrize("task", [unknown_library, unable_to_travel])
def test_workers_that_cannot_do_it_are_an_error_of_one_line(task):
    with refuses("a worker process failed: [A-Z]", UnfinishedError):
        list(workers(1)(task, range(3)))


def test_what_the_input_causes_is_said_as_it_is():
    with refuses("^square 0 is too small$", UnfinishedError):
        list(workers(1)(refusing, range(2)))


KILLED = """
import functools, sys
from test_workers import endless, workers
if __name__ == "__main__":
    list(workers(2)(functools.partial(endless, sys.argv[1]), range(4)))
"""


def test_killed_it_leaves_no_worker_and_no_file(tmp_path):
    """Workers in the middle of endless tasks end as soon as their master is gone."""
    script, started, temporary = (tmp_path / name for name in ("run.py", "started", "tmp"))
    started.mkdir()
    temporary.mkdir()
    script.write_text(KILLED)
    master = subprocess.Popen(
        [sys.executable, str(script), str(started)],
        env=dict(os.environ, TMPDIR=str(temporary), PYTHONPATH=os.pathsep.join(sys.path)),
    )
    while len(list(started.iterdir())) < 2:
        assert master.poll() is None
        time.sleep(0.05)
    children = psutil.Process(master.pid).children(recursive=True)
    assert not [c for child in children for c in child.net_connections()]
    master.kill()
    master.wait()
    _, alive = psutil.wait_procs(children, timeout=PATIENCE)
    assert alive == []
    assert list(temporary.iterdir()) == []
