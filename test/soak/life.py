"""What happens in a soak: models, robots, subscribers and nodes that come and go, and resets."""

import contextlib
import math
import signal
import time
from collections import Counter

import rospy
import yaml
from bullet_lab.msg import MarkerDetectionArray
from gazebo_msgs.msg import ModelState, ModelStates
from geometry_msgs.msg import Point, Pose, Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image, Imu, LaserScan
from std_srvs.srv import Empty
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.simulation.rendering.renderer import KEPT_DRAWABLES
from bullet_lab.simulation.world.resources import package_share

INCLUDE = '<sdf version="1.6"><include><uri>model://{}</uri></include></sdf>'
MODELS = ("beacon", "marker_panel", "docking_station_nested")
ROBOTS = ("block_robot", "sensor_robot", "camera_robot")
TOPICS = (
    ("odom", Odometry),
    ("noisy_odom", Odometry),
    ("mycamera/image_raw", Image),
    ("detections", MarkerDetectionArray),
    ("/gazebo/model_states", ModelStates),
    ("/bullet_lab/world", MarkerArray),
    ("guest/odom", Odometry),
    ("guest/scan", LaserScan),
    ("guest/imu", Imu),
    ("guest/mycamera/image_raw", Image),
)
MOST_MODELS, MOST_SUBSCRIBERS = 6, 5
GUEST = "guest"
# Before a rest is one: pictures of what is left, and wall seconds for them, at most.
PICTURES, PICTURE_SECONDS = 3, 20.0
# Chances of what happens in a simulated second. A robot that has come and gone leaves 1.4 to 4.6 kB
# behind, all of it in PyBullet, and so does a model, 0.9 to 2, where more than six others went
# before one like it came.
CHANCES = yaml.safe_load("""
model: 0.25
no_model: 0.25
move: 0.1
robot: 0.04
no_robot: 0.04
listen: 0.12
no_listen: 0.12
visit: 0.008
no_visit: 0.008
reset_world: 0.01
reset_simulation: 0.003
""")


class Life:
    """Does one thing after the other, drawn by a generator.

    Attributes:
        done: how often what was done.
    """

    def __init__(self, lab, random):
        self._lab, self._random = lab, random
        self.done = Counter()
        self._models = []
        self._subscribers = []
        self._guest = False
        self._before, self._seconds = 0.0, 0.0
        proxy = rospy.ServiceProxy
        self._properties = proxy(
            "/gazebo/get_world_properties", srv.GetWorldProperties, persistent=True
        )
        self._spawn_sdf = proxy("/gazebo/spawn_sdf_model", srv.SpawnModel)
        self._spawn_urdf = proxy("/gazebo/spawn_urdf_model", srv.SpawnModel)
        self._delete = proxy("/gazebo/delete_model", srv.DeleteModel)
        self._set_state = proxy("/gazebo/set_model_state", srv.SetModelState)
        names = ("pause_physics", "unpause_physics", "reset_world", "reset_simulation")
        self._do = {name: proxy(f"/gazebo/{name}", Empty) for name in names}

    def seconds(self):
        """Return the simulated seconds since the beginning, resets or not."""
        now = self._properties().sim_time
        self._seconds += now - self._before
        self._before = now
        return self._seconds

    @contextlib.contextmanager
    def at_rest(self):
        """Have only what was there at the beginning, where it was, and time stand meanwhile."""
        while self._no_model() or self._no_robot() or self._no_listen() or self._no_visit():
            pass
        # The renderer keeps the last links that are gone, and until the next picture all shadows.
        self.done["rest"] += 1
        self._spawned(self._spawn_sdf, "boxes", small_boxes(self.done["rest"]))
        self._watch()
        self._delete("boxes")
        # So that the pictures of all rests are alike.
        self._do["reset_world"]()
        self._watch()
        self._do["pause_physics"]()
        yield
        self._do["unpause_physics"]()

    def _watch(self):
        came = []
        camera = rospy.Subscriber("mycamera/image_raw", Image, lambda _: came.append(None))
        end = time.monotonic() + PICTURE_SECONDS
        while len(came) < PICTURES and time.monotonic() < end:
            time.sleep(0.05)
        camera.unregister()

    def go_on(self):
        """Do what happens in one second."""
        for name, chance in CHANCES.items():
            if self._random.random() < chance and getattr(self, f"_{name}")():
                self.done[name] += 1

    def _model(self):
        if len(self._models) >= MOST_MODELS:
            return False
        name = f"model{self.done['model']}"
        text = INCLUDE.format(self._drawn(MODELS))
        return self._spawned(self._spawn_sdf, name, text) and not self._models.append(name)

    def _no_model(self):
        if not self._models:
            return False
        name = self._drawn(self._models)
        self._models.remove(name)
        return self._delete(name).success

    def _move(self):
        if not self._models:
            return False
        moved = ModelState(model_name=self._drawn(self._models), pose=self._pose())
        return self._set_state(moved).success

    def _robot(self):
        if self._guest:
            return False
        text = (package_share() / "urdf" / f"{self._drawn(ROBOTS)}.urdf").read_text()
        self._guest = self._spawned(self._spawn_urdf, GUEST, text)
        return self._guest

    def _no_robot(self):
        was, self._guest = self._guest, False
        return was and self._delete(GUEST).success

    def _listen(self):
        if len(self._subscribers) >= MOST_SUBSCRIBERS:
            return False
        topic, kind = self._drawn(TOPICS)
        self._subscribers.append(rospy.Subscriber(topic, kind, lambda _: None, queue_size=1))
        return True

    def _no_listen(self):
        if not self._subscribers:
            return False
        listener = self._drawn(self._subscribers)
        self._subscribers.remove(listener)
        listener.unregister()
        return True

    def _visit(self):
        self._lab.visit()
        return True

    def _no_visit(self):
        return self._lab.end_visit(self._drawn((signal.SIGINT, signal.SIGKILL)))

    def _reset_world(self):
        self._do["reset_world"]()
        return True

    def _reset_simulation(self):
        self.seconds()
        self._do["reset_simulation"]()
        self._before = 0.0
        return True

    def _drawn(self, values):
        return values[self._random.integers(len(values))]

    def _spawned(self, spawn, name, text):
        return spawn(name, text, name, self._pose(), "").success

    def _pose(self):
        # Around the square that is driven, and in sight of the camera.
        angle, distance = self._random.uniform(-math.pi, math.pi), self._random.uniform(3.0, 6.0)
        turn = 0.5 * self._random.uniform(-math.pi, math.pi)
        where = Point(distance * math.cos(angle), distance * math.sin(angle), 0.0)
        return Pose(where, Quaternion(0.0, 0.0, math.sin(turn), math.cos(turn)))


def small_boxes(number):
    """Return a model of as many links as the renderer keeps, unlike those of other numbers."""
    links = "".join(
        f"<link name='link{k}'><visual name='box'><geometry>"
        f"<box><size>{0.01 + 1e-5 * number} 0.01 {0.01 + 1e-5 * k}</size></box>"
        "</geometry></visual></link>"
        for k in range(KEPT_DRAWABLES)
    )
    return f"<sdf version='1.6'><model name='boxes'><static>true</static>{links}</model></sdf>"
