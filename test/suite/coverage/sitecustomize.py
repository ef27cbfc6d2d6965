"""Counts coverage in each Python process that the tests start."""

import coverage

coverage.process_startup()
