"""Driving into a dock and stopping before its marker; no ROS, no simulation."""
