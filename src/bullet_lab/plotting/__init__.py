"""Figures, drawn without a screen and without ROS."""
