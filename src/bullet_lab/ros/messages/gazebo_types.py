"""Gazebo's message and service types, under the name that clients know them by.

Where gazebo_msgs can be imported (Gazebo's own, or the stand-in that scripts/setup.sh builds),
its classes are used, so that topics have the type names that Gazebo's have. Elsewhere the same
definitions of this package are: services are answered all the same, since a service client
checks the md5 sum alone.
"""

try:
    from gazebo_msgs import msg, srv

    # Not a folder that happens to be called so.
    msg.ModelStates, srv.SpawnModel  # noqa: B018
except (ImportError, AttributeError):
    from bullet_lab import msg, srv

__all__ = ["msg", "srv"]
