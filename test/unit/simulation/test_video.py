import itertools

import cv2
import numpy as np
import pytest
from shared import cases

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.video import HEIGHT, RATE, WIDTH, Video, VideoError, overview, pixels_of


def test_a_second_is_twenty_pictures_with_the_robot_and_its_path(world, robot, tmp_path):
    path = tmp_path / "folder" / "video.mp4"
    video = Video(world, path)
    robot.command("cmd_vel", PlanarCommand(vx=0.5))
    world.run_for(1.0)
    video.close()
    capture = cv2.VideoCapture(str(path))
    pictures = []
    while True:
        there, picture = capture.read()
        if not there:
            break
        pictures.append(picture.astype(int))
    assert len(pictures) == RATE
    assert pictures[0].shape == (HEIGHT, WIDTH, 3)
    blue, green, red = np.moveaxis(pictures[-1], 2, 0)
    # The robot's body is green, its path orange.
    assert (green > red + 60).sum() > 100
    assert (red > blue + 60).sum() > 50


@cases("high: [[1.0, 1.0, 1.0], [5.0, 1.0, 0.5], [1.0, 9.0, 3.0]]")
def test_a_view_holds_its_box_and_no_more(high):
    corners = np.array(list(itertools.product(*((0.0, most) for most in high))))
    pixels = pixels_of(corners, overview(corners[0], corners[-1]))
    beside = np.minimum(pixels, (WIDTH, HEIGHT) - pixels).min()
    assert -1 <= beside <= 1


def test_a_file_that_cannot_be_written(world, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(VideoError, match="file"):
        Video(world, tmp_path / "file" / "video.mp4")
    (tmp_path / "video.mp4").mkdir()
    with pytest.raises(VideoError, match="cannot write"):
        Video(world, tmp_path / "video.mp4")
