"""Gazebo's services and topics, offered and called."""

from bullet_lab.moved import names_of

__getattr__ = names_of(__name__, "bullet_lab.ros.gazebo.interface")
