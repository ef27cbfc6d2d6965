"""Draws a red square with EGL and says how it went; run as a process of its own."""

from __future__ import annotations

import os
import sys

import numpy as np

from bullet_lab.errors import LabError

DRAWN = "a red square was drawn"


def main() -> int:
    """Print `DRAWN` and return 0, or print what is wrong and return 1.

    What the driver says goes to standard error. It may end the process itself.
    """
    from bullet_lab.simulation.engine import pybullet
    from bullet_lab.simulation.rendering.engine import load_egl

    client = pybullet.connect(pybullet.DIRECT)
    try:
        load_egl(client, sys.stderr)
    except LabError as error:
        print(error)
        return 1
    shape = pybullet.createVisualShape(
        pybullet.GEOM_BOX, halfExtents=(1, 1, 1), rgbaColor=(1, 0, 0, 1), physicsClientId=client
    )
    pybullet.createMultiBody(0, -1, shape, physicsClientId=client)
    view = pybullet.computeViewMatrix((-3, 0, 0), (0, 0, 0), (0, 0, 1))
    lens = pybullet.computeProjectionMatrixFOV(40, 1, 0.1, 10)
    image = pybullet.getCameraImage(
        32, 32, view, lens, renderer=pybullet.ER_BULLET_HARDWARE_OPENGL, physicsClientId=client
    )
    red, green, _, _ = np.reshape(image[2], (32, 32, 4))[16, 16]
    if not (red > 60 and green < 0.5 * red):
        print(f"a red square came out as ({red}, {green}, …)")
        return 1
    print(DRAWN)
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    # Not through the driver's own farewell, which may fail.
    os._exit(status)
