"""Measures the camera of the bridge; scripts/bench.sh camera.

First, the time from the start of a frame to the moment at which its message is written, without
multisampling and with 4 samples for each pixel, over that of PyBullet's own `getCameraImage` of
the same things at its fastest setting: without light and shadows, a dozen of the one and a dozen
of the other in turns. Then
a whole setup in real time: the bridge with the camera at 30 Hz, and `aruco.py` listening, whether
every frame arrives, and what it costs.
--frames N: timed frames of each kind. --seconds S: wall time of the second part.
"""

import importlib.util
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import rospy
from bullet_lab.msg import MarkerDetectionArray
from common import options, report, start_ros
from lab_nodes import Node, end_all
from lab_testing import Topic, wait_for
from sensor_msgs.msg import CameraInfo

from bullet_lab.core.pose import Pose
from bullet_lab.ros.nodes.bridge import BridgeParameters, PyBulletBridge
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.plugins.camera import Camera
from bullet_lab.simulation.rendering import driver_name
from bullet_lab.simulation.world.description import Box, Cylinder, Mesh, Plane, Sphere

WORLD = "package://bullet_lab/worlds/docking.world"
ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
RATE = 30.0
# Of the frames that are timed: so many that the machine is busy all the time. On one that goes to
# sleep between frames, whatever comes first pays for waking up.
FRAME_RATE = 100.0
SAMPLES = (1, 4)
# What is asked for: of a bare call without and with multisampling.
ASKED = {1: 0.6, 4: 1.3}
# Frames of the one and then of the other; the first of each do not count: they find the processor's
# caches full of the other's data, and load the world the first time.
BLOCK, SKIPPED = 12, 3

LISTENER = """
import rospy
from sensor_msgs.msg import Image
rospy.init_node("bench_listener")
rospy.Subscriber("/mycamera/image_raw", Image, lambda m: None, buff_size=2**24, tcp_nodelay=True)
rospy.spin()
"""


class PyBulletCamera:
    """What is to be seen of a simulation, drawn by PyBullet's EGL plugin.

    It does so in a thread of its own: the plugin takes its graphics context for always current.
    """

    def __init__(self, simulation, camera):
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._thread.submit(self._load, simulation, camera).result()

    def _load(self, simulation, camera):
        self._client = pybullet.connect(pybullet.DIRECT)
        plugin = importlib.util.find_spec("eglRenderer").origin
        pybullet.loadPlugin(plugin, "_eglRendererPlugin", physicsClientId=self._client)
        for instance in simulation.models.values():
            for link in instance.model.links:
                where = instance.frame(link.name).pose()
                for visual in link.visuals:
                    self._add(visual, where * visual.pose)
        geometry = camera.camera
        eye = camera.pose()
        target, up = (eye * Pose((1.0, 0.0, 0.0))).position, eye.rotate((0.0, 0.0, 1.0))
        angle = np.degrees(2.0 * np.arctan(0.5 * geometry.height / geometry.fy))
        size = geometry.width, geometry.height
        self._arguments = (
            *size,
            pybullet.computeViewMatrix(eye.position, target, up),
            pybullet.computeProjectionMatrixFOV(
                float(angle), size[0] / size[1], camera.near, camera.far
            ),
        )

    def seconds(self):
        """Draw a picture; return how long that took."""
        return self._thread.submit(self._draw).result()

    def _draw(self):
        start = time.perf_counter()
        pybullet.getCameraImage(
            *self._arguments,
            renderer=pybullet.ER_BULLET_HARDWARE_OPENGL,
            # With a projective texture, it draws no shadow map.
            flags=pybullet.ER_NO_SEGMENTATION_MASK | pybullet.ER_USE_PROJECTIVE_TEXTURE,
            projectiveTextureView=np.eye(4).ravel().tolist(),
            projectiveTextureProj=np.eye(4).ravel().tolist(),
            physicsClientId=self._client,
        )
        return time.perf_counter() - start

    def _add(self, visual, pose):
        geometry, shape = visual.geometry, {}
        if isinstance(geometry, (Box, Plane)):
            size = geometry.size if isinstance(geometry, Box) else (*geometry.size, 0.001)
            shape = {"shapeType": pybullet.GEOM_BOX, "halfExtents": [0.5 * side for side in size]}
        elif isinstance(geometry, Cylinder):
            size = {"radius": geometry.radius, "length": geometry.length}
            shape = {"shapeType": pybullet.GEOM_CYLINDER, **size}
        elif isinstance(geometry, Sphere):
            shape = {"shapeType": pybullet.GEOM_SPHERE, "radius": geometry.radius}
        elif isinstance(geometry, Mesh):
            shape = {"shapeType": pybullet.GEOM_MESH, "fileName": str(geometry.path)}
        drawn = pybullet.createVisualShape(
            **shape, rgbaColor=visual.colour, physicsClientId=self._client
        )
        pybullet.createMultiBody(
            0, -1, drawn, pose.position, pose.quaternion, physicsClientId=self._client
        )


class Stopwatch:
    """Times the frames of a bridge in this process, and PyBullet's pictures in between."""

    def __init__(self, bridge, frames):
        (robot,) = (m for m in bridge.simulation.models.values() if m.model.name == "camera_robot")
        (self._camera,) = (d for d in robot.plugins if isinstance(d, Camera))
        self._frames = frames
        self._bare = PyBulletCamera(bridge.simulation, self._camera)
        self.bare = {samples: [] for samples in SAMPLES}
        self.bridge = {samples: [] for samples in SAMPLES}
        self._produce = self._camera.produce
        self._camera.produce = self._timed_produce
        self._after_steps = bridge.stepper.after_steps
        bridge.stepper.after_steps = self._timed_flush
        self._in_frame = 0.0
        self._since_bare = 0

    def _timed_produce(self, step):
        if not self._camera.image.wanted:
            return
        unfinished = [s for s in SAMPLES if len(self.bridge[s]) < self._frames]
        samples = (unfinished or SAMPLES)[0]
        if self._since_bare % BLOCK == 0:
            self.bare[samples] += [self._bare.seconds() for _ in range(BLOCK)][SKIPPED:]
            self._since_bare = 0
        self._camera.settings = replace(self._camera.settings, samples=samples)
        start = time.perf_counter()
        self._produce(step)
        self._in_frame = time.perf_counter() - start

    def _timed_flush(self):
        start = time.perf_counter()
        self._after_steps()
        if not self._in_frame:
            return
        times = self.bridge[self._camera.settings.samples]
        self._since_bare += 1
        if self._since_bare > SKIPPED:
            times.append(self._in_frame + time.perf_counter() - start)
        self._in_frame = 0.0
        if len(self.bridge[SAMPLES[-1]]) >= self._frames:
            rospy.signal_shutdown("measured")


def frame_times(frames):
    """Measure PyBullet's pictures and whole frames; medians.

    To be called in a process of its own: a ROS node is set up once.
    """
    rospy.init_node("bench_bridge", disable_signals=True)
    wanted = BridgeParameters(world=WORLD, robot=ROBOT, rtf=1.0, camera_rate=FRAME_RATE)
    bridge = PyBulletBridge(wanted)
    watch = Stopwatch(bridge, frames)
    listener = subprocess.Popen([sys.executable, "-c", LISTENER])
    try:
        bridge.spin()
    finally:
        listener.kill()
    rows = []
    for samples, asked in ASKED.items():
        bare, whole = (1e3 * float(np.median(t[samples])) for t in (watch.bare, watch.bridge))
        title = f"{samples} samples: drawing to publishing"
        rows += [
            (f"{samples} samples: getCameraImage at its fastest, ms", bare, ".1f", ""),
            (f"{title}, ms", whole, ".1f", ""),
            (f"{title} / getCameraImage", whole / bare, ".2f", f"<= {asked:g}"),
        ]
    return rows


def real_time(seconds):
    """Measure how the camera does at real-time factor 1 with `aruco.py` listening."""
    bridge = Node("pybullet_bridge", f"_world:={WORLD}", f"_robot:={ROBOT}", "_rtf:=1")
    aruco = Node("aruco", "_image:=/mycamera/image_raw", "__name:=aruco")
    sent = Topic("/mycamera/camera_info", CameraInfo, connected=False)
    seen = Topic("/aruco/detections", MarkerDetectionArray, connected=False)
    try:
        seen.wait(31)
        loads = ThreadPoolExecutor(2)
        first, start_time = sent.stamps()[-1], time.monotonic()
        of_bridge, of_aruco = loads.map(lambda node: node.percent(seconds), (bridge, aruco))
        last, passed = sent.stamps()[-1], time.monotonic() - start_time
        # The last one may still be looked at.
        wait_for(lambda: seen.stamps()[-1] >= last, "the last frame")
    finally:
        end_all(aruco, bridge)
    expected = {-(-1000 * k // 30) for k in range(1, 10**6) if first < 1000 * k / 30 <= last}
    every = f"{len(expected)}"
    return [
        ("30 Hz, aruco.py: real-time factor", (last - first) / 1000.0 / passed, ".3f", ">= 0.99"),
        ("frames sent", len(expected & set(sent.stamps())), "d", every),
        ("frames processed by aruco.py", len(expected & set(seen.stamps())), "d", every),
        ("bridge, % of a core", of_bridge, ".0f", "<= 30"),
        ("aruco.py, % of a core", of_aruco, ".0f", ""),
    ]


def main():
    """Measure, print and write."""
    wanted = options(__doc__, frames=100, seconds=20.0)
    start_ros()
    print("frames …", flush=True)
    with ProcessPoolExecutor(1, get_context("spawn")) as another:
        rows = another.submit(frame_times, wanted.frames).result()
    print("real time …", flush=True)
    rospy.set_param("/use_sim_time", True)
    rows += real_time(wanted.seconds)
    report(wanted.out, rows, driver_name(), driver=driver_name(), load=os.getloadavg()[0])


if __name__ == "__main__":
    main()
