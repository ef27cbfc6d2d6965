"""What a driven square comes down to, for summary.json."""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

from bullet_lab.numerics.metrics import path_error
from bullet_lab.numerics.square_path import analyse
from bullet_lab.numerics.trajectory import Trajectory


def squares_summary(
    perfect: Optional[Trajectory], pairs: Optional[Tuple[Trajectory, Trajectory]]
) -> Dict[str, Any]:
    """Return the figures of a driven square; null where there is nothing to measure.

    Args:
        perfect: the whole perfect path.
        pairs: the perfect and the noisy path at common stamps.
    """
    square = None if perfect is None else analyse(perfect)
    error = None if pairs is None else path_error(*pairs)
    return {
        "side_lengths_m": [] if square is None else square.side_lengths_m,
        "turns_deg": [] if square is None else square.turns_deg,
        "closure_error_m": None if square is None else square.closure_error_m,
        "path_length_m": None if perfect is None else perfect.length(),
        "final_error_m": None if error is None else error.final_error_m,
        "final_heading_error_deg": None if error is None else error.final_heading_error_deg,
        "ape_rmse_m": None if error is None else error.ape_rmse_m,
        "ape_max_m": None if error is None else error.ape_max_m,
        "heading_rmse_deg": None if error is None else error.heading_rmse_deg,
        "pairs": 0 if pairs is None else len(pairs[0]),
    }
