import contextlib
import itertools
import threading
import time
from concurrent.futures import Future

import pytest

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge import stepper as stepper_module
from bullet_lab.ros.bridge.stepper import (
    FOR_EVER,
    Pace,
    SpeedWatch,
    Stepper,
    StepperError,
    TimeGate,
)
from bullet_lab.simulation.simulation import Simulation

PATIENCE = 60.0


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


class Running:
    """A stepper with its loop in a thread, and what the tests look at."""

    def __init__(self, rtf=0.0, expected=(), paused=False, clock=time.monotonic):
        self.over = threading.Event()
        self.flushed = []
        self.simulation = Simulation()
        self.stepper = Stepper(
            self.simulation,
            Pace(rtf, clock),
            TimeGate(expected),
            tick=10,
            paused=paused,
            is_over=self.over.is_set,
            report_stall=lambda _: None,
            report_lag=lambda _: None,
        )
        self.stepper.after_steps = lambda: self.flushed.append(self.simulation.step)
        self.thread = threading.Thread(target=self.stepper.run, daemon=True)
        self.thread.start()

    @property
    def step(self):
        return self.simulation.step

    def grant(self, member, step):
        """Grant in the present epoch; return whether time has come there."""
        return self.stepper.grant(member, step, self.stepper.epoch).success

    def end(self):
        self.over.set()
        self.stepper.wake()
        self.thread.join(PATIENCE)
        assert not self.thread.is_alive()


@pytest.fixture
def running():
    """A function that starts a stepper; all are ended after the test."""
    with contextlib.ExitStack() as stack:

        def start(**options):
            made = Running(**options)
            stack.callback(made.simulation.close)
            stack.callback(made.end)
            return made

        yield start


def in_thread(function, *arguments):
    """Call a function in a thread; return the thread and a list for what it returns."""
    results = []
    thread = threading.Thread(target=lambda: results.append(function(*arguments)), daemon=True)
    thread.start()
    return thread, results


def error_of(function, *arguments):
    """Call a function; return the line of the error that it raises."""
    with pytest.raises(StepperError) as caught:
        function(*arguments)
    return caught.value


def assert_stands(run):
    """Time does not move while the loop goes round once; return the step."""
    before = run.step
    for _ in range(2):
        assert run.stepper.do(lambda: run.step) == before
    return before


def test_paused_from_the_start_until_told(running):
    run = running(paused=True)
    assert assert_stands(run) == 0
    run.stepper.set_paused(False)
    wait_for(lambda: run.step > 100)
    run.stepper.set_paused(True)
    assert_stands(run)


def test_advances_by_exactly_so_many_steps_while_paused(running):
    run = running(paused=True)
    assert [run.stepper.advance_by(n) for n in (7, 0, 1, 993)] == [7, 7, 8, 1001]
    assert assert_stands(run) == 1001


def test_who_advances_far_stops_nobody_else(running):
    run = running(paused=True)
    thread, errors = in_thread(error_of, run.stepper.advance_by, 2**32 - 1)
    wait_for(lambda: run.step > 0)
    assert run.stepper.advance_by(7) > 0
    assert run.stepper.do(lambda: "served") == "served"
    run.stepper.reset(run.simulation.reset_simulation)
    wait_for(lambda: run.step > 500)
    run.stepper.set_paused(True)
    assert_stands(run)
    thread.join(PATIENCE)
    assert ["paused with" in str(error) for error in errors] == [True]


def test_slow_steps_come_in_short_strides(running, monkeypatch):
    monkeypatch.setattr(stepper_module, "LONGEST_STRIDE", 0.001)
    run = running(paused=True)
    run.simulation.every(1000.0, lambda _: time.sleep(0.002))
    for steps in (1, 30):
        run.stepper.advance_by(steps)
    assert run.flushed == list(range(1, 32))


def test_time_goes_on_however_fast_others_ask(running):
    run = running()
    asked = []

    def ask_again():
        asked.append(run.step)
        if not run.over.is_set():
            run.stepper._tasks.put((Future(), ask_again))

    run.stepper.do(ask_again)
    wait_for(lambda: asked[-1] > asked[0] + 1000)


def test_tasks_run_in_the_thread_of_the_loop(running):
    run = running(paused=True)
    assert run.stepper.do(threading.current_thread) is run.thread


def test_waits_for_missing_members(running):
    run = running(expected=["/a", "/b"])
    assert assert_stands(run) == 0
    run.grant("/a", FOR_EVER)
    assert assert_stands(run) == 0
    run.grant("/b", FOR_EVER)
    wait_for(lambda: run.step > 100)


@pytest.mark.parametrize("rtf", [0.0, 50.0])
def test_grant_returns_exactly_there(running, rtf):
    # Always ahead, but for less than what is a stall.
    run = running(rtf=rtf, expected=["/a"], clock=itertools.count(0.0, 0.01).__next__)
    for step in (0, 1, 100, 130):
        assert run.grant("/a", step)
        assert assert_stands(run) == step


def test_what_steps_have_brought_goes_out_before_anybody_is_told(running):
    run = running(expected=["/a"])
    for step in range(0, 2000, 130):
        run.grant("/a", step)
        assert step == 0 or run.flushed[-1] == step
    run.stepper.set_paused(True)
    assert run.stepper.advance_by(7) == run.flushed[-1]


def test_joining_late_or_again_stops_time_before_it_is_answered(running):
    run = running()
    for _ in range(5):
        run.grant("/a", FOR_EVER)
        before = run.step
        wait_for(lambda before=before: run.step > before)
        assert run.stepper.join("/a").success
        assert_stands(run)


def test_grant_of_one_member_waits_for_the_other(running):
    run = running(expected=["/a", "/b"])
    run.grant("/b", 0)
    thread, results = in_thread(run.grant, "/a", 100)
    assert assert_stands(run) == 0
    assert run.grant("/b", 50)
    assert thread.is_alive()
    assert run.grant("/b", 100)
    thread.join(PATIENCE)
    assert results == [True]


def test_reset_releases_who_waits(running):
    run = running(expected=["/a", "/b"])
    run.grant("/b", 0)
    in_thread(run.grant, "/b", 50)
    thread, results = in_thread(run.grant, "/a", 100)
    wait_for(lambda: run.step == 50 and run.stepper.gate.has_joined("/a"))
    run.stepper.reset(run.simulation.reset_simulation)
    thread.join(PATIENCE)
    assert results == [False]
    assert assert_stands(run) == 0


@pytest.mark.parametrize("world_only", [False, True])
def test_a_grant_from_before_a_reset_is_never_given(running, world_only):
    run = running(expected=["/a"])
    busy = run.stepper.grant("/a", 100, run.stepper.join("/a").epoch)
    world = run.simulation
    run.stepper.reset(world.reset_world if world_only else world.reset_simulation)
    now = 100 if world_only else 0
    assert assert_stands(run) == now
    # The member thinks of what it does next, and knows nothing of the reset.
    late = run.stepper.grant("/a", 30_000, busy.epoch)
    assert (late.success, late.step) == (False, now)
    assert assert_stands(run) == now
    assert run.stepper.grant("/a", now + 100, late.epoch) == (True, now + 100, late.epoch)


def test_who_is_gone_for_good_stays_so_after_a_reset(running):
    run = running(expected=["/a"])
    epoch = run.stepper.join("/a").epoch
    run.stepper.reset(run.simulation.reset_simulation)
    assert run.stepper.grant("/a", FOR_EVER, epoch).success
    wait_for(lambda: run.step > 100)
    run.stepper.reset(run.simulation.reset_simulation)
    wait_for(lambda: run.step > 100)


def test_end_releases_who_waits(running):
    run = running(expected=["/a", "/b"])
    thread, results = in_thread(run.grant, "/a", 100)
    assert assert_stands(run) == 0
    run.end()
    thread.join(PATIENCE)
    assert results == [False]


def test_end_cuts_a_long_way_short_and_nothing_more_is_done(running):
    run = running(paused=True)
    thread, errors = in_thread(error_of, run.stepper.advance_by, 2**32 - 1)
    wait_for(lambda: run.step > 0)
    run.end()
    thread.join(PATIENCE)
    assert len(errors) == 1
    error_of(run.stepper.do, lambda: None)


def test_a_command_acts_at_the_present_moment_of_wall_time(running, clock):
    run = running(rtf=1.0, clock=clock)
    assert assert_stands(run) == 0
    do, seen = run.stepper.do, []

    def do_late(action):
        # Between two ticks, of which the loop knows nothing.
        do(lambda: (setattr(clock, "now", clock.now + 0.0905), action()))

    run.stepper.do = do_late
    run.stepper.do_now(lambda: seen.append(run.step))
    assert seen == [90]


def test_a_command_at_a_speed_that_nothing_keeps_up_with(running):
    run = running(rtf=1e9)
    wait_for(lambda: run.step > 1000)
    done = []
    run.stepper.do_now(lambda: done.append(run.step))
    assert done


@pytest.mark.parametrize("kind", [LabError, MemoryError])
def test_whatever_goes_wrong_in_a_task_is_its_owners_problem(running, kind):
    run = running()

    def fail():
        raise kind("no")

    with pytest.raises(kind, match="no"):
        run.stepper.do(fail)
    reached = run.step
    wait_for(lambda: run.step > reached)


def test_the_speed_can_be_changed_on_the_way(running, clock):
    run = running(rtf=1.0, clock=clock)
    assert assert_stands(run) == 0
    run.stepper.set_real_time_factor(0.0)
    wait_for(lambda: run.step > 10_000)
    run.stepper.set_real_time_factor(1.0)
    assert_stands(run)


def test_steps_that_are_asked_for_are_in_a_hurry(running):
    run = running(rtf=0.001, paused=True)
    seen = []
    assert not run.stepper.lossless
    run.stepper.after_steps = lambda: seen.append(run.stepper.lossless)
    run.stepper.advance_by(500)
    assert seen == [True, True, True]
    assert not run.stepper.lossless
    run.stepper.set_real_time_factor(0.0)
    assert run.stepper.lossless


class SlowWorld:
    """A stepper of which all happens in a time of its own, in the thread of the test.

    Every step costs `cost` wall seconds, and waiting costs what it takes.
    """

    def __init__(self, monkeypatch, cost, rtf=1.0, paused=False, expected=()):
        self.now = 0.0
        self.lags = []
        self.stalls = []
        self.simulation = Simulation()
        self.gate = TimeGate(expected)
        monkeypatch.setattr(stepper_module.time, "monotonic", lambda: self.now)
        advance = self.simulation.run_until

        def run_until(step):
            self.now += cost * (step - self.simulation.step)
            advance(step)

        monkeypatch.setattr(self.simulation, "run_until", run_until)
        self.stepper = Stepper(
            self.simulation,
            Pace(rtf, lambda: self.now),
            self.gate,
            tick=10,
            paused=paused,
            is_over=lambda: self.now >= self.end,
            report_stall=self.stalls.append,
            report_lag=self.lags.append,
            watch=SpeedWatch(lambda: self.now),
        )
        monkeypatch.setattr(self.stepper, "_wait", self.wait)

    def wait(self, seconds, _wakeups):
        self.now += max(seconds, 1e-4)

    def run(self, seconds):
        self.end = self.now + seconds
        self.stepper.run()
        self.simulation.close()


def test_a_speed_that_is_not_reached_is_reported_now_and_then(monkeypatch):
    world = SlowWorld(monkeypatch, cost=2e-3)
    world.run(21.0)
    assert len(world.lags) == 3
    speeds = [float(lag.split()[6]) for lag in world.lags]
    assert speeds == pytest.approx([0.5] * 3, abs=0.02)


@pytest.mark.parametrize(("cost", "rtf"), [(9e-4, 1.0), (2e-3, 0.0)])
def test_a_speed_that_is_reached_is_no_news(monkeypatch, cost, rtf):
    world = SlowWorld(monkeypatch, cost, rtf)
    world.run(21.0)
    assert world.lags == []


def test_a_pause_is_no_lag(monkeypatch):
    world = SlowWorld(monkeypatch, cost=1e-4, paused=True)
    world.run(30.0)
    assert (world.lags, world.stalls) == ([], [])
    # Nor does it count afterwards.
    world = SlowWorld(monkeypatch, cost=1e-4)
    world.stepper.do = lambda change: change()
    world.stepper.set_paused(True)
    world.now += 30.0
    world.stepper.set_paused(False)
    world.run(20.0)
    assert world.lags == []


def test_who_holds_time_back_for_long_is_reported_as_a_stall_alone(monkeypatch):
    world = SlowWorld(monkeypatch, cost=1e-4, expected=["/b", "/a"])
    world.run(20.0)
    assert world.lags == []
    assert world.stalls[0] == ("/a", "/b")
    assert len(world.stalls) > 5
