"""Controllers of joint trajectories, as ros_controllers' joint_trajectory_controller has them."""

from __future__ import annotations

import logging
import math
from itertools import chain
from typing import List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from bullet_lab.core.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.simulation.plugins import Input, Output
from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.actions import (
    ABORTED,
    PREEMPTED,
    SUCCEEDED,
    ActionController,
)
from bullet_lab.simulation.plugins.controllers.controller import is_due
from bullet_lab.simulation.plugins.controllers.joints import (
    EFFORT,
    POSITION,
    VELOCITY,
    JointHandle,
    Pid,
)
from bullet_lab.simulation.plugins.samples import (
    Trajectory,
    TrajectoryGoal,
    TrajectoryPoint,
    TrajectorySample,
    is_sound,
)

LOG = logging.getLogger(__name__)

# Error codes of control_msgs/FollowJointTrajectoryResult.
DONE, INVALID_GOAL, INVALID_JOINTS, OLD_STAMP, OFF_PATH, OFF_GOAL = 0, -1, -2, -3, -4, -5

# Position, velocity and acceleration of a joint; the last two are None if they are not given.
State = Tuple[float, Optional[float], Optional[float]]
# The greatest errors of position and velocity; 0 for any.
Bounds = Tuple[float, float]


class TrajectoryError(ControlError):
    """A trajectory is refused, with an error code."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


class TrajectoryResult(NamedTuple):
    """An error code, and what it is about."""

    code: int = DONE
    text: str = ""


class Tolerance(NamedTuple):
    """The greatest errors of a joint on the path and at its end, which may be late by `seconds`."""

    path: Bounds = (0.0, 0.0)
    goal: Bounds = (0.0, 0.0)
    seconds: float = 0.0


def spline(one: State, two: State, t: float) -> Tuple[float, ...]:
    """Return the coefficients of a polynomial from a state to one that is `t` seconds later.

    It is linear without velocities, cubic without accelerations, and quintic otherwise.

    >>> spline((0.0, None, None), (1.0, None, None), 2.0)
    (0.0, 0.5)
    """
    (p, v, a), (q, w, b) = one, two
    if t <= 0.0:
        return (q,)
    if v is None or w is None:
        return p, (q - p) / t
    d, v, w = q - p, v * t, w * t
    if a is None or b is None:
        return p, v / t, (3.0 * d - 2.0 * v - w) / t**2, (v + w - 2.0 * d) / t**3
    a, b = 0.5 * a * t * t, 0.5 * b * t * t
    return (
        p,
        v / t,
        a / t**2,
        (10.0 * d - 6.0 * v - 4.0 * w - 3.0 * a + b) / t**3,
        (-15.0 * d + 8.0 * v + 7.0 * w + 3.0 * a - 2.0 * b) / t**4,
        (6.0 * d - 3.0 * v - 3.0 * w - a + b) / t**5,
    )


class Segment(NamedTuple):
    """A part of a joint's path, from `start` to `end` in s.

    `origin` is when its trajectory starts; without a tolerance, every error is allowed.
    """

    start: float
    end: float
    coefficients: Tuple[float, ...]
    origin: float
    tolerance: Tolerance = Tolerance()

    def at(self, time: float) -> Tuple[float, float, float]:
        """Return the state at a time; before and after the segment, the joint stands still."""
        span = self.end - self.start
        t = min(max(time - self.start, 0.0), span)
        p = v = a = 0.0
        for coefficient in reversed(self.coefficients):
            p, v, a = p * t + coefficient, v * t + p, a * t + 2.0 * v
        return (p, v, a) if t == time - self.start else (p, 0.0, 0.0)


# What a joint follows, in the order of time; there is always a segment.
Path = List[Segment]


def segment_at(path: Path, time: float) -> Segment:
    """Return the segment of a time, or the first one if it begins later."""
    return next((one for one in reversed(path) if one.start <= time), path[0])


def joined(
    path: Path,
    start: float,
    states: Sequence[Tuple[float, State]],
    origin: float,
    tolerance: Tolerance,
) -> Path:
    """Return a path that leaves another one at `start` for states with their times in s.

    `origin` is when the new trajectory starts; `tolerance` applies to the new part.
    """
    last: State = segment_at(path, start).at(start)
    made = [one for one in path if one.start <= start]
    for end, state in states:
        made.append(Segment(start, end, spline(last, state, end - start), origin, tolerance))
        start, last = end, state
    return made


class JointTrajectory(ActionController):
    """Moves joints along trajectories, from the action or the topic `command`.

    Parameters: joints, constraints, gains and velocity_ff (not for positions),
    stop_trajectory_duration in s, allow_partial_joints_goal, state_publish_rate in Hz.
    """

    kinds = {
        "position_controllers/JointTrajectoryController": POSITION,
        "velocity_controllers/JointTrajectoryController": VELOCITY,
        "effort_controllers/JointTrajectoryController": EFFORT,
    }
    action = "follow_joint_trajectory"
    goal_kind = TrajectoryGoal

    def configure(self, given: ControlParameters) -> None:
        super().configure(given)
        self._names = given.required_names("joints")
        self.joints = self.find_joints(self._names)
        self._partial = given.get("allow_partial_joints_goal", False)
        self._stop_seconds = max(0.0, given.get("stop_trajectory_duration", 0.0))
        limits = given.below("constraints")
        slowest = limits.get("stopped_velocity_tolerance", 0.01)
        self._tolerances = {
            name: Tolerance(
                (limits.get(f"{name}/trajectory", 0.0), 0.0),
                (limits.get(f"{name}/goal", 0.0), slowest),
                limits.get("goal_time", 0.0),
            )
            for name in self._names
        }
        self._pids: List[Pid] = []
        if self.interface != POSITION:
            self._pids = [Pid(given.below(f"gains/{name}")) for name in self._names]
        self._forward = [given.get(f"velocity_ff/{name}", 0.0) for name in self._names]
        self._publishing = self.schedule(given, "state_publish_rate", 50.0)
        self.states = Output(self.topic("state"), TrajectorySample)
        self.outputs = (self.states,)
        self.inputs = (Input(self.topic("command"), Trajectory, self.command),)
        self.queries = {"query_state": self.query}
        self._desired = [(joint.position, 0.0, 0.0) for joint in self.joints]
        self._paths: List[Path] = []
        # Those that have reached their goal tolerance.
        self._arrived: Set[str] = set()

    def others(self) -> Tuple[Optional[Schedule], ...]:
        return (self._publishing,)

    def starting(self, step: int) -> None:
        self._desired = [(joint.position, joint.velocity, 0.0) for joint in self.joints]
        for pid in self._pids:
            pid.reset()
        super().starting(step)

    def command(self, trajectory: Trajectory) -> None:
        """Follow a trajectory from a topic; an empty one holds the joints.

        Raises:
            TrajectoryError: it is invalid.
            ControlError: the controller does not run.
        """
        self._check(trajectory)
        self.post(self._replace, trajectory)

    def query(self, time: float) -> Tuple[Tuple[str, ...], TrajectoryPoint]:
        """Return the joints and their states at a simulated time in s; raises ControlError."""
        if not self.running or time < self._paths[0][0].start:
            raise ControlError(f"controller '{self.name}' has no trajectory at {time:.3f} s")
        states = [segment_at(path, time).at(time) for path in self._paths]
        return self._names, TrajectoryPoint(time - self._paths[0][0].origin, *zip(*states))

    def begin(self, content: TrajectoryGoal, step: int) -> None:
        self._check(content.trajectory)
        tolerances = {}
        for name, (path, goal, seconds) in self._tolerances.items():
            asked = (content.path.get(name), content.goal.get(name))
            bounds = (_chosen(*pair) for pair in zip(asked, (path, goal)))
            late = (content.goal_seconds,), (seconds,)
            tolerances[name] = Tolerance(*bounds, *_chosen(*late))
        self._follow(content.trajectory, step, tolerances)

    def refusal(self, error: ControlError) -> TrajectoryResult:
        return TrajectoryResult(getattr(error, "code", INVALID_GOAL), str(error))

    def hold(self, step: int) -> None:
        """Stop within stop_trajectory_duration, or where the joints are."""
        now, span = step / STEPS_PER_SECOND, self._stop_seconds
        self._paths, self._arrived = [], set()
        for joint, (position, velocity, _) in zip(self.joints, self._desired):
            if span:
                # Half of a path that comes back with the opposite velocity.
                start, back = (position, velocity, 0.0), (position, -velocity, 0.0)
                end = Segment(now, now + 2.0 * span, spline(start, back, 2.0 * span), now)
                parts = spline(start, end.at(now + span), span)
            else:
                parts = (joint.position,)
            self._paths.append([Segment(now, now + span, parts, now)])

    def control(self, step: int, seconds: float) -> None:
        now = step / STEPS_PER_SECOND
        for path in self._paths:
            while len(path) > 1 and path[1].start <= now:
                del path[0]
        self._desired = [path[0].at(now) for path in self._paths]
        self._errors = [
            (_distance(joint, position), velocity - joint.velocity)
            for joint, (position, velocity, _) in zip(self.joints, self._desired)
        ]
        if self.goal is not None:
            self._judge(now)
        if self._pids:
            loops = zip(self.joints, self._pids, self._forward, self._desired, self._errors)
            for joint, pid, forward, (_, velocity, _), (error, slope) in loops:
                joint.command = forward * velocity + pid.command(error, seconds, slope)
        else:
            for joint, (position, _, _) in zip(self.joints, self._desired):
                joint.command = position
        if is_due(self._publishing, step) and self.states.wanted:
            self.states.send(self.feedback(step))

    def feedback(self, step: int) -> TrajectorySample:
        since = step / STEPS_PER_SECOND - self._paths[0][0].origin
        actual = [(joint.position, joint.velocity) for joint in self.joints]
        states = (self._desired, actual, self._errors)
        points = (TrajectoryPoint(since, *zip(*state)) for state in states)
        return TrajectorySample(step, self._names, *points)

    def _check(self, trajectory: Trajectory) -> None:
        """Raise TrajectoryError for a trajectory that these joints can never follow."""
        names, points = trajectory.joints, trajectory.points
        if not trajectory.points and not names:
            return
        unknown = set(names) - set(self._names)
        missing = () if self._partial and names else set(self._names) - set(names)
        if unknown or missing or len(set(names)) < len(names):
            said = f"it names {', '.join(names) or 'no joints'}"
            raise TrajectoryError(INVALID_JOINTS, f"{said}; needed are {', '.join(self._names)}")
        before = -math.inf
        for number, point in enumerate(points, start=1):
            where = f"point {number} of {len(points)}"
            lists = (point.positions, point.velocities, point.accelerations)
            if not point.positions or any(len(one) not in (0, len(names)) for one in lists):
                counts = "/".join(str(len(one)) for one in lists)
                text = f"{where} has {counts} positions/velocities/accelerations"
                raise TrajectoryError(INVALID_GOAL, f"{text} for {len(names)} joints")
            if not is_sound(*chain(*lists)):
                raise TrajectoryError(INVALID_GOAL, f"{where} is not finite, or too large")
            if point.seconds <= before:
                times = f"{point.seconds:g} s comes after {before:g} s"
                raise TrajectoryError(INVALID_GOAL, f"{where}: {times}; times must increase")
            before = point.seconds

    def _replace(self, trajectory: Trajectory, step: int) -> None:
        try:
            self._follow(trajectory, step, {})
        except ControlError as error:
            LOG.error("controller '%s': trajectory refused: %s", self.name, error)
            return
        self.end(PREEMPTED)

    def _follow(
        self, trajectory: Trajectory, step: int, tolerances: Mapping[str, Tolerance]
    ) -> None:
        """Follow a valid trajectory from now on; raises TrajectoryError if all of it is past."""
        now = step / STEPS_PER_SECOND
        origin = trajectory.start or now
        points = [one for one in trajectory.points if origin + one.seconds > now]
        gone = len(trajectory.points) - len(points)
        if not trajectory.points:
            self.hold(step)
            return
        if not points:
            late = now - origin - trajectory.points[-1].seconds
            code = OLD_STAMP if trajectory.start else INVALID_GOAL
            raise TrajectoryError(code, f"all {gone} points are past, the last by {late:.3f} s")
        # Without a stamp, the first point may be where the joints are.
        if gone > 1 or (gone and trajectory.start):
            LOG.warning("controller '%s': %d points are past; ignored", self.name, gone)
        self._arrived, start = set(), max(now, origin)
        for column, name in enumerate(trajectory.joints):
            number = self._names.index(name)
            path, shift = self._paths[number], 0.0
            if self.joints[number].described.kind == "continuous":
                last = segment_at(path, start).at(start)[0]
                first = points[0].positions[column]
                shift = last + math.remainder(first - last, math.tau) - first
            states = [(origin + one.seconds, _state(one, column, shift)) for one in points]
            tolerance = tolerances.get(name, Tolerance())
            self._paths[number] = joined(path, start, states, origin, tolerance)

    def _judge(self, now: float) -> None:
        """End the goal if a tolerance is violated, or if all joints have arrived."""
        for name, path, errors in zip(self._names, self._paths, self._errors):
            segment, (on_path, at_goal, seconds) = path[0], path[0].tolerance
            if now < segment.end:
                problem, code = _violation(errors, on_path, "path"), OFF_PATH
            elif len(path) > 1:
                continue
            else:
                problem, code = _violation(errors, at_goal, "goal"), OFF_GOAL
                if not problem:
                    self._arrived.add(name)
                elif now < segment.end + seconds:
                    problem = ""
            if problem:
                result = TrajectoryResult(code, f"joint '{name}': {problem}")
                self.end(ABORTED, result, result.text)
                return
        if len(self._arrived) == len(self._names):
            self.end(SUCCEEDED, TrajectoryResult())


def _distance(joint: JointHandle, target: float) -> float:
    error = target - joint.position
    return math.remainder(error, math.tau) if joint.described.kind == "continuous" else error


def _state(point: TrajectoryPoint, column: int, shift: float) -> State:
    lists = (point.velocities, point.accelerations)
    return (point.positions[column] + shift, *(one[column] if one else None for one in lists))


def _chosen(asked: Optional[Sequence[float]], default: Sequence[float]) -> Tuple[float, ...]:
    """Return bounds: those that are asked for, the default for 0, and none if negative."""
    pairs = zip(asked or default, default)
    return tuple(max(0.0, given) if given else kept for given, kept in pairs)


def _violation(errors: Sequence[float], bounds: Bounds, where: str) -> str:
    """Return which error exceeds its bound, or an empty text."""
    for kind, error, most in zip(("position", "velocity"), errors, bounds):
        if 0.0 < most < abs(error):
            return f"{where} error in {kind} is {error:.4g}; allowed are {most:g}"
    return ""
