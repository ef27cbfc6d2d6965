"""Seeds of several random sources from one."""

from __future__ import annotations

import numpy as np


def derived_seed(seed: int, index: int) -> int:
    """Return the seed, within 31 bits, of one of several sources that share nothing.

    Unlike seed + index, those of neighbouring seeds have none in common.

    Args:
        seed: of all sources, >= 0.
        index: which one, >= 0.

    >>> derived_seed(1, 0), derived_seed(1, 1)
    (917752063, 594516694)
    """
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0]) >> 1
