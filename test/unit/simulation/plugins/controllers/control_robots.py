"""Robots of our own for tests of ros_control, and their plugins ready for controllers."""

import math
from pathlib import Path

import yaml
from shared import PACKAGE

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlParameters
from bullet_lab.simulation.plugins.controllers.joints import VELOCITY
from bullet_lab.simulation.plugins.ros_control import RosControl
from bullet_lab.simulation.world.urdf import read_urdf

BOX_INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>'
WHEEL_INERTIA = '<inertia ixx="2e-4" ixy="0" ixz="0" iyy="2e-4" iyz="0" izz="3e-4"/>'
TRANSMISSION = """
  <transmission name="{joint}_trans">
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="{joint}"><hardwareInterface>{interface}</hardwareInterface></joint>
    <actuator name="{joint}_motor"><mechanicalReduction>1</mechanicalReduction></actuator>
  </transmission>"""
WHEEL = """
  <link name="{side}_wheel">
    <inertial><mass value="0.2"/>{inertia}</inertial>
    <collision>
      <origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="0.06" length="0.01"/></geometry>
    </collision>
  </link>
  <joint name="{side}_wheel_joint" type="continuous">
    <parent link="base_link"/><child link="{side}_wheel"/>
    <origin xyz="0 {y} 0.06"/><axis xyz="0 1 0"/>
    <limit effort="5" velocity="50"/>
  </joint>"""
TURNTABLE = """
  <link name="turntable"><inertial><mass value="0.2"/>{inertia}</inertial></link>
  <joint name="turntable_joint" type="{kind}">
    <parent link="base_link"/><child link="turntable"/>
    <origin xyz="0 0 0.12"/><axis xyz="0 0 1"/>
    {limit}
  </joint>"""
CASTER = """
    <collision name="{name}">
      <origin xyz="{x} 0 0.02"/><geometry><sphere radius="0.02"/></geometry>
    </collision>"""
RADIUS, LENGTH, WIDTH = 0.06, 0.5, 0.4
PLACES = {
    "fl": (0.5 * LENGTH, 0.5 * WIDTH),
    "fr": (0.5 * LENGTH, -0.5 * WIDTH),
    "rl": (-0.5 * LENGTH, 0.5 * WIDTH),
    "rr": (-0.5 * LENGTH, -0.5 * WIDTH),
}
LEG = """
  <link name="{name}_fork">
    <inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3"/></inertial>
  </link>
  <joint name="{name}_steering" type="{kind}">
    <origin xyz="{x} {y} {radius}"/><parent link="base_link"/><child link="{name}_fork"/>
    <axis xyz="0 0 1"/><limit lower="{least}" upper="{most}" effort="20" velocity="12"/>
  </joint>
  <link name="{name}_wheel">
    <inertial><mass value="0.5"/><inertia ixx="5e-4" iyy="9e-4" izz="5e-4"/></inertial>
    <collision><origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="{radius}" length="0.004"/></geometry></collision>
  </link>
  <joint name="{name}_axle" type="continuous">
    <origin xyz="0 {offset} 0"/><parent link="{name}_fork"/><child link="{name}_wheel"/>
    <axis xyz="0 1 0"/><limit effort="20" velocity="60"/>
  </joint>"""
PLUGIN = """
  <gazebo><plugin name="control" filename="libgazebo_ros_control.so">{tags}</plugin></gazebo>"""


def robot_urdf(
    interface="hardware_interface/VelocityJointInterface",
    turntable="hardware_interface/EffortJointInterface",
    kind="revolute",
    limit='<limit lower="-2" upper="2" effort="3" velocity="4"/>',
    tags="<robotNamespace>/bot</robotNamespace>",
):
    """Return a robot of two wheels 0.3 m apart, two sliding casters and a turntable."""
    casters = "".join(CASTER.format(name=f"c{x}", x=x) for x in (-0.12, 0.12))
    wheels = "".join(
        WHEEL.format(side=side, y=y, inertia=WHEEL_INERTIA)
        for side, y in (("left", 0.15), ("right", -0.15))
    )
    transmissions = "".join(
        TRANSMISSION.format(joint=f"{name}_joint", interface=told)
        for name, told in (
            ("left_wheel", interface),
            ("right_wheel", interface),
            ("turntable", turntable),
        )
    )
    return f"""<robot name="bot">
  <link name="base_link">
    <inertial><origin xyz="0 0 0.06"/><mass value="3"/>{BOX_INERTIA}</inertial>
    <collision name="box">
      <origin xyz="0 0 0.07"/><geometry><box size="0.3 0.2 0.08"/></geometry>
    </collision>{casters}
  </link>
  <link name="top"/>
  <joint name="top_joint" type="fixed">
    <parent link="base_link"/><child link="top"/><origin xyz="0 0 0.2"/>
  </joint>{wheels}{TURNTABLE.format(inertia=WHEEL_INERTIA, kind=kind, limit=limit)}{transmissions}
  <gazebo reference="base_link"><mu1>0.0</mu1><mu2>0.0</mu2></gazebo>{PLUGIN.format(tags=tags)}
</robot>"""


def base_urdf(
    fork=VELOCITY, axle=VELOCITY, kind="continuous", least=-2, most=2, offset=0.0, rear="", tags=""
):
    """A base on four steered wheels, which are `offset` outside of their forks."""
    legs = ""
    for name, (x, y) in PLACES.items():
        out = math.copysign(offset, y)
        sizes = {"radius": RADIUS, "least": least, "most": most}
        sizes["kind"] = rear if rear and x < 0.0 else kind
        legs += LEG.format(name=name, x=x, y=y - out, offset=out, **sizes)
        for joint, interface in (("steering", fork), ("axle", axle)):
            legs += TRANSMISSION.format(joint=f"{name}_{joint}", interface=interface)
    return f"""<robot name="base"><link name="base_link">
      <inertial><origin xyz="0 0 0.1"/><mass value="10"/>
        <inertia ixx="0.2" iyy="0.3" izz="0.4"/></inertial>
      <collision><origin xyz="0 0 0.2"/><geometry><box size="0.4 0.3 0.1"/></geometry></collision>
    </link>{legs}
    <gazebo><plugin name="control" filename="libgazebo_ros_control.so">{tags}</plugin></gazebo>
    </robot>"""


def control_of(instance):
    """Return the plugin of a robot."""
    return next(plugin for plugin in instance.plugins if isinstance(plugin, RosControl))


def spawn(simulation, parameters=None, height=0.0, **robot):
    """Put the robot into a simulation; return it, and the manager of its controllers."""
    urdf = robot_urdf(**robot)
    instance = simulation.add(read_urdf(urdf, "bot"), pose=Pose((0.0, 0.0, height)), namespace="")
    return instance, control_of(instance).configure(urdf, parameters or {})


def listen(output):
    """Return a list that grows with the samples of an output."""
    samples = []
    output.connect(samples.append)
    return samples


def run(manager, name, **parameters):
    """Load and start a controller by its parameters, and return it."""
    controller = manager.load(name, ControlParameters(parameters, f"/bot/{name}"))
    manager.switch([name], [])
    return controller


CASES = yaml.safe_load((Path(__file__).parent / "controllers.yaml").read_text())
"""Controllers on robots, and their commands."""
CAR = yaml.safe_load((PACKAGE / "test/drives/car.yaml").read_text())["drive"]
"""Parameters of the car's controller."""


def spawn_car(simulation):
    """Put a car into a simulation; return it, and the manager of its controllers."""
    urdf = (PACKAGE / "test/drives/car.urdf").read_text()
    car = simulation.add(read_urdf(urdf, "car"))
    return car, control_of(car).configure(urdf, {})


def spawn_base(simulation, parameters=None, **robot):
    """Put a base on steered wheels into a simulation; return it, and its controllers' manager."""
    urdf = base_urdf(**robot)
    base = simulation.add(read_urdf(urdf, "base"))
    return base, control_of(base).configure(urdf, parameters or {})
