"""Random numbers for sensors."""

from __future__ import annotations

from zlib import crc32

import numpy as np


class StepNoise:
    """Random numbers that follow from a seed, a name and the simulated time, and nothing else.

    What a sensor reads at some time does not depend on who listened before, and a world that
    is run again gives the same readings.

    Args:
        seed: any whole number from 0 on.
        name: of whoever wants the numbers.
    """

    def __init__(self, seed: int, name: str):
        key = np.random.SeedSequence([seed, crc32(name.encode())]).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._state = self._bits.state

    def at(self, step: int) -> np.random.Generator:
        """Return a generator for one step; the next call changes it."""
        # The highest word of a counter that is counted up with every four numbers.
        self._state["state"]["counter"][3] = step
        self._bits.state = self._state
        return self._generator
