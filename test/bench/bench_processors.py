"""What changes with the processor: each library is told in turn that it is on an older one.

Prints which sums, functions and pictures have other bits then; scripts/bench.sh processors.
--here: computes them, as this process is told to, and prints their digests.
"""

import hashlib
import json
import math
import os
import subprocess
import sys

import cv2
import numpy as np
import scipy.linalg
from common import options

from bullet_lab.core.files import write_json
from bullet_lab.ros.verify import PROCESSORS
from bullet_lab.simulation.simulation import Simulation, View, take_picture

PLAIN = PROCESSORS["plain"]
DRAWING = ("LP_NATIVE_VECTOR_WIDTH", "GALLIUM_OVERRIDE_CPU_CAPS")
TOLD = {
    "as it is": {},
    "libm (GLIBC_TUNABLES)": {"GLIBC_TUNABLES": PLAIN["GLIBC_TUNABLES"]},
    "numpy (NPY_DISABLE_CPU_FEATURES)": {n: v for n, v in PLAIN.items() if n.startswith("NPY")},
    "OpenBLAS (OPENBLAS_CORETYPE=Prescott)": {"OPENBLAS_CORETYPE": "Prescott"},
    "OpenBLAS (OPENBLAS_CORETYPE=Haswell)": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenCV (OPENCV_CPU_DISABLE, OPENCV_IPP)": {
        n: v for n, v in PLAIN.items() if n.startswith("OPENCV")
    },
    "llvmpipe (LP_NATIVE_VECTOR_WIDTH=128)": {"LP_NATIVE_VECTOR_WIDTH": "128"},
    "llvmpipe (the same, GALLIUM_OVERRIDE_CPU_CAPS=sse3)": {n: PLAIN[n] for n in DRAWING},
}
WORLD = "package://bullet_lab/worlds/docking.world"
ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
VIEW = View(eye=(0.5, -0.3, 0.3), target=(4.0, 0.0, 0.2), width=320, height=240)


def results():
    """Compute some of everything; return it by what computes it."""
    random = np.random.default_rng(1)
    x = 3.0 * random.normal(size=20_000)
    y, matrix = x[::-1], random.normal(size=(60, 60))
    image = (255.0 * random.random((480, 640))).astype(np.uint8)
    found = {
        "numpy's random numbers": x,
        "math.sin": list(map(math.sin, x)),
        "math.exp": list(map(math.exp, x)),
        "math.atan2": list(map(math.atan2, x, y)),
        "math.hypot": list(map(math.hypot, x, y)),
        "numpy.sin": np.sin(x),
        "numpy.exp": np.exp(x),
        "numpy.arctan2": np.arctan2(x, y),
        "numpy.hypot": np.hypot(x, y),
        "numpy.mean": x.mean(),
        "products of 3 x 3": matrix[:3, :3] @ matrix[3:6, :3],
        "products of 60 x 60": matrix @ matrix,
        "numpy.linalg.solve": np.linalg.solve(matrix, x[:60]),
        "scipy.linalg.cholesky": scipy.linalg.cholesky(matrix @ matrix.T + np.eye(60)),
        "cv2.GaussianBlur": cv2.GaussianBlur(image, (5, 5), 1.2),
        "cv2.adaptiveThreshold": cv2.adaptiveThreshold(image, 255, 0, 0, 15, 3),
        "cv2.Canny": cv2.Canny(image, 50, 150),
        "cv2.cornerHarris": cv2.cornerHarris(image, 2, 3, 0.04),
    }
    with Simulation.of(WORLD) as simulation:
        robot = simulation.spawn(ROBOT)
        simulation.run_for(1.0)
        found["a robot after 1 s"] = [*robot.pose().position, robot.pose().yaw]
        found["a picture"] = take_picture(simulation, VIEW, samples=1)
    return found


def main():
    """Compare each with the first, print and write JSON."""
    wanted = options(__doc__, here=False)
    if wanted.here:
        all_bytes = {name: np.array(value).tobytes() for name, value in results().items()}
        print(json.dumps({n: hashlib.sha256(one).hexdigest() for n, one in all_bytes.items()}))
        return
    found = {}
    for name, variables in TOLD.items():
        command = [sys.executable, __file__, str(wanted.out), "--here"]
        done = subprocess.run(
            command, env={**os.environ, **variables}, stdout=subprocess.PIPE, check=True
        )
        found[name] = json.loads(done.stdout)
        usual = found["as it is"]
        others = [what for what, of in found[name].items() if of != usual[what]]
        print(f"{name}: {', '.join(others) or 'nothing'}", flush=True)
    write_json(wanted.out, found)


if __name__ == "__main__":
    main()
