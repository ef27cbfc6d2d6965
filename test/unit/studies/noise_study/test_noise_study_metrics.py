"""The metrics, path by path: by definition, and as evo computes them from the exported files."""

import math

import numpy as np
import pytest
from shared import cases, refuses

from bullet_lab.core import se2
from bullet_lab.core.se2 import wrap
from bullet_lab.core.trajectory import Trajectory, path_error
from bullet_lab.noise.noisy_paths import noisy_blocks, noisy_steps
from bullet_lab.noise.systematic import path_of
from bullet_lab.studies.noise_study.regions import level_rule
from bullet_lab.studies.noise_study.statistics import (
    PathMetrics,
    find_laps,
    pairs_at_distance,
    study_case,
)
from bullet_lab.studies.paths import resample, tum_text


def square(laps=1):
    """Rest, then sides of 2 m and turns on the spot to the right, at 20 Hz and 0.2 m/s."""
    drive, turn = np.zeros((200, 3)), np.zeros((60, 3))
    drive[:, 0] = 0.01
    turn[:, 2] = -math.pi / 2 / 60
    moves = np.concatenate([np.zeros((10, 3)), *[drive, turn] * 4 * laps])
    poses = se2.compose((1.0, 2.0, 0.5), path_of(moves))
    return Trajectory(7.0 + 0.05 * np.arange(len(poses)), poses)


def measured(trajectory, model, std, count=4):
    steps = noisy_steps(trajectory.poses, level_rule(model, std))
    metrics = PathMetrics(trajectory, steps, 1.0)
    (block,) = noisy_blocks(steps, np.random.default_rng(61), count, 10**7)
    estimates = [Trajectory(trajectory.stamps, p) for p in block.poses(trajectory.poses)]
    names, rows = metrics.values(block)
    return [(dict(zip(names, row)), path) for row, path in zip(rows, estimates)]


@cases("model, std, rate: [[report, 0.5, 0.9], [probabilistic, 0.2, 20.0]]")
def test_errors_and_drift_by_definition(model, std, rate):
    reference = resample(square(), rate)
    travelled = reference.travelled()
    first, second = pairs_at_distance(reference, 1.0)
    distance = travelled[second] - travelled[first]
    perfect = se2.between(reference.poses[first], reference.poses[second])
    for values, estimate in measured(reference, model, std):
        whole = path_error(reference, estimate)
        moved = se2.between(estimate.poses[first], estimate.poses[second])
        off = se2.between(perfect, moved)
        error, heading = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
        expected = {
            "ape_rmse_m": whole.ape_rmse_m,
            "ape_heading_rmse_deg": whole.heading_rmse_deg,
            "final_error_m": whole.final_error_m,
            "final_heading_error_deg": abs(whole.final_heading_error_deg),
            "rpe_rmse_m": math.sqrt(np.mean(error**2)),
            "rpe_heading_rmse_deg": math.degrees(math.sqrt(np.mean(heading**2))),
            "drift_percent": 100.0 * np.mean(error / distance),
            "drift_deg_per_m": math.degrees(np.mean(heading / distance)),
        }
        found = {name: values[name] for name in expected}
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_along_and_across_the_way():
    reference = square()
    for values, estimate in measured(reference, "report", 0.3):
        dx, dy = (estimate.poses - reference.poses).T[:2]
        # The sides of the square, as the last move on a drive left them; the first one at rest.
        headings = 0.5 - np.repeat([0, 1, 2, 3], 260) * math.pi / 2
        headings = np.concatenate([[0.5] * 11, headings])
        along = np.cos(headings) * dx + np.sin(headings) * dy
        across = np.cos(headings) * dy - np.sin(headings) * dx
        assert values["along_track_rms_m"] == pytest.approx(math.sqrt(np.mean(along**2)))
        assert values["cross_track_rms_m"] == pytest.approx(math.sqrt(np.mean(across**2)))


def test_driving_backwards_is_along_the_way_too():
    stamps = np.arange(41.0)
    poses = np.column_stack([-0.1 * stamps, 0.0 * stamps, 0.0 * stamps])
    trajectory = Trajectory(stamps, poses)
    for values, _ in measured(trajectory, "report", 0.3):
        assert values["along_track_rms_m"] > 0.01
        assert values["cross_track_rms_m"] < 1e-12


def test_closure_error_of_each_lap():
    reference = square(laps=2)
    starts, ends = find_laps(reference)
    assert starts.tolist() == [0, ends[0]]
    np.testing.assert_allclose(reference.poses[ends, :2], [[1.0, 2.0]] * 2, atol=1e-9)
    for values, estimate in measured(reference, "rate_invariant", 0.1):
        for number, (start, end) in enumerate(zip(starts, ends), start=1):
            expected = math.dist(estimate.poses[start, :2], estimate.poses[end, :2])
            assert values[f"closure_error_lap_{number}_m"] == pytest.approx(expected)


@cases("turn, count: [[0.0, 0], [340.0, 0], [355.0, 1], [365.0, 1], [-715.0, 2]]")
def test_a_lap_is_a_full_turn_either_way(turn, count):
    heading = np.radians(np.linspace(0.0, turn, 400))
    poses = np.column_stack([np.sin(heading), np.cos(heading), wrap(heading)])
    starts, ends = find_laps(Trajectory(np.arange(400.0), poses))
    assert len(ends) == len(starts) == count


def test_turning_round_and_round_is_no_end_of_laps():
    heading = 0.5 * np.arange(2000.0)
    poses = np.column_stack([0.001 * heading, 0.0 * heading, wrap(heading)])
    assert len(find_laps(Trajectory(heading, poses))[1]) == 50


def test_a_delta_beyond_the_path():
    with refuses("no two poses are 100 m apart"):
        pairs_at_distance(square(), 100.0)


def evo_values(pair):
    """APE and RPE (m and °) of a reference and an estimate, as evo computes them."""
    from evo.core import metrics

    relations = (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg)
    pairs = {
        "delta": 1.0,
        "delta_unit": metrics.Unit.meters,
        "rel_delta_tol": 0.25,
        "all_pairs": True,
        "pairs_from_reference": True,
    }
    computed = [metrics.APE(relation) for relation in relations]
    computed += [metrics.RPE(relation, **pairs) for relation in relations]
    for metric in computed:
        metric.process_data(pair)
    return [metric.get_statistic(metrics.StatisticsType.rmse) for metric in computed]


def test_evo_says_the_same_of_exported_paths(tmp_path, monkeypatch):
    # A home of its own for evo, which writes its settings there when it is imported.
    monkeypatch.setenv("HOME", str(tmp_path))
    read = pytest.importorskip("evo.tools.file_interface").read_tum_trajectory_file
    # At 0.9 Hz some poses have two others equally near to the distance.
    path, key = resample(square(), 0.9), ("report", 0.5, 0.9)
    case = study_case(path, key, np.random.default_rng(61), 4, 1.0)
    names = ("ape_rmse_m", "ape_heading_rmse_deg", "rpe_rmse_m", "rpe_heading_rmse_deg")
    # The same draws as the study's.
    for number, (values, _) in enumerate(measured(path, *key[:2])[:2]):
        pair = []
        for trajectory in (path, Trajectory(path.stamps, case.kept[number])):
            (tmp_path / "path.tum").write_text(tum_text(trajectory))
            pair.append(read(str(tmp_path / "path.tum")))
        ours = [values[name] for name in names]
        assert ours == pytest.approx(evo_values(tuple(pair)), rel=0.0, abs=1e-6)
