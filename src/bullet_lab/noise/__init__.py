"""Noise and systematic errors of odometry: paths, moments, likelihood and calibration."""
