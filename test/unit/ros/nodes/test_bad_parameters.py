"""What the nodes' parameters refuse; that a node then ends with that line is in bridge_failures."""

import pytest
import yaml
from shared import refuses

from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.ros.nodes.aruco import ArucoParameters
from bullet_lab.ros.nodes.bridge import BridgeParameters
from bullet_lab.ros.nodes.dock import DockParameters
from bullet_lab.ros.nodes.drive_squares import DriveSquaresParameters
from bullet_lab.ros.nodes.drive_to_goal import DriveToGoalParameters
from bullet_lab.ros.nodes.image_node import (
    CannyParameters,
    GoodFeaturesParameters,
    HarrisParameters,
    ImageParameters,
)
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters
from bullet_lab.ros.record.plots import PlotNoiseParameters

BAD = {
    NoisyOdomParameters: """
        std: [-0.1, much]
        model: [gaussian]
        seed: [-1]
        alpha1: [.nan]
        rate: [0]
        base_error: [2]
        stdd: [0.1]
    """,
    DriveSquaresParameters: """
        mode: [by_heart]
        sides: [0, 2.5]
        side: [-1]
        speed: [0]
        turn_speed: [0, slow]
        velocity: [0.2]
    """,
    DriveToGoalParameters: "{speed: [0.0], acceleration: [-1.0], gain: [.nan], tolerance: [0.005]}",
    PlotNoiseParameters: "{plot_period: [0], about: [[1]], ot: [x]}",
    ArucoParameters: """
        tags: [apriltag_37h10]
        width: [0]
        ids: [0 -1]
        sizes: [7=0]
        border: [-1]
        correction: [2.0]
        pixel_sigma: [-1]
        imgae: [/camera]
    """,
    ImageParameters: "window: [1]",
    CannyParameters: "{low: [-1], aperture: [4]}",
    GoodFeaturesParameters: "{max_corners: [0], quality: [0]}",
    HarrisParameters: "{k: [x], threshold: [2.0]}",
    DockParameters: "{rate: [0.0], speed: [0.2]}",
    BridgeParameters: """
        rtf: [-1, fast, .inf]
        clock_rate: [0, 1001]
        robot_pose: [1 2 3]
        paused: [maybe]
    """,
}
CASES = [
    (kind, name, value)
    for kind, text in BAD.items()
    for name, values in yaml.safe_load(text).items()
    for value in values
]


@pytest.mark.parametrize("kind, name, value", CASES)
def test_what_is_not_allowed_is_one_line_that_names_the_parameter(kind, name, value):
    given = {f"~{name}": value}
    with refuses(f"~{name}", ParameterError):
        read_parameters(kind, lambda key, default=None: given.get(key, default), {name})
