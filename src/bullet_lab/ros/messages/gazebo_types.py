"""The message and service types of Gazebo and ros_control, under the names that clients use.

If gazebo_msgs, control_msgs and controller_manager_msgs can be imported (the real packages, or the
stand-ins that scripts/setup.sh builds), their classes are used, so that topics have their type
names. Otherwise the same definitions of this package are used: a service client compares only the
md5 sum.
"""

try:
    from gazebo_msgs import msg, srv

    # An unrelated folder of that name has no such attributes.
    msg.ModelStates, srv.SpawnModel  # noqa: B018
except (ImportError, AttributeError):
    from bullet_lab import msg, srv

try:
    from control_msgs.msg import JointControllerState
except ImportError:
    from bullet_lab.msg import JointControllerState

try:
    from control_msgs import msg as arm_msg
    from control_msgs import srv as arm_srv

    arm_msg.FollowJointTrajectoryAction, arm_srv.QueryTrajectoryState  # noqa: B018
except (ImportError, AttributeError):
    # Actions have no others: their controllers are refused.
    arm_msg = arm_srv = None

try:
    from controller_manager_msgs import msg as control_msg
    from controller_manager_msgs import srv as control_srv

    control_msg.ControllerState, control_srv.SwitchController  # noqa: B018
except (ImportError, AttributeError):
    from bullet_lab import msg as control_msg
    from bullet_lab import srv as control_srv

__all__ = ["JointControllerState", "arm_msg", "arm_srv", "control_msg", "control_srv", "msg", "srv"]
