"""Driving to goals on a map."""
