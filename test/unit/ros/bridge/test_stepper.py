import contextlib
import itertools
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor

import pytest
from shared import cases

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


class Run:
    """A stepper, what it has reported, and after which steps it flushed."""

    def __init__(self, rtf, clock, expected=(), paused=False, **more):
        self.flushed, self.lags, self.stalls = [], [], []
        self.simulation = Simulation()
        self.stepper = Stepper(
            self.simulation,
            Pace(rtf, clock),
            TimeGate(expected),
            tick=10,
            paused=paused,
            is_over=self.is_over,
            report_stall=self.stalls.append,
            report_lag=self.lags.append,
            **more,
        )
        self.stepper.after_steps = lambda: self.flushed.append(self.step)

    @property
    def step(self):
        return self.simulation.step


class Running(Run):
    """A stepper whose loop runs in a thread."""

    def __init__(self, rtf=0.0, clock=time.monotonic, **options):
        self.over = threading.Event()
        super().__init__(rtf, clock, **options)
        self.others = ThreadPoolExecutor()
        self.thread = threading.Thread(target=self.stepper.run, daemon=True)
        self.thread.start()

    def is_over(self):
        return self.over.is_set()

    def goes_on(self, steps=100):
        """Wait until time has gone on by some steps."""
        wait_for(lambda start=self.step: self.step > start + steps)

    def grant(self, member, step):
        """Grant in the present epoch; return whether time has come there."""
        return self.stepper.grant(member, step, self.stepper.epoch).success

    def meanwhile(self, function, *arguments):
        """Call a function in another thread; return a function that waits for its result."""
        future = self.others.submit(function, *arguments)
        return lambda: future.exception(PATIENCE) or future.result()

    def reset(self):
        self.stepper.reset(self.simulation.reset_simulation)

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


def assert_stands(run, step=None):
    """Time does not move while the loop goes round once, and is at a step, if one is given."""
    step = run.step if step is None else step
    for _ in range(2):
        assert run.stepper.do(lambda: run.step) == step


def test_paused_from_the_start_it_advances_by_exactly_so_many_steps_until_told(running):
    run = running(paused=True)
    assert [run.stepper.advance_by(n) for n in (0, 7, 0, 1, 993)] == [0, 7, 7, 8, 1001]
    assert_stands(run, 1001)
    run.stepper.set_paused(False)
    run.goes_on()
    run.stepper.set_paused(True)
    assert_stands(run)


def test_who_advances_far_stops_nobody_else(running):
    run = running(paused=True)
    error = run.meanwhile(run.stepper.advance_by, 2**32 - 1)
    wait_for(lambda: run.step > 0)
    assert run.stepper.advance_by(7) > 0
    assert run.stepper.do(threading.current_thread) is run.thread
    run.reset()
    wait_for(lambda: run.step > 500)
    run.stepper.set_paused(True)
    assert_stands(run)
    assert "paused with" in str(error())


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
        if not run.is_over():
            run.stepper._tasks.put((Future(), ask_again))

    run.stepper.do(ask_again)
    wait_for(lambda: asked[-1] > asked[0] + 1000)


@cases("rtf: [0.0, 50.0]")
def test_grant_returns_exactly_there_and_what_steps_have_brought_is_out(running, rtf):
    # Always ahead, but for less than what is a stall.
    run = running(rtf=rtf, expected=["/a"], clock=itertools.count(0.0, 0.01).__next__)
    for step in (0, 1, 100, 130, 500):
        assert run.grant("/a", step)
        assert step == 0 or run.flushed[-1] == step
        assert_stands(run, step)
    run.stepper.set_paused(True)
    assert run.stepper.advance_by(7) == run.flushed[-1]


def test_joining_late_or_again_stops_time_before_it_is_answered(running):
    run = running()
    for _ in range(5):
        run.grant("/a", FOR_EVER)
        run.goes_on(0)
        assert run.stepper.join("/a").success
        assert_stands(run)


def test_grant_of_one_member_waits_for_the_other(running):
    run = running(expected=["/a", "/b"])
    run.grant("/b", 0)
    result = run.meanwhile(run.grant, "/a", 100)
    assert_stands(run, 0)
    for step in (50, 100):
        assert run.grant("/b", step)
        assert_stands(run, step)
    assert result() is True


@pytest.mark.parametrize("end", [Running.reset, Running.end])
def test_reset_and_end_release_who_waits(running, end):
    run = running(expected=["/a", "/b"])
    run.grant("/b", 0)
    results = [run.meanwhile(run.grant, "/b", 50), run.meanwhile(run.grant, "/a", 100)]
    wait_for(lambda: run.step == 50 and run.stepper.gate.has_joined("/a"))
    end(run)
    assert results[1]() is False
    assert run.is_over() or run.stepper.do(lambda: run.step) == 0


@cases("world_only: [false, true]")
def test_a_grant_from_before_a_reset_is_never_given(running, world_only):
    run = running(expected=["/a"])
    busy = run.stepper.grant("/a", 100, run.stepper.join("/a").epoch)
    world = run.simulation
    run.stepper.reset(world.reset_world if world_only else world.reset_simulation)
    now = 100 if world_only else 0
    assert_stands(run, now)
    # The member thinks of what it does next, and knows nothing of the reset.
    late = run.stepper.grant("/a", 30_000, busy.epoch)
    assert (late.success, late.step) == (False, now)
    assert_stands(run, now)
    assert run.stepper.grant("/a", now + 100, late.epoch) == (True, now + 100, late.epoch)


def test_who_is_gone_for_good_stays_so_after_a_reset(running):
    run = running(expected=["/a"])
    epoch = run.stepper.join("/a").epoch
    run.reset()
    assert run.stepper.grant("/a", FOR_EVER, epoch).success
    run.goes_on()
    run.reset()
    wait_for(lambda: run.step > 100)


def test_end_cuts_a_long_way_short_and_nothing_more_is_done(running):
    run = running(paused=True)
    error = run.meanwhile(run.stepper.advance_by, 2**32 - 1)
    run.goes_on(0)
    run.end()
    assert isinstance(error(), StepperError)
    with pytest.raises(StepperError):
        run.stepper.do(list)


def test_a_command_acts_at_the_present_moment_of_wall_time(running, clock):
    run = running(rtf=1.0, clock=clock)
    assert_stands(run, 0)
    do, seen = run.stepper.do, []

    def do_late(action):
        # Between two ticks, of which the loop knows nothing.
        do(lambda: (setattr(clock, "now", clock.now + 0.0905), action()))

    run.stepper.do = do_late
    run.stepper.do_now(lambda: seen.append(run.step))
    assert seen == [90]


def test_a_command_at_a_speed_that_nothing_keeps_up_with(running):
    run = running(rtf=1e9)
    run.goes_on(1000)
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
    run.goes_on(0)


def test_the_speed_can_be_changed_on_the_way(running, clock):
    run = running(rtf=1.0, clock=clock)
    assert_stands(run, 0)
    run.stepper.set_real_time_factor(0.0)
    run.goes_on(10_000)
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


class SlowWorld(Run):
    """A stepper of which all happens in a time of its own, in the thread of the test.

    Every step costs `cost` wall seconds, and waiting costs what it takes.
    """

    def __init__(self, monkeypatch, cost, rtf=1.0, **options):
        self.now = 0.0
        monkeypatch.setattr(stepper_module.time, "monotonic", self.clock)
        super().__init__(rtf, self.clock, **options)
        advance = self.simulation.run_until

        def run_until(step):
            self.now += cost * (step - self.step)
            advance(step)

        monkeypatch.setattr(self.simulation, "run_until", run_until)
        monkeypatch.setattr(self.stepper, "_wait", self.wait)

    def clock(self):
        return self.now

    def wait(self, seconds, _wakeups):
        self.now += max(seconds, 1e-4)

    def is_over(self):
        return self.now >= self.end

    def run(self, seconds):
        self.end = self.now + seconds
        self.stepper.run()
        self.simulation.close()


@cases("""
options, lags, holding:
  # Options with the cost of a step (wall s), the number of lags, and who holds time back.
  - [{cost: 2.0e-3}, 3, []]
  - [{cost: 9.0e-4}, 0, []]
  - [{cost: 2.0e-3, rtf: 0.0}, 0, []]
  - [{cost: 1.0e-4, paused: true}, 0, []]
  - [{cost: 1.0e-4, expected: [/b, /a]}, 0, [/a, /b]]
""")
def test_a_speed_that_is_not_reached_is_reported_now_and_then(monkeypatch, options, lags, holding):
    world = SlowWorld(monkeypatch, **options)
    world.run(21.0)
    speeds = [float(lag.split()[6]) for lag in world.lags]
    assert speeds == pytest.approx([0.5] * lags, abs=0.02)
    assert all(stall == tuple(holding) for stall in world.stalls)
    assert len(world.stalls) > 5 if holding else not world.stalls


def test_a_pause_does_not_count_afterwards(monkeypatch):
    world = SlowWorld(monkeypatch, cost=1e-4)
    world.stepper.do = lambda change: change()
    world.stepper.set_paused(True)
    world.now += 30.0
    world.stepper.set_paused(False)
    world.run(20.0)
    assert world.lags == []


@cases("factor: [0.005, 0.5, 3.0]")
def test_simulated_time_follows_the_wall_clock(clock, factor):
    pace, begin = Pace(factor, clock), clock.now
    assert not pace.free
    step = 0
    for _ in range(500):
        clock.now += 0.02
        step = max(step, pace.due(step))
        assert step == pytest.approx((clock.now - begin) * 1000 * factor, abs=1.0)


@cases("""
factor, story:
  # Wall seconds that pass, the step that time is at, the one that is due then, and how long to
  # wait for the next (s).
  # As fast as it goes.
  - [0.0, [[0.0, 12, .inf, 0.0]]]
  - [2.0, [[0.0, 100, 0, 0.05], [0.04025, 100, 80, 0.00975], [1.0, 100, 101, 0.0]]]
  # A stall is not chased.
  - [1.0, [[5.0, 0, 1, 0.0], [0.0105, 1, 10, 0.0]]]
  # A small delay is made up for.
  - [1.0, [[0.0995, 0, 99, 0.0]]]
""")
def test_what_is_due_and_how_long_to_wait(clock, factor, story):
    pace = Pace(factor, clock)
    assert pace.free == (factor == 0.0)
    for seconds, step, due, wait in story:
        clock.now += seconds
        assert pace.seconds_until(step) == pytest.approx(wait)
        assert pace.due(step) == due


def test_a_restart_forgets_a_pause(clock):
    pace = Pace(1.0, clock)
    clock.now += 10.0
    pace.restart(500)
    assert pace.due(500) == 500
    clock.now += 0.0205
    assert pace.due(500) == 520


@pytest.fixture
def watch(clock):
    return SpeedWatch(clock)


@cases("""
story:
  # Wall seconds that pass, the step that is reached then, the wanted factor, and what is said.
  # Time that keeps its speed.
  - [[5.0, 5000, 1.0, ""], [5.0, 10000, 1.0, ""], [5.0, 14600, 1.0, ""], [5.0, 19000, 1.0, falls]]
  # Time that falls behind, which is counted anew then.
  - - [4.9, 0, 1.0, ""]
    - - 0.1
      - 2500
      - 1.0
      - "simulated time falls behind: real-time factor 0.50 instead of 1 in the last 5 s"
    - [5.0, 7500, 1.0, ""]
    - [6.0, 16500, 2.0, 1.50 instead of 2 in the last 6 s]
  # As fast as it goes is never too slow.
  - [[5.0, 1, 0.0, ""]]
""")
def test_what_is_said_of_the_speed(clock, watch, story):
    for seconds, step, wanted, said in story:
        clock.now += seconds
        found = watch.lag(step, wanted)
        assert said in found
        assert bool(found) == bool(said)


def test_a_machine_that_stays_too_slow_is_told_of_less_and_less_often(clock, watch):
    told = []
    for second in range(5, 400, 5):
        clock.now += 5.0
        if watch.lag(second, 1.0):
            told.append(second)
    assert told == [5, 10, 20, 40, 80, 160, 240, 320]
    # Once it is fast enough, it begins anew.
    for step, slow in ((100_000, False), (100_001, True)):
        clock.now += 5.0
        assert bool(watch.lag(step, 1.0)) == slow


@cases("""
story:
  # Whom the gate waits for, and what happens then: each time the step up to which time may go on,
  # and who holds it back.
  - - []
    - [leave nobody, .inf, []]
  - - [b, a]
    - [grant b 100, -.inf, [a]]
    - [grant a 50, 50, [a]]
  - - [a]
    - [grant a 50, 50, [a]]
    - [grant b 20, 20, [b]]
    - [grant c 20, 20, [b, c]]
    - [grant b 70, 20, [c]]
    - [grant c 80, 50, [a]]
  - - [a, b]
    - [grant a 50, -.inf, [b]]
    - [leave b, 50, [a]]
    - [grant a inf, .inf, []]
    - [leave a, .inf, []]
  # A restart takes grants back, but not those for ever.
  - - [late]
    - [grant a 500, -.inf, [late]]
    - [grant b inf, -.inf, [late]]
    - [restart, -.inf, [late]]
    - [grant late 100, 0, [a]]
    - [leave a, 100, [late]]
""")
def test_time_goes_on_as_far_as_each_member_has_granted(story):
    expected, *events = story
    gate = TimeGate(expected)
    for words, limit, holding in events:
        do, *member = words.split()
        if do == "grant":
            gate.grant(member[0], float(member[1]))
        else:
            getattr(gate, do)(*member)
        assert (gate.limit(), gate.holding()) == (limit, tuple(holding)), words
