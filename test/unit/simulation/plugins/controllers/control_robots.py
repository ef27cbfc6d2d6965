"""A robot of our own for tests of ros_control, and its plugin ready for controllers."""

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.controllers import ControlParameters
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
