"""What the nodes' parameters refuse; that a node then ends with that line is in its rostest."""

import math

import pytest

from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.ros.nodes.aruco import ArucoParameters
from bullet_lab.ros.nodes.bridge import BridgeParameters
from bullet_lab.ros.nodes.canny_edges import CannyParameters
from bullet_lab.ros.nodes.dock import DockParameters
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.good_features import GoodFeaturesParameters
from bullet_lab.ros.nodes.harris_corners import HarrisParameters
from bullet_lab.ros.nodes.image_node import ImageParameters
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.plots import PlotNoiseParameters

BAD = (
    (NoisyOdomParameters, "std", -0.1),
    (NoisyOdomParameters, "std", "much"),
    (NoisyOdomParameters, "model", "gaussian"),
    (NoisyOdomParameters, "seed", -1),
    (NoisyOdomParameters, "alpha1", math.nan),
    (NoisyOdomParameters, "rate", 0),
    (NoisyOdomParameters, "base_error", 2),
    (NoisyOdomParameters, "stdd", 0.1),
    (DriveSquaresParameters, "mode", "by_heart"),
    (DriveSquaresParameters, "sides", 0),
    (DriveSquaresParameters, "sides", 2.5),
    (DriveSquaresParameters, "side", -1),
    (DriveSquaresParameters, "speed", 0),
    (DriveSquaresParameters, "turn_speed", 0),
    (DriveSquaresParameters, "turn_speed", "slow"),
    (DriveSquaresParameters, "velocity", 0.2),
    (DriveToGoalParameters, "speed", 0.0),
    (DriveToGoalParameters, "acceleration", -1.0),
    (DriveToGoalParameters, "gain", math.nan),
    (DriveToGoalParameters, "tolerance", 0.005),
    (PlotNoiseParameters, "plot_period", 0),
    (PlotNoiseParameters, "about", [1]),
    (PlotNoiseParameters, "ot", "x"),
    (ArucoParameters, "tags", "apriltag_37h10"),
    (ArucoParameters, "width", 0),
    (ArucoParameters, "ids", "0 -1"),
    (ArucoParameters, "sizes", "7=0"),
    (ArucoParameters, "border", -1),
    (ArucoParameters, "correction", 2.0),
    (ArucoParameters, "pixel_sigma", -1),
    (ArucoParameters, "imgae", "/camera"),
    (ImageParameters, "window", 1),
    (CannyParameters, "low", -1),
    (CannyParameters, "aperture", 4),
    (GoodFeaturesParameters, "max_corners", 0),
    (GoodFeaturesParameters, "quality", 0),
    (HarrisParameters, "k", "x"),
    (HarrisParameters, "threshold", 2.0),
    (DockParameters, "rate", 0.0),
    (DockParameters, "speed", 0.2),
    (BridgeParameters, "rtf", -1),
    (BridgeParameters, "rtf", "fast"),
    (BridgeParameters, "rtf", math.inf),
    (BridgeParameters, "clock_rate", 0),
    (BridgeParameters, "clock_rate", 1001),
    (BridgeParameters, "robot_pose", "1 2 3"),
    (BridgeParameters, "paused", "maybe"),
)


@pytest.mark.parametrize("kind, name, value", BAD)
def test_what_is_not_allowed_is_one_line_that_names_the_parameter(kind, name, value):
    given = {f"~{name}": value}
    with pytest.raises(ParameterError) as refusal:
        read_parameters(kind, lambda key, default=None: given.get(key, default), {name})
    assert f"~{name}" in str(refusal.value)
    assert "\n" not in str(refusal.value)
