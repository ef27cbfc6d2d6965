"""ros_control's message and service types, under the names that clients know them by.

Where control_msgs and controller_manager_msgs can be imported, their classes are used, else the
same definitions of this package; see `gazebo_types`.
"""

try:
    from control_msgs.msg import JointControllerState
except ImportError:
    from bullet_lab.msg import JointControllerState

try:
    from controller_manager_msgs import msg, srv

    # Not a folder that happens to be called so.
    msg.ControllerState, srv.SwitchController  # noqa: B018
except (ImportError, AttributeError):
    from bullet_lab import msg, srv

__all__ = ["JointControllerState", "msg", "srv"]
