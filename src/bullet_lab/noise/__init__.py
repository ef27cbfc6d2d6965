"""Noise on odometry that accumulates as the error of real odometry does."""
