"""What the benchmarks share: command lines, figures, and a bridge with robots and models."""

import os
import platform
import sys
from pathlib import Path

import rospy
from bullet_lab.srv import SaveWorld, Step
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3

from bullet_lab.core.files import write_json
from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.messages.gazebo_types import srv

_TEST = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(_TEST), str(_TEST / "rostest")]
from lab_nodes import PACKAGE, Node, parser_of  # noqa: E402

INCLUDE = '<sdf version="1.6"><include><uri>model://{}</uri></include></sdf>'
# m between robots, as in the job fleet.
SPACING = 2.5
PER_ROW = 8
START_SECONDS = 60.0


def options(doc, **defaults):
    """Read the command line: `out`, the JSON file to write, and options with their defaults."""
    parser = parser_of("bench.sh", doc, **defaults)
    parser.add_argument("out", type=Path)
    wanted = parser.parse_args()
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    return wanted


def start_ros():
    """Be a node, on a ROS master of this program's own unless one is given."""
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    rospy.set_param("/use_sim_time", False)


def report(out, rows, title="", **more):
    """Print names, values in a format and what is asked for; write the values and more figures."""
    width = max(len(row[0]) for row in rows)
    print(f"\n{title:{width}} {'measured':>9} {'asked':>8}")
    for name, value, shape, asked in rows:
        print(f"{name:{width}} {value:>9{shape}} {asked:>8}".rstrip())
    write(out, {**{name: value for name, value, _, _ in rows}, **more})


def write(out, figures):
    """Write figures, with the machine that they are of."""
    machine = platform.processor() or platform.machine()
    write_json(out, {"machine": machine, "cores": os.cpu_count(), **figures})
    print(f"\nwritten to {out}")


class Bridge(Node):
    """A bridge to which robots and models are added."""

    def __init__(self, *words):
        super().__init__("pybullet_bridge", *words)
        rospy.wait_for_service("/bullet_lab/advance", START_SECONDS)
        self.step = _service("/bullet_lab/step", Step)
        self.save = _service("/bullet_lab/save_world", SaveWorld)
        self.delete = _service("/gazebo/delete_model", srv.DeleteModel)
        self.state = _service("/gazebo/get_model_state", srv.GetModelState)
        self._spawn_sdf = _service("/gazebo/spawn_sdf_model", srv.SpawnModel)
        self._spawn_urdf = _service("/gazebo/spawn_urdf_model", srv.SpawnModel)
        self._commands = []

    def add_robot(self, number, text):
        """Put a robot into the world and let it drive in circles; return its name."""
        name = f"robot{number}"
        pose = _pose(*(SPACING * place for place in reversed(divmod(number, PER_ROW))))
        rospy.set_param(f"/{name}/tf_prefix", name)
        rospy.set_param(f"/{name}/robot_description", text)
        self._spawn_urdf(name, text, name, pose, "")
        commands = rospy.Publisher(f"{name}/cmd_vel", Twist, queue_size=1, latch=True)
        commands.publish(Twist(linear=Vector3(0.2, 0.0, 0.0), angular=Vector3(0.0, 0.0, 0.3)))
        self._commands.append(commands)
        return name

    def add_model(self, name, number, kind="beacon"):
        """Put a model of the package at the n-th place of a square field, away from robots."""
        row, column = divmod(number, 32)
        self._spawn_sdf(name, INCLUDE.format(kind), "", _pose(3.0 + column, row - 16.0), "")


def urdf(name):
    """Return the description of a robot of the package."""
    return (PACKAGE / "urdf" / f"{name}.urdf").read_text()


def _service(name, kind):
    return rospy.ServiceProxy(name, kind, persistent=True)


def _pose(x, y):
    return Pose(Point(x, y, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
