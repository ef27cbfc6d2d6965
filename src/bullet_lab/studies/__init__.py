"""Whole experiments in plain Python, without ROS: the same files as the jobs, to the byte."""
