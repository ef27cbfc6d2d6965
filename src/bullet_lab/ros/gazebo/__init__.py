"""Gazebo's services and topics, offered and called."""
