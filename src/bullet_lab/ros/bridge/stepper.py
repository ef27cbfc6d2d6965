"""The loop that advances a simulation, and the threads that want something of it. No rospy.

PyBullet wants all calls from one thread: the one that calls `Stepper.run`. Others hand it what
they want done, and wait.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from concurrent import futures
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Callable, Deque, NamedTuple, Optional, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.timing import FOR_EVER, WAITING, Lag, LoopWatch, Pace, TimeGate
from bullet_lab.simulation.simulation import Simulation

# Between two looks at what others want, at most: of small worlds, two milliseconds of wall time.
STEPS_AT_A_TIME = 200
# Wall seconds that a stride may take where its steps can be fewer: worlds may be slow.
LONGEST_STRIDE = 0.1
# Strides by which a command brings time to its own moment, at most.
MOST_TO_CATCH_UP = 5
# Longest wait before looking whether all has ended, in wall seconds.
LONGEST_WAIT = 0.2
# Wall seconds after which it is reported who holds time back.
PATIENCE = 2.0


class StepperError(LabError):
    """The simulation ends before it has done what was asked."""


class Reached(NamedTuple):
    """What became of a grant: whether time has come there, and the step and epoch it is at."""

    success: bool
    step: int
    epoch: int


@dataclass
class _Advance:
    """Steps that somebody asked for: how many are left, and the step that they led to."""

    steps: int
    reached: futures.Future = field(default_factory=futures.Future)


class Stepper:
    """Advances a simulation as the wall clock, the lock step and pauses allow.

    Args:
        simulation: what to advance.
        pace: how it follows the wall clock.
        gate: how far the members of the lock step let it go.
        tick: steps between two wake-ups while time follows the wall clock.
        paused: whether to start so.
        is_over: says whether to end.
        report_stall: called with the names of those who hold time back, every `PATIENCE`.
        after_steps: called when steps have been made, before anybody is told of them.
        report_lag: called when time does not hold its speed, every few seconds.
        watch: notices that.

    Attributes:
        paused: whether time stands still.
        epoch: one more than there were resets, of the world or of time.
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
        after_steps: Callable[[], None],
        report_lag: Callable[[Lag], None] = lambda _: None,
        watch: Optional[LoopWatch] = None,
    ):
        self.simulation, self.pace, self.gate = simulation, pace, gate
        self._tick, self.paused = tick, paused
        self._advances: Deque[_Advance] = deque()
        self._is_over, self._after_steps = is_over, after_steps
        self._report_stall, self._report_lag = report_stall, report_lag
        self.watch = watch or LoopWatch()
        self._reached = simulation.step
        self._stride = STEPS_AT_A_TIME
        self._stalled_since: Optional[float] = None
        self._tasks: queue.Queue[Tuple[futures.Future, Callable[[], Any]]] = queue.Queue()
        self._wake = threading.Condition()
        self._wakeups = 0
        self.epoch = 1

    @property
    def hurried(self) -> bool:
        """Whether steps are made faster than the wall clock has it, and nothing may be lost."""
        return self.pace.free or bool(self._advances)

    def run(self) -> None:
        """Advance until all is over; to be called by one thread, once."""
        self._restart(self.simulation.step)
        try:
            while not self._is_over():
                # Read before anything is looked at: what changes from here on cuts waits short.
                wakeups = self._wakeups
                self._run_tasks()
                self._go_on(wakeups)
        finally:
            self.wake()

    # For other threads

    def wake(self) -> None:
        """Have the loop look at once at what has changed."""
        with self._wake:
            self._wakeups += 1
            self._wake.notify_all()

    def do(self, action: Callable[[], Any]) -> Any:
        """Have something done between two steps; return what it returns, raise what it raises.

        Raises StepperError if all is over before it could be done.
        """
        result: futures.Future = futures.Future()
        self._tasks.put((result, action))
        self.wake()
        return self._result_of(result)

    def do_now(self, action: Callable[[], None]) -> None:
        """Have something done at the present moment of wall time.

        Tied to the wall clock, simulated time sleeps between ticks; it is first brought to this
        moment. At full speed there is no such moment, and the action is done at once.
        """

        def catch_up_and_act() -> None:
            step, limit = self.simulation.step, self.gate.limit()
            if not self.paused and limit is not None:
                # At a speed that nothing keeps up with, the moment is years away.
                most = MOST_TO_CATCH_UP * self._stride
                self._run_until(min(limit, self.pace.due(step), step + most))
            action()

        if self.pace.free:
            action()
        else:
            self.do(catch_up_and_act)

    def pause(self) -> None:
        """Stop time, and end what `advance_by` has begun."""
        self.do(partial(self._set_paused, True))

    def unpause(self) -> None:
        """Let time go on."""
        self.do(partial(self._set_paused, False))

    def set_real_time_factor(self, factor: float) -> None:
        """Let time go at another speed: simulated seconds per wall second, 0 for full speed."""

        def change() -> None:
            self.pace.real_time_factor = factor
            self._restart(self.simulation.step)

        self.do(change)

    def advance_by(self, steps: int) -> int:
        """Advance by exactly so many steps, paused or not, and return the step reached.

        Others are served between batches of steps. Raises StepperError where time is stopped, or
        all is over, before that.
        """
        advance = _Advance(steps)
        self.do(partial(self._advances.append, advance))
        return self._result_of(advance.reached)

    def reset_world(self) -> None:
        """Put all models back; time goes on."""
        self.do(partial(self._reset, self.simulation.reset_world))

    def reset_simulation(self) -> None:
        """Put all models back and start time again at 0."""
        self.do(partial(self._reset, self.simulation.reset_simulation))

    def join(self, member: str) -> Reached:
        """Have time stand until a member grants more, and return when it stands."""
        while True:
            answer = self.grant(member, 0, self.epoch)
            # A reset may have come in between.
            if answer.success or self._is_over():
                return answer

    def grant(self, member: str, step: float, epoch: int) -> Reached:
        """Let time go on to a step, for all that a member cares, and wait until it is there.

        It is refused, or ends early, where the world or time was reset since the epoch that the
        member knows of, and where all is over. A grant for ever holds in every epoch and
        returns at once.
        """
        with self._wake:
            if step != FOR_EVER and epoch != self.epoch:
                return self._reached_in(epoch, step)
            self.gate.grant(member, step)
            self.wake()
        if step == FOR_EVER:
            return Reached(True, self._reached, self.epoch)
        if step <= self._reached:
            # The loop may be in the middle of a stride, and time stands only at the end of it.
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
        reached = self._reached >= step and self.epoch == epoch
        return Reached(reached, self._reached, self.epoch)

    # The loop

    def _go_on(self, wakeups: int) -> None:
        """Advance as far as is due and allowed, or wait for more than so many wake-ups."""
        if self._advances:
            self._advance()
            return
        step = self.simulation.step
        limit = -1 if self.paused else self.gate.limit()
        if limit is None or limit <= step:
            if limit is None:
                self._restart(step)
            self.pace.restart(step)
            self._watch_the_stall()
            with self.watch.doing(f"waiting for {' and '.join(self.gate.holding())}"):
                self._wait(LONGEST_WAIT, wakeups)
            return
        self._stalled_since = None
        due = self.pace.due(step)
        if due <= step:
            wait = self.pace.seconds_until(step + self._tick)
            with self.watch.doing(WAITING):
                self._wait(min(LONGEST_WAIT, wait), wakeups)
            due = self.pace.due(step)
        self._run_until(min(limit, due, step + self._stride))
        self._watch_the_speed()
        if limit != FOR_EVER:
            with self._wake:
                self._wake.notify_all()

    def _run_until(self, step: float) -> None:
        before, start = self.simulation.step, time.perf_counter()
        with self.watch.doing("steps"):
            self.simulation.run_until(int(max(before, step)))
        with self.watch.doing("handing messages to subscribers"):
            self._after_steps()
        self._reached = self.simulation.step
        if self._reached > before:
            self._adapt_stride(self._reached - before, time.perf_counter() - start)

    def _adapt_stride(self, steps: int, seconds: float) -> None:
        """Bound the next stride by the time that this one took; it grows to twice its length."""
        fit = steps * LONGEST_STRIDE / max(seconds, 1e-9)
        self._stride = int(max(1, min(STEPS_AT_A_TIME, 2 * self._stride, fit)))

    def _wait(self, seconds: float, wakeups: int) -> None:
        with self._wake:
            if self._wakeups == wakeups and not self._is_over():
                self._wake.wait(seconds)

    def _run_tasks(self) -> None:
        # Those that are there now: steps are made however fast others ask for more.
        for _ in range(self._tasks.qsize()):
            result, action = self._tasks.get()
            with self.watch.doing("services"):
                try:
                    result.set_result(action())
                except Exception as error:
                    # It goes back to whoever asked, and time goes on for the others.
                    result.set_exception(error)

    def _set_paused(self, paused: bool) -> None:
        self.paused = paused
        while paused and self._advances:
            advance = self._advances.popleft()
            left = f"time was stopped with {advance.steps} steps to go"
            advance.reached.set_exception(StepperError(left))
        self._restart(self.simulation.step)

    def _advance(self) -> None:
        """Make a batch of the steps that were asked for, by whoever waits the longest."""
        advance = self._advances[0]
        batch = min(advance.steps, self._stride)
        self._run_until(self.simulation.step + batch)
        advance.steps -= batch
        self._advances.rotate(-1)
        if not advance.steps:
            self._advances.pop()
            self._restart(self.simulation.step)
            advance.reached.set_result(self.simulation.step)

    def _reset(self, reset: Callable[[], None]) -> None:
        """Reset, and take back what members have granted: they know nothing of it."""
        before = self.simulation.step
        reset()
        if self.simulation.step != before:
            self._restart(self.simulation.step)
        with self._wake:
            self._reached = self.simulation.step
            self.gate.restart(self._reached)
            self.epoch += 1
            self._wake.notify_all()

    def _restart(self, step: int) -> None:
        """Let speed be measured from now on, with time at a step."""
        self.pace.restart(step)
        self.watch.restart(step)
        self.simulation.take_spent()

    def _watch_the_speed(self) -> None:
        if not self.watch.due:
            return
        for what, seconds in self.simulation.take_spent().items():
            self.watch.spend(what, seconds)
            self.watch.spend("steps", -seconds)
        lag = self.watch.look(self.simulation.step, self.pace.real_time_factor)
        if lag is not None:
            self._report_lag(lag)

    def _watch_the_stall(self) -> None:
        now = time.monotonic()
        if self.paused or self._stalled_since is None:
            self._stalled_since = now
        elif now - self._stalled_since >= PATIENCE:
            self._stalled_since = now
            # One report is enough.
            self._restart(self.simulation.step)
            self._report_stall(self.gate.holding())
