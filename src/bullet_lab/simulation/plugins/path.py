"""libbullet_lab_path.so: moves a model along a path, as Gazebo moves an actor by its script."""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Mount, Plugin, PluginError
from bullet_lab.simulation.world.xml import ElementReader

STILL = (0.0, 0.0, 0.0)


class Path(Plugin):
    """Places the first link of its model on a path in the world, whatever is in the way.

    The path is a Catmull-Rom spline through the waypoints, as in Gazebo; with the tension 1, it is
    straight, and the model slows down at each waypoint. Angles change evenly between waypoints.
    The path begins when the model is added or reset.
    """

    filenames = ("libbullet_lab_path.so",)
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        mount.require_moving()
        self._body = mount.body
        self._loops = mount.boolean("loop", True)
        self._starts = mount.boolean("auto_start", True)
        self._delay = mount.coefficient("delay_start")
        mount.text("trajectory")
        self._times, table, tension = _waypoints(mount)
        self._places, self._angles = table[:, :3], np.unwrap(table[:, 3:], axis=0)
        # A closed path goes round without a corner.
        closed = np.allclose(self._places[0], self._places[-1])
        before, after = (-2, 1) if closed else (0, -1)
        around = np.vstack((self._places[before], self._places, self._places[after]))
        self._tangents = 0.5 * (1.0 - tension) * (around[2:] - around[:-2])

    def reset(self, step: int) -> None:
        self._start = step
        self.placed()

    def placed(self) -> None:
        self._rest = self._body.pose()

    def before_step(self, step: int) -> None:
        time = (step - self._start) / STEPS_PER_SECOND - self._delay
        if time < 0.0 or not self._starts:
            self._body.move(self._rest, STILL, STILL)
            return
        if self._loops:
            time %= self._times[-1]
        now, later = self._at(time), self._at(time + STEP_SECONDS)
        velocity = ((later - now) / STEP_SECONDS).tolist()
        pose = Pose.from_rpy(tuple(now[:3].tolist()), tuple(now[3:].tolist()))
        self._body.move(pose, tuple(velocity[:3]), (0.0, 0.0, velocity[5]))

    def _at(self, time: float) -> np.ndarray:
        """Return x, y, z, roll, pitch and yaw at a time (s) of the path; its ends beyond them."""
        first = min(max(bisect_right(self._times, time) - 1, 0), len(self._times) - 2)
        ends = slice(first, first + 2)
        begin, end = self._times[ends]
        part = min(max((time - begin) / (end - begin), 0.0), 1.0)
        square, cube = part**2, part**3
        position = np.dot((1 - 3 * square + 2 * cube, 3 * square - 2 * cube), self._places[ends])
        position += np.dot((part - 2 * square + cube, cube - square), self._tangents[ends])
        return np.concatenate((position, np.dot((1.0 - part, part), self._angles[ends])))


def _waypoints(mount: Mount) -> tuple[list[float], np.ndarray, float]:
    """Return times in s, x, y, z, roll, pitch and yaw, shape (n, 6), and the tension."""
    times, rows, tension = [], [], 0.0
    for part in mount.plugin.element.findall("trajectory"):
        tension = ElementReader(part, mount.where("trajectory")).coefficient("tension", tension)
        begin = times[-1] if times else 0.0
        for element in part.findall("waypoint"):
            waypoint = ElementReader(element, mount.where("waypoint"))
            time = begin + waypoint.numbers("time", 1)[0]
            if times and time <= times[-1]:
                raise PluginError(f"{waypoint.where('time')}: {time:g} s is not after the last one")
            times.append(time)
            rows.append(waypoint.numbers("pose", 6))
    if len(rows) < 2:
        raise PluginError(f"{mount.where('trajectory')}: {len(rows)} waypoints; it needs two")
    return times, np.array(rows), min(tension, 1.0)
