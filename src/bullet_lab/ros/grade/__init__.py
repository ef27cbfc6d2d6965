"""Runs submissions to exercises in the simulation and marks them."""
