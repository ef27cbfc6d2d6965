"""Controllers of joint trajectories, as ros_controllers' joint_trajectory_controller has them."""

from __future__ import annotations

import logging
import math
from itertools import chain
from typing import Iterable, NamedTuple, Sequence

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters, actions
from bullet_lab.simulation.plugins.controllers.controller import is_due
from bullet_lab.simulation.plugins.controllers.joints import EFFORT, POSITION, VELOCITY, Pid
from bullet_lab.simulation.plugins.samples import (
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectorySample,
    is_sound,
)

LOG = logging.getLogger(__name__)

# Error codes of control_msgs/FollowJointTrajectoryResult.
INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, OFF_PATH, OFF_GOAL = -1, -2, -3, -4, -5


class TrajectoryError(ControlError):
    """A trajectory is refused, with an error code."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


def spline(one: Sequence[float | None], two: Sequence[float | None], t: float) -> tuple[float, ...]:
    """Return the coefficients of a polynomial from a state to one that is `t` seconds later.

    A state is a position, a velocity and an acceleration; the last two may be None. The polynomial
    is linear without velocities, cubic without accelerations, and quintic otherwise.

    >>> spline((0.0, None, None), (1.0, None, None), 2.0)
    (0.0, 0.5)
    """
    (p, v, a), (q, w, b) = one, two
    d = q - p
    if t <= 0.0:
        return (q,)
    if v is None or w is None:
        return p, d / t
    v, w = v * t, w * t
    if a is None or b is None:
        return p, v / t, (3.0 * d - 2.0 * v - w) / t**2, (v + w - 2.0 * d) / t**3
    a, b = 0.5 * a * t * t, 0.5 * b * t * t
    third = 10.0 * d - 6.0 * v - 4.0 * w - 3.0 * a + b
    fourth = -15.0 * d + 8.0 * v + 7.0 * w + 3.0 * a - 2.0 * b
    fifth = 6.0 * d - 3.0 * v - 3.0 * w - a + b
    return p, v / t, a / t**2, third / t**3, fourth / t**4, fifth / t**5


class Segment(NamedTuple):
    """A part of a joint's path, from `start` to `end` in s; its trajectory starts at `origin`."""

    start: float
    end: float
    coefficients: tuple[float, ...]
    origin: float

    def at(self, time: float) -> tuple[float, float, float]:
        """Return the state at a time; before and after the segment, the joint stands still."""
        t = min(max(time - self.start, 0.0), self.end - self.start)
        p = v = a = 0.0
        for coefficient in reversed(self.coefficients):
            p, v, a = p * t + coefficient, v * t + p, a * t + 2.0 * v
        return (p, v, a) if t == time - self.start else (p, 0.0, 0.0)


def segment_at(path: Sequence[Segment], time: float) -> Segment:
    """Return the segment of a time, or the first one if it begins later."""
    return next((one for one in reversed(path) if one.start <= time), path[0])


class JointTrajectory(actions.ActionController):
    """Moves joints along trajectories, from the action or the topic `command`."""

    kinds = {
        "position_controllers/JointTrajectoryController": POSITION,
        "velocity_controllers/JointTrajectoryController": VELOCITY,
        "effort_controllers/JointTrajectoryController": EFFORT,
    }
    action = "follow_joint_trajectory"

    def configure(self, given: ControlParameters) -> None:
        super().configure(given)
        self._names = given.required_names("joints")
        self.joints = self.find_joints(self._names)
        self._partial = given.get("allow_partial_joints_goal", False)
        self._stop_seconds = max(0.0, given.get("stop_trajectory_duration", 0.0))
        limits = given.below("constraints")
        slowest = limits.get("stopped_velocity_tolerance", 0.01)
        self._goal_time = limits.get("goal_time", 0.0)
        # The greatest errors of position and velocity by joint, on the path and at its end; 0: any.
        self._tolerances = {}
        for name in self._names:
            self._tolerances[name, "path"] = (limits.get(f"{name}/trajectory", 0.0), 0.0)
            self._tolerances[name, "goal"] = (limits.get(f"{name}/goal", 0.0), slowest)
        by_pid = () if self.interface == POSITION else self._names
        self._pids = [Pid(given.below(f"gains/{name}")) for name in by_pid]
        self._forward = [given.get(f"velocity_ff/{name}", 0.0) for name in self._names]
        self._publishing = self.schedule(given, "state_publish_rate", 50.0)
        self.states = self.output("state", TrajectorySample)
        self.input("command", Trajectory, self.command)
        self.queries = {"query_state": self.query}

    def starting(self, step: int) -> None:
        self._desired = [(joint.position, joint.velocity, 0.0) for joint in self.joints]
        for pid in self._pids:
            pid.reset()
        super().starting(step)

    def command(self, trajectory: Trajectory) -> None:
        """Follow a trajectory, or hold the joints if it is empty; raises ControlError."""
        if not trajectory.points and not trajectory.joints:
            self.post(self._stop, None)
            return
        self._check(trajectory)
        self.take(TrajectoryGoal(trajectory, {}, {}, 0.0))

    def query(self, time: float) -> tuple[tuple[str, ...], TrajectoryPoint]:
        """Return the joints and their states at a simulated time in s; raises ControlError."""
        if not self.running or time < self._paths[0][0].start:
            raise ControlError(f"controller '{self.name}' has no trajectory at {time:.3f} s")
        return self._names, _point(0.0, (segment_at(path, time).at(time) for path in self._paths))

    def begin(self, content: TrajectoryGoal, step: int) -> None:
        self._check(content.trajectory)
        if not content.trajectory.points:
            self.hold(step)
            return
        self._follow(content.trajectory, step)
        self._patience = content.seconds or self._goal_time
        for (name, where), usual in self._tolerances.items():
            # 0 stands for the usual bound; a negative one is none.
            asked = getattr(content, where).get(name, usual)
            self._bounds[name, where] = tuple(a or kept for a, kept in zip(asked, usual))

    def refusal(self, error: ControlError) -> tuple[int, str]:
        return getattr(error, "code", INVALID_GOAL), str(error)

    def hold(self, step: int) -> None:
        """Stop within stop_trajectory_duration, or where the joints are."""
        now, span = step / STEPS_PER_SECOND, self._stop_seconds
        # What each joint follows, in the order of time; there is always a segment.
        self._paths: list[list[Segment]] = []
        # Tolerances of the active goal, and when they begin to hold.
        self._bounds: dict[tuple[str, str], Sequence[float]] = {}
        self._since = now
        for joint, (position, velocity, _) in zip(self.joints, self._desired):
            parts: tuple[float, ...] = (joint.position,)
            if span:
                # Half of a path that comes back with the opposite velocity.
                start, back = (position, velocity, 0.0), (position, -velocity, 0.0)
                turn = Segment(now, now + 2.0 * span, spline(start, back, 2.0 * span), now)
                parts = spline(start, turn.at(now + span), span)
            self._paths.append([Segment(now, now + span, parts, now)])

    def control(self, step: int, seconds: float) -> None:
        now = step / STEPS_PER_SECOND
        self._desired, self._errors = [], []
        for number, (joint, path) in enumerate(zip(self.joints, self._paths)):
            while len(path) > 1 and path[1].start <= now:
                del path[0]
            target, speed, _ = state = path[0].at(now)
            error, slope = target - joint.position, speed - joint.velocity
            self._desired.append(state)
            self._errors.append((error, slope))
            joint.command = target
            if self._pids:
                correction = self._pids[number].command(error, seconds, slope)
                joint.command = self._forward[number] * speed + correction
        if self.goal is not None and now >= self._since:
            self._judge(now)
        if is_due(self._publishing, step) and self.states.wanted:
            self.states.send(self.feedback(step))

    def feedback(self, step: int) -> TrajectorySample:
        since = step / STEPS_PER_SECOND - self._paths[0][0].origin
        actual = [(joint.position, joint.velocity) for joint in self.joints]
        states = (self._desired, actual, self._errors)
        return TrajectorySample(step, self._names, *(_point(since, state) for state in states))

    def _stop(self, _: None, step: int) -> None:
        self.end(actions.CANCELED)
        self.hold(step)

    def _check(self, trajectory: Trajectory) -> None:
        """Raise TrajectoryError for a trajectory that these joints can never follow."""
        names, points = trajectory.joints, trajectory.points
        given, known = set(names), set(self._names)
        is_enough = bool(given) if self._partial else given == known
        if not is_enough or given - known or len(given) < len(names):
            said = f"it names {', '.join(names) or 'no joints'}"
            raise TrajectoryError(INVALID_JOINTS, f"{said}; needed are {', '.join(self._names)}")
        before = -math.inf
        for number, point in enumerate(points, start=1):
            problem = ""
            lists = (point.positions, point.velocities, point.accelerations)
            counts = [len(one) for one in lists]
            if not counts[0] or set(counts) - {0, len(names)}:
                said = "/".join(map(str, counts))
                problem = f" has {said} positions/velocities/accelerations for {len(names)} joints"
            elif not is_sound(*chain(*lists)):
                problem = " is not finite, or too large"
            elif point.seconds <= before:
                problem = f": {point.seconds:g} s comes after {before:g} s; times must increase"
            if problem:
                raise TrajectoryError(INVALID_GOAL, f"point {number} of {len(points)}{problem}")
            before = point.seconds

    def _follow(self, trajectory: Trajectory, step: int) -> None:
        """Follow a valid trajectory from now on; raises TrajectoryError if all of it is past."""
        now = step / STEPS_PER_SECOND
        origin = trajectory.start or now
        points = [one for one in trajectory.points if origin + one.seconds > now]
        gone = len(trajectory.points) - len(points)
        if not points:
            late = now - origin - trajectory.points[-1].seconds
            code = OLD_STAMP if trajectory.start else INVALID_GOAL
            what = "the last stamp + time_from_start"
            raise TrajectoryError(code, f"all points are past: {what} was {late:.3f} s ago")
        # Without a stamp, the first point may be where the joints are.
        if gone > 1 or (gone and trajectory.start):
            LOG.warning("controller '%s': points in the past are ignored: %d", self.name, gone)
        self._since = max(now, origin)
        for column, name in enumerate(trajectory.joints):
            number, start = self._names.index(name), self._since
            last: Sequence[float | None] = segment_at(self._paths[number], start).at(start)
            made = [one for one in self._paths[number] if one.start <= start]
            shift, first = 0.0, points[0].positions[column]
            if self.joints[number].described.kind == "continuous":
                shift = last[0] + math.remainder(first - last[0], math.tau) - first
            for point in points:
                others = (point.velocities, point.accelerations)
                position = point.positions[column] + shift
                state = (position, *(one[column] if one else None for one in others))
                end = origin + point.seconds
                made.append(Segment(start, end, spline(last, state, end - start), origin))
                start, last = end, state
            self._paths[number] = made

    def _judge(self, now: float) -> None:
        """End the goal if a tolerance is violated, or if all joints have arrived."""
        is_done = True
        for name, path, errors in zip(self._names, self._paths, self._errors):
            is_over = len(path) == 1 and now >= path[0].end
            where, code = ("goal", OFF_GOAL) if is_over else ("path", OFF_PATH)
            problem = _violation(errors, self._bounds.get((name, where), ()), where)
            if problem and not (is_over and now < path[0].end + self._patience):
                text = f"joint '{name}': {problem}"
                self.end(actions.ABORTED, (code, text), text)
                return
            is_done = is_done and is_over and not problem
        if is_done:
            self.end(actions.SUCCEEDED, (0, ""))


def _point(seconds: float, states: Iterable[Sequence[float]]) -> TrajectoryPoint:
    return TrajectoryPoint(seconds, *zip(*states))


def _violation(errors: Sequence[float], bounds: Sequence[float], where: str) -> str:
    """Return which error exceeds its bound, or an empty text."""
    for kind, error, most in zip(("position", "velocity"), errors, bounds):
        if 0.0 < most < abs(error):
            return f"{where} error in {kind} is {error:.4g}; allowed are {most:g}"
    return ""
