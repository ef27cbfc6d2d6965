"""Looks at what the lab uses in a ROS with packages of its own; see scripts/platform.sh catkin.

Usage: own_packages.py PREFIX STAND_INS
"""

import importlib
import sys
import tempfile
from pathlib import Path

import rospkg

from bullet_lab.ros.messages.gazebo_types import control_msg, control_srv, kobuki_msg, msg, srv
from bullet_lab.simulation.world.urdf import expand_xacro

XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="folder" value="$(find bullet_lab)"/><link name="${folder[:1]}${2 * 3}"/>
</robot>"""


def main():
    """Fail with a line for what is not as it should be."""
    prefix, folder = map(Path, sys.argv[1:])
    names = [one.name for one in folder.iterdir()]
    for name in names:
        found = Path(rospkg.RosPack().get_path(name))
        assert prefix in found.parents, f"{name} is {found}"
    for module in (msg, srv, control_msg, control_srv, kobuki_msg):
        assert prefix in Path(module.__file__).parents, f"{module.__file__} is used"
    compared = sum(map(compare, names))
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "robot.urdf.xacro"
        path.write_text(XACRO)
        assert 'name="/6"' in expand_xacro(path), "xacro does not find packages"
    print(f"{len(names)} packages, {compared} types are the same as ours")


def compare(name):
    """Compare the types of a package with those of the same name here; return their number."""
    count = 0
    for part in ("msg", "srv"):
        try:
            theirs = importlib.import_module(f"{name}.{part}")
        except ImportError:
            continue
        ours = importlib.import_module(f"bullet_lab.{part}")
        for kind in sorted({*vars(ours)} & {*vars(theirs)}):
            if hasattr(getattr(ours, kind), "_md5sum"):
                pair = getattr(ours, kind)._md5sum, getattr(theirs, kind)._md5sum
                assert len({*pair}) == 1, f"{name}/{kind} is another one"
                count += 1
    return count


if __name__ == "__main__":
    main()
