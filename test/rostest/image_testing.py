"""Images, cameras and diagnostics for the rostests of the nodes that look at images."""

import sys

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from lab_testing import PACKAGE, NodeTest, Topic, wait_for
from sensor_msgs.msg import CameraInfo, Image

# The exact images of the unit tests.
sys.path.insert(0, str(PACKAGE / "test" / "unit"))
from marker_images import CAMERA, View, image_of, marker  # noqa: E402

from bullet_lab.ros.messages.images import image_message  # noqa: E402

IMAGE, INFO = "/mycamera/image_raw", "/mycamera/camera_info"
FRAME = "camera_optical_frame"


def picture(view=None, **options):
    """A grey image of marker 0 (0.20 m) two metres ahead, or as a view has it."""
    return image_of([marker()], view or View(2.0, yaw=20.0), samples=4, **options)


def image(seconds, pixels, encoding="mono8"):
    """An image message."""
    message = image_message(rospy.Header(), pixels, encoding)
    message.header.stamp = rospy.Time.from_sec(seconds)
    message.header.frame_id = FRAME
    return message


def info(seconds, camera=CAMERA):
    """The camera_info of a camera."""
    message = CameraInfo(height=camera.height, width=camera.width, distortion_model="plumb_bob")
    message.header.stamp = rospy.Time.from_sec(seconds)
    message.header.frame_id = FRAME
    message.D = list(camera.distortion)
    message.K = camera.matrix.ravel().tolist()
    message.R = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.P = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


class FakeCamera:
    """Publishes images and their camera_info."""

    def __init__(self, with_info=True):
        options = {"queue_size": 100, "tcp_nodelay": True}
        self.images = rospy.Publisher(IMAGE, Image, **options)
        self.infos = rospy.Publisher(INFO, CameraInfo, **options) if with_info else None

    def connect(self):
        """Wait until somebody looks."""
        for made in filter(None, (self.images, self.infos)):
            wait_for(lambda made=made: made.get_num_connections() > 0, f"a look at {made.name}")

    def looked_at(self):
        """Whether anybody subscribes to the images."""
        self.images.impl.check()
        return self.images.get_num_connections() > 0

    def send(self, seconds, pixels, encoding="mono8", about=None):
        """Publish an image after its camera_info."""
        if self.infos is not None:
            self.infos.publish(about or info(seconds))
        self.images.publish(image(seconds, pixels, encoding))

    def end(self):
        """Stop publishing."""
        for made in filter(None, (self.images, self.infos)):
            made.unregister()


class Diagnosis:
    """What a node says of itself on /diagnostics."""

    def __init__(self, node):
        self._node = node
        self._topic = Topic("/diagnostics", DiagnosticArray, connected=False)

    def found(self, words, level=None):
        """Return a status, of a level if one is given, whose message has some words, or None."""
        for message in list(self._topic.messages):
            for status in message.status:
                mine = status.name.startswith(f"{self._node}:") and level in (None, status.level)
                if mine and words in status.message:
                    return status
        return None

    def wait(self, level, words):
        """Wait for a status of a level whose message has some words; return it."""
        return wait_for(
            lambda: self.found(words, level), lambda: f"'{words}' ({level}); had {self.said()}"
        )

    def said(self):
        """All that it has said so far."""
        return {s.message for m in self._topic.messages for s in m.status}

    def close(self):
        """Listen no longer."""
        self._topic.close()


class ImageNodeTest(NodeTest):
    """What tests of a running node that looks at images share; each has a camera of its own."""

    def camera(self, with_info=True):
        """A camera; the next one comes when the node looks at this one no longer."""
        camera = FakeCamera(with_info)
        self.addCleanup(camera.end)
        self.addCleanup(wait_for, lambda: not camera.looked_at(), "the nodes to look away")
        return camera

    def diagnosis(self, node):
        """What a node says of itself from now on."""
        diagnosis = Diagnosis(node)
        self.addCleanup(diagnosis.close)
        return diagnosis
