"""Drivers of robots: in squares, and to goals."""
