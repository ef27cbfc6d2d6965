"""What Python in a course's terminal does before it runs a script: old names of OpenCV work.

Noetic's OpenCV is 4.2; Debian's later ones have dropped some of its names.
"""

import importlib.util
import sys


def add_old_names(cv2):
    """Give cv2 the names of version 4.2 that it has lost."""
    aruco = getattr(cv2, "aruco", None)
    if aruco is not None and not hasattr(aruco, "drawAxis"):
        aruco.drawAxis = cv2.drawFrameAxes


class OldNames:
    """Finds cv2 once, and adds the names as it is loaded."""

    def find_spec(self, name, path=None, target=None):
        """Return how cv2 is loaded; None for all else."""
        if name != "cv2":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None:
            load = spec.loader.exec_module

            def load_and_add(module):
                load(module)
                add_old_names(module)

            spec.loader.exec_module = load_and_add
        return spec


sys.meta_path.insert(0, OldNames())
