import math

import docking_standin as standin
import numpy as np
import pytest
from alike import lines_of
from bullet_lab.msg import DockGoal, MarkerDetectionArray, UndockGoal
from geometry_msgs.msg import Quaternion
from message_fields import check, message
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo
from shared import cases, refuses

from bullet_lab.core.parameters import ParameterError
from bullet_lab.core.pose import Pose
from bullet_lab.docking.progress import DockingFailureError
from bullet_lab.docking.types import CalibrationErrors, DockingError, DockingResult, Learned
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.poses import InputError
from bullet_lab.ros.nodes.dock import (
    DockParameters,
    NotYetError,
    camera_of,
    check_goal,
    docking_result,
    mount_of,
    odometry_of,
    result_message,
    rough_pose,
    sightings_of,
)

DOCK = standin.make_dock(standin.Stand((0.0, 0.0, 0.0), (0.0, 0.0, 0.1)))


ODOMETRY = """
    header: {stamp: {secs: 1}, frame_id: odom}
    pose: {pose: {position: {x: 2.0}, orientation: {z: 0.6, w: 0.8}}}
"""
INFO = """
    header: {frame_id: optical}
    width: 640
    height: 480
    distortion_model: plumb_bob
    K: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]
"""
# Markers without finite corners are left out.
DETECTIONS = """
    header: {stamp: {secs: 2}}
    detections:
      - {id: 4, corners: [.nan, .nan, .nan, .nan, .nan, .nan, .nan, .nan]}
      - {id: 3, dictionary: d, corners: [0, 1, 2, 3, 4, 5, 6, 7]}
      - {id: 5, deviations: [.inf, .inf, .inf, .inf, .inf, .inf, .inf, .inf]}
"""


def test_messages_are_read_as_before(as_before):
    odometry = message(Odometry, ODOMETRY)
    odometry.twist.covariance = list(range(36))
    # The optical frame of a camera that looks ahead.
    optical = Pose((0.16, 0.01, 0.44), (-0.5, 0.5, -0.5, 0.5))
    found = {
        "odometry": odometry_of(odometry),
        "mount": mount_of(optical),
        "camera": camera_of(message(CameraInfo, INFO)),
        "sightings": sightings_of(message(MarkerDetectionArray, DETECTIONS)),
    }
    assert found["sightings"][1][0].corners.dtype == np.float64
    as_before(lines_of(found, "read"), "docking.txt")


def goal(frame):
    """Return a goal with a pose in a frame: 3 m ahead, 1 m to the left and turned by -0.2 rad."""
    text = f"""
        dock_id: dock
        dock_pose:
          header: {{frame_id: {frame}}}
          pose:
            position: {{x: 3.0, y: 1.0}}
            orientation: {{z: {math.sin(-0.1)}, w: {math.cos(0.1)}}}
    """
    return message(DockGoal, text)


def lookup(target, source):
    if source != "map":
        raise InputError(f"no transform from {source}")
    return Pose.from_rpy((1.0, 2.0, 0.0), (0.0, 0.0, math.pi / 2))


@cases("""
frame, expected:
  # That of the database, unless the goal has one.
  - ["''", [4.0, 0.0, 0.1]]
  - [odom, [3.0, 1.0, -0.2]]
  # A right angle less 0.2.
  - [map, [0.0, 5.0, 1.3707963267948966]]
""")
def test_the_rough_pose_is_in_the_frame_of_the_odometry(frame, expected):
    assert rough_pose(goal(frame), DOCK, "odom", lookup) == pytest.approx(expected)


def test_an_unknown_frame_may_be_known_later():
    with pytest.raises(NotYetError) as caught:
        rough_pose(goal("mars"), DOCK, "odom", lookup)
    assert caught.value.error == DockingError.NOT_VALID


def test_a_leaning_dock_is_refused_for_good():
    wrong = goal("odom")
    wrong.dock_pose.pose.orientation = Quaternion(0.6, 0.0, 0.0, 0.8)
    with refuses("not upright", DockingFailureError) as caught:
        rough_pose(wrong, DOCK, "odom", lookup)
    assert not isinstance(caught.value, NotYetError)
    assert isinstance(caught.value, LabError)


@cases("""
action, text, said:
  # Goals and what is wrong with them.
  - [dock, "max_retries: -2, dock_id: dock", max_retries is -2]
  - [dock, "", neither dock_id nor]
  - - dock
    - "dock_pose: {header: {frame_id: odom}, pose: {position: {x: .nan}, orientation: {w: 1.0}}}"
    - not finite
  - [dock, "dock_pose: {header: {frame_id: odom}}", no unit quaternion]
  - [undock, "distance: -0.1", distance is -0.1 m]
  - [undock, "distance: 10.1", from 0 to 10 m]
  - [undock, "distance: .nan", distance is nan m]
""")
def test_invalid_goals_are_refused(action, text, said):
    kind = {"dock": DockGoal, "undock": UndockGoal}[action]
    with refuses(said, DockingFailureError) as caught:
        check_goal(message(kind, f"{{{text}}}"))
    assert caught.value.error == DockingError.NOT_VALID


def test_a_dock_that_the_database_does_not_have():
    with refuses("~dock is 'kitchen': it must be one of", ParameterError):
        DockParameters(dock="kitchen").database()


def test_docks_that_cannot_be_read(tmp_path):
    path = tmp_path / "docks.yaml"
    path.write_text("docks: {dock: {}}")
    with refuses("^~docks: .*frame", ParameterError):
        DockParameters(docks=str(path)).database()


def test_goals_at_the_limits_are_valid():
    for good in (DockGoal(max_retries=-1, dock_id="dock"), UndockGoal(0.0), UndockGoal(10.0)):
        check_goal(good)


@pytest.mark.parametrize(
    "calibration", [None, CalibrationErrors(*(Learned(i, 0.1 * i) for i in range(7)))]
)
def test_a_result_comes_as_it_was_sent(calibration):
    result = DockingResult(
        DockingError.NONE, "docked", 2, 0.4, 0.01, -0.02, calibration=calibration
    )
    made = result_message(DockGoal(), result)
    fields = """
        success: true
        error_code: 0
        message: docked
        retries: 2
        distance: 0.4
        lateral: 0.01
        yaw: -0.02
    """
    check(made, fields)
    assert math.isnan(made.calibration.drift) == (calibration is None)
    assert docking_result(made) == result
