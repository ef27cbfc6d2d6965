"""Basics of the package: poses, trajectories, cameras, files, parameters; no ROS."""
