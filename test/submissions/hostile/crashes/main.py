#!/usr/bin/env python3
"""Divides by zero."""

print(1 / 0)
