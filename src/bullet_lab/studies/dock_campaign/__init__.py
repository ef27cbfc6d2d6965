"""Hundreds of dockings from random starts."""
