"""Thousands of noisy versions of one path, at every level of noise."""
