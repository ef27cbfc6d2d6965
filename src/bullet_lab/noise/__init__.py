"""Noise and systematic errors of odometry: paths, moments, likelihood and calibration."""

from bullet_lab.noise import random_walk  # noqa: F401 - registers its model
