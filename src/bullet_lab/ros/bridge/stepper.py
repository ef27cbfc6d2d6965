"""The loop that advances a simulation, and requests of other threads to it. No rospy.

One thread makes all calls of PyBullet: the one that calls `Stepper.run`. Other threads pass their
actions to it and wait.

Simulated time advances as the wall clock (`Pace`) and the lock step (`TimeGate`) allow. The lock
step is the conservative scheme of distributed simulation (Chandy and Misra 1979; "time advance
request" in the High Level Architecture): time never exceeds what each member has granted, so no
member ever sees a world that ran ahead of it, whatever the speed of the machine.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections import deque
from concurrent import futures
from typing import Any, Callable, Iterable, NamedTuple, Sequence

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.errors import LabError
from bullet_lab.simulation.simulation import Simulation

# Largest number of steps of a stride, after which requests are served; 2 ms in a small world.
STEPS_AT_A_TIME = 200
# Wall seconds of a stride of more than one step, at most.
LONGEST_STRIDE = 0.1
# Strides before a command is executed, at most.
MOST_TO_CATCH_UP = 5
# Wall seconds between two checks whether the loop has ended, at most.
LONGEST_WAIT = 0.2
# Wall seconds between two reports of the members that hold time back.
PATIENCE = 2.0
FOR_EVER = math.inf
# The grant of a member that has not joined yet.
NOT_YET = -math.inf
# A longer delay of simulated time, in wall seconds, is not made up for.
FORGIVEN_SECONDS = 0.1
# Wall seconds over which the speed is measured.
WINDOW = 5.0
# Longest wall time between two reports of a machine that stays too slow; the time doubles.
LONGEST_SILENCE = 80.0
# A smaller share of the wanted speed is too slow.
TOLERATED = 0.9
# Steps per wall second; no machine is faster.
FASTEST = 1e12


class Pace:
    """Computes which step is due now; a real-time factor of 0 means full speed."""

    def __init__(self, real_time_factor: float, clock: Callable[[], float] = time.monotonic):
        self.real_time_factor = real_time_factor
        self.clock = clock
        self.restart(0)

    @property
    def free(self) -> bool:
        """Whether time is not tied to the wall clock."""
        return self.real_time_factor == 0.0

    def restart(self, step: int) -> None:
        """Let a step be due now: after a pause, a stall or a reset."""
        self._start_step, self._start = step, self.clock()

    def due(self, step: int) -> float:
        """Return the step that is due now, given that simulated time is at `step`.

        A simulation that cannot keep up continues from `step` without making up for the delay.
        """
        if self.free:
            return math.inf
        due = math.floor(self._start_step + self._rate * (self.clock() - self._start))
        # At a very slow speed, a delay of one step is longer than FORGIVEN_SECONDS.
        if due - step > max(1.0, FORGIVEN_SECONDS * self._rate):
            self.restart(step)
            return step + 1
        return due

    def seconds_until(self, step: int) -> float:
        """Return the wall seconds until a step is due; 0 if it is overdue."""
        if self.free:
            return 0.0
        wait = (step - self._start_step) / self._rate - (self.clock() - self._start)
        return max(0.0, wait)

    @property
    def _rate(self) -> float:
        return min(self.real_time_factor * STEPS_PER_SECOND, FASTEST)


class SpeedWatch:
    """Measures the speed of simulated time over `WINDOW`, and reports one that is too slow."""

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self._silence, self._reported = WINDOW, -math.inf
        self.restart(0)

    def restart(self, step: int) -> None:
        """Start a new measurement, with simulated time at a step: after a pause or a reset."""
        self._step, self._start = step, self._clock()

    def lag(self, step: int, wanted: float) -> str:
        """Return a line if simulated time, now at a step, is too slow.

        Empty if it is not, if that was reported a short while ago, or before the measurement ends.
        `wanted` is the real-time factor; 0 for full speed.
        """
        now = self._clock()
        seconds = now - self._start
        if seconds < WINDOW:
            return ""
        reached = (step - self._step) / STEPS_PER_SECOND / seconds
        self.restart(step)
        if reached >= TOLERATED * wanted:
            self._silence, self._reported = WINDOW, -math.inf
            return ""
        if now - self._reported < self._silence:
            return ""
        if self._reported > -math.inf:
            self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._reported = now
        return (
            f"simulated time falls behind: real-time factor {reached:.2f} instead of {wanted:g} "
            f"in the last {seconds:.0f} s"
        )


class TimeGate:
    """Keeps the grants of the lock step's members; time starts when all `expected` have joined."""

    def __init__(self, expected: Iterable[str]):
        self._granted: dict[str, float] = dict.fromkeys(expected, NOT_YET)
        self._lock = threading.Lock()

    def grant(self, member: str, step: float) -> None:
        """Set the step up to which a member lets time advance; a new member joins."""
        with self._lock:
            self._granted[member] = step

    def leave(self, member: str) -> None:
        """Remove a member."""
        with self._lock:
            self._granted.pop(member, None)

    def has_joined(self, member: str) -> bool:
        """Return whether a member has joined and has not left."""
        return self._granted.get(member, NOT_YET) != NOT_YET

    def limit(self) -> float:
        """Return the step up to which time may advance; NOT_YET while members are missing."""
        with self._lock:
            return min(self._granted.values(), default=FOR_EVER)

    def holding(self) -> tuple[str, ...]:
        """Return the members that hold time back: the missing ones, or those of the least grant."""
        with self._lock:
            least = min(self._granted.values(), default=FOR_EVER)
            late = (member for member, step in self._granted.items() if step == least != FOR_EVER)
            return tuple(sorted(late))

    def restart(self, step: int = 0) -> None:
        """Reduce all grants to a step, except for those without an end."""
        with self._lock:
            for member, granted in self._granted.items():
                if granted != FOR_EVER:
                    self._granted[member] = min(step, granted)


class StepperError(LabError):
    """The simulation was stopped or ended before a request was done."""


class Reached(NamedTuple):
    """The result of a grant: whether time has reached it, and the present step and epoch."""

    success: bool
    step: int
    epoch: int


class Stepper:
    """Advances a simulation as the wall clock, the lock step and pauses allow.

    Args:
        tick: steps between two wake-ups while time follows the wall clock.
        is_over: returns whether to end the loop.
        report_stall: called with the names of the members that hold time back.
        report_lag: called with a line when simulated time is too slow.

    Attributes:
        after_steps: called after each stride, before waiting threads see its end.
        paused: whether time is paused.
        epoch: 1 plus the number of resets, of the world or of time.
    """

    def __init__(
        self,
        simulation: Simulation,
        pace: Pace,
        gate: TimeGate,
        tick: int,
        paused: bool,
        is_over: Callable[[], bool],
        report_stall: Callable[[Sequence[str]], None],
        report_lag: Callable[[str], None],
    ):
        self.simulation, self.pace, self.gate = simulation, pace, gate
        self.after_steps: Callable[[], None] = lambda: None
        self._tick, self.paused = tick, paused
        # Requests for steps: how many are left, and the future with the step reached.
        self._advances: deque[tuple[int, futures.Future]] = deque()
        self._is_over, self._report_stall, self._report_lag = is_over, report_stall, report_lag
        self._watch = SpeedWatch(pace.clock)
        self._reached = simulation.step
        self._stride = STEPS_AT_A_TIME
        self._stalled_since: float | None = None
        self._tasks: queue.Queue[tuple[futures.Future, Callable[[], Any]]] = queue.Queue()
        self._wake = threading.Condition()
        self._wakeups = 0
        self.epoch = 1

    @property
    def lossless(self) -> bool:
        """Whether messages must not be lost: time does not follow the wall clock at present."""
        return self.pace.free or bool(self._advances)

    def run(self) -> None:
        """Run the loop until the end; to be called once, by one thread."""
        self._restart()
        try:
            while not self._is_over():
                # Read first: any later change ends the waiting below.
                wakeups = self._wakeups
                self._run_tasks()
                self._go_on(wakeups)
        finally:
            self.wake()

    # For other threads

    def wake(self) -> None:
        """End the loop's waiting after a change."""
        with self._wake:
            self._wakeups += 1
            self._wake.notify_all()

    def do(self, action: Callable[[], Any]) -> Any:
        """Run an action in the loop between two steps; return or raise what it does.

        Raises StepperError if the simulation ends before.
        """
        result: futures.Future = futures.Future()
        self._tasks.put((result, action))
        self.wake()
        return self._result_of(result)

    def do_now(self, action: Callable[[], None]) -> None:
        """Run an action at the present moment of wall time.

        Tied to the wall clock, the loop sleeps between ticks; simulated time first advances to
        this moment. At full speed, the action is run at once.
        """

        def catch_up_and_act() -> None:
            if not self.paused:
                step = self.simulation.step
                # At a very high real-time factor, the moment may be years away.
                most = step + MOST_TO_CATCH_UP * self._stride
                self._run_until(min(self.gate.limit(), self.pace.due(step), most))
            action()

        if self.pace.free:
            action()
        else:
            self.do(catch_up_and_act)

    def set_paused(self, paused: bool) -> None:
        """Pause time, which ends the calls of `advance_by` with an error, or let it advance."""

        def change() -> None:
            self.paused = paused
            while paused and self._advances:
                steps, reached = self._advances.popleft()
                reached.set_exception(StepperError(f"paused with {steps} steps to go"))
            self._restart()

        self.do(change)

    def set_real_time_factor(self, factor: float) -> None:
        """Set the simulated seconds per wall second; 0 for full speed."""

        def change() -> None:
            self.pace.real_time_factor = factor
            self._restart()

        self.do(change)

    def advance_by(self, steps: int) -> int:
        """Advance by exactly so many steps, paused or not, and return the step reached.

        Other requests are served in between. Raises StepperError if time is paused, or the
        simulation ends, before.
        """
        reached: futures.Future = futures.Future()
        self.do(lambda: self._advances.append((steps, reached)))
        return self._result_of(reached)

    def reset(self, reset: Callable[[], None]) -> None:
        """Reset all models, or also time, and revoke the grants of members.

        They do not know of the reset yet.
        """

        def change() -> None:
            before = self.simulation.step
            reset()
            if self.simulation.step != before:
                self._restart()
            with self._wake:
                self._reached = self.simulation.step
                self.gate.restart(self._reached)
                self.epoch += 1
                self._wake.notify_all()

        self.do(change)

    def join(self, member: str) -> Reached:
        """Hold time for a new member, and return when it is held."""
        while True:
            answer = self.grant(member, 0, self.epoch)
            # A reset may have changed the epoch in between.
            if answer.success or self._is_over():
                return answer

    def grant(self, member: str, step: float, epoch: int) -> Reached:
        """Let time advance to a step as far as a member is concerned, and wait until it has.

        Without success if the world or time was reset since the member's epoch, or the simulation
        ends. A grant without an end is valid in every epoch and returns at once.
        """
        with self._wake:
            if step != FOR_EVER and epoch != self.epoch:
                return self._reached_in(epoch, step)
            self.gate.grant(member, step)
            self.wake()
        if step == FOR_EVER:
            return Reached(True, self._reached, self.epoch)
        if step <= self._reached:
            # Time is held from the end of the present stride on.
            self.do(lambda: None)
        with self._wake:
            while self._reached < step and self.epoch == epoch and not self._is_over():
                self._wake.wait(LONGEST_WAIT)
            return self._reached_in(epoch, step)

    def _result_of(self, future: futures.Future) -> Any:
        while not futures.wait([future], LONGEST_WAIT).done:
            if self._is_over():
                raise StepperError("the simulation has ended")
        return future.result()

    def _reached_in(self, epoch: int, step: float) -> Reached:
        success = self._reached >= step and self.epoch == epoch
        return Reached(success, self._reached, self.epoch)

    # The loop

    def _go_on(self, wakeups: int) -> None:
        """Advance as far as is due and allowed, or wait for a wake-up after the first `wakeups`."""
        if self._advances:
            self._advance()
            return
        step = self.simulation.step
        limit = -1 if self.paused else self.gate.limit()
        if limit <= step:
            if limit == NOT_YET:
                self._restart()
            self.pace.restart(step)
            self._watch_the_stall()
            self._wait(LONGEST_WAIT, wakeups)
            return
        self._stalled_since = None
        due = self.pace.due(step)
        if due <= step:
            wait = self.pace.seconds_until(step + self._tick)
            self._wait(min(LONGEST_WAIT, wait), wakeups)
            due = self.pace.due(step)
        self._run_until(min(limit, due, step + self._stride))
        lag = self._watch.lag(self.simulation.step, self.pace.real_time_factor)
        if lag:
            self._report_lag(lag)
        if limit != FOR_EVER:
            with self._wake:
                self._wake.notify_all()

    def _run_until(self, step: float) -> None:
        before, start = self.simulation.step, time.perf_counter()
        self.simulation.run_until(int(max(before, step)))
        self.after_steps()
        self._reached = self.simulation.step
        if self._reached > before:
            # The next stride has a length that fits the wall time of this one, at most twice its.
            seconds = max(time.perf_counter() - start, 1e-9)
            fit = (self._reached - before) * LONGEST_STRIDE / seconds
            self._stride = int(max(1, min(STEPS_AT_A_TIME, 2 * self._stride, fit)))

    def _wait(self, seconds: float, wakeups: int) -> None:
        with self._wake:
            if self._wakeups == wakeups and not self._is_over():
                self._wake.wait(seconds)

    def _run_tasks(self) -> None:
        # Only the present ones: steps are made however many new tasks come.
        for _ in range(self._tasks.qsize()):
            result, action = self._tasks.get()
            try:
                result.set_result(action())
            except Exception as error:
                # The requesting thread raises it.
                result.set_exception(error)

    def _advance(self) -> None:
        """Make some steps of the oldest request for steps, and put it at the end of the queue."""
        steps, reached = self._advances[0]
        batch = min(steps, self._stride)
        self._run_until(self.simulation.step + batch)
        self._advances.popleft()
        if batch < steps:
            self._advances.append((steps - batch, reached))
        else:
            self._restart()
            reached.set_result(self.simulation.step)

    def _restart(self) -> None:
        """Measure the speed from now on."""
        self.pace.restart(self.simulation.step)
        self._watch.restart(self.simulation.step)

    def _watch_the_stall(self) -> None:
        now = time.monotonic()
        if self.paused or self._stalled_since is None:
            self._stalled_since = now
        elif now - self._stalled_since >= PATIENCE:
            self._stalled_since = now
            # The stall is reported here; it does not count as a lag.
            self._restart()
            self._report_stall(self.gate.holding())
