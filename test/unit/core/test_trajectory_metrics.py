import math

import numpy as np
import pytest

from bullet_lab.core.trajectory import MetricsError, Trajectory, closure_error, path_error

REFERENCE = Trajectory([0, 1, 2, 3], [[0, 0, 0], [1, 0, 0], [2, 0, 3.1], [2, 2, -3.1]])


def test_errors_by_hand():
    estimate = Trajectory(
        REFERENCE.stamps, REFERENCE.poses + [[0, 0, 0], [0.3, 0.4, 0], [0, -1, 0.1], [2, 0, -0.2]]
    )
    error = path_error(REFERENCE, estimate)
    np.testing.assert_allclose(error.error, [0.0, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(error.heading_error, [0.0, 0.0, 0.1, -0.2])
    np.testing.assert_allclose(error.travelled, [0.0, 1.0, 2.0, 4.0])
    assert error.ape_rmse_m == pytest.approx(math.sqrt(5.25 / 4))
    assert error.ape_mean_m == pytest.approx(0.875)
    assert error.ape_median_m == pytest.approx(0.75)
    assert error.ape_std_m == pytest.approx(math.sqrt(5.25 / 4 - 0.875**2))
    assert (error.ape_min_m, error.ape_max_m) == (0.0, pytest.approx(2.0))
    assert error.heading_rmse_deg == pytest.approx(math.degrees(math.sqrt(0.05 / 4)))
    assert error.final_error_m == pytest.approx(2.0)
    assert error.final_heading_error_deg == pytest.approx(math.degrees(-0.2))


def test_heading_errors_are_wrapped():
    turned = REFERENCE.poses * [1, 1, -1]
    error = path_error(REFERENCE, Trajectory(REFERENCE.stamps, turned))
    assert error.final_heading_error_deg == pytest.approx(math.degrees(6.2) - 360.0)
    assert error.ape_max_m == 0.0


def test_other_stamps_are_refused():
    for stamps in ([0, 1, 2], [0, 1, 2, 3.001]):
        estimate = Trajectory(stamps, REFERENCE.poses[: len(stamps)])
        with pytest.raises(MetricsError, match="same stamps"):
            path_error(REFERENCE, estimate)


def test_closure_error_is_from_start_to_end():
    assert closure_error(REFERENCE) == pytest.approx(math.sqrt(8.0))
