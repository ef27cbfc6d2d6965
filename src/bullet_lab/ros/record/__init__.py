"""Nodes that record what a job does, and plot it."""
