"""The pinhole camera, against OpenCV's."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared import cases

from bullet_lab.core import pinhole


@cases("""
changes:
  - {width: 0}
  - {height: 0}
  - {fx: 0.0}
  - {fy: 0.0}
  - {cx: .nan}
  - {distortion: [0.0]}
""")
def test_what_is_no_camera_is_refused(changes):
    least = pinhole.PinholeCamera(1, 1, 0.5, 0.5, 0.0, 0.0)
    with pytest.raises(pinhole.PinholeError):
        replace(least, **changes)


def test_a_distorted_picture_is_opencvs_and_newtons_method_finds_its_rays(monkeypatch):
    lens = (-0.3, 0.1, 0.04, -0.06, 0.05)
    camera = pinhole.PinholeCamera(640, 480, 500.0, 510.0, 320.0, 240.0, lens)
    points = np.random.default_rng(1).uniform((-1.0, -1.0, 1.2), (1.0, 1.0, 2.4), (50, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(lens))
    assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)
    # Its derivatives are right: otherwise it would need more steps.
    with monkeypatch.context() as patch:
        patch.setattr(pinhole, "MAX_STEPS", 3)
        assert_allclose(camera.slopes(expected), points[:, :2] / points[:, 2:], atol=1e-12)
    # Up to the fold of the picture, and no steeper than 87 degrees.
    pixels = np.multiply.outer(np.linspace(0.0, 15_000.0, 301), (0.8, -0.6)) + (320.0, 240.0)
    for k1, last in ((-0.3, 8), (0.001, 282), (0.0, 301)):
        seen = replace(camera, distortion=(k1, 0.0, 0.0, 0.0, 0.0)).slopes(pixels)
        assert np.isfinite(seen).all(axis=1).tolist() == [True] * last + [False] * (301 - last)
