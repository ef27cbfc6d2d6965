"""Steps between messages of odometry, and what is remarked of errors that were found."""

import math
from pathlib import Path

import numpy as np
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.docking.types import (
    CalibrationErrors,
    Learned,
    Odometry,
    OdometryBuffer,
    motion_step,
)


def in_parts_per_million(step):
    return [*step.step, *(1e6 * step.covariance).ravel().tolist()]


def test_what_odometry_tells_is_as_before():
    buffer = OdometryBuffer()
    found = {"before": buffer.pose_at(0.0)}
    for stamp in np.arange(0.0, 6.0, 0.4).tolist():
        last = buffer.last
        pose = math.sin(stamp), 0.3 * stamp, 3.0 + 0.2 * stamp
        buffer.add(Odometry(stamp, pose, np.eye(3) if stamp > 5.0 else None))
        if last is not None:
            step = motion_step(last, buffer.last)
            found[f"step {stamp:g}"] = in_parts_per_million(step)
    found["both"] = in_parts_per_million(step.then(motion_step(buffer.last, last)))
    asked = 2.75, 2.8 - 5e-6, 2.8 - 5e-7, 3.2 - 5e-10, 3.2, 3.21, 3.55, 4.3, 5.6, 7.0
    found["at"] = {stamp: buffer.pose_at(stamp) for stamp in asked}
    # Of messages from long before the last, one stays.
    for stamp in (8.0, 9.0, 99.0):
        buffer.add(Odometry(stamp, (stamp, 0.0, 0.0)))
    found["late"] = {stamp: buffer.pose_at(stamp) for stamp in (8.9, 9.1)}
    assert_as_before(lines_of(found, ""), Path(__file__).with_name("odometry.txt"))


@cases("""
said, least:
  - ["+0.3° roll, -0.3° pitch, +0.3° yaw, -5 mm height, +1 % way, -2 % turn, +0.3°/m drift", 1.001]
  - ["", 0.999]
""")
def test_what_is_large_and_certain_is_remarked(said, least):
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    values = least * signs * [*np.radians([0.3] * 3), 0.005, 0.01, 0.02, math.radians(0.3)]
    for deviations, remarks in ((3.99, ""), (4.01, said)):
        errors = map(Learned, values.tolist(), np.abs(values / deviations).tolist())
        assert CalibrationErrors(*errors).remarks() == remarks
