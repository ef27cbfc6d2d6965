"""The benchmark's figures and the fit, against closed forms, on wheels that roll ideally."""

import math

import numpy as np
import pytest
from alike import lines_of
from scipy import stats
from shared import cases, refuses
from study_runs import names_in

from bullet_lab.core.se2 import SQUARE_RADIUS, ellipse_points
from bullet_lab.drive import Square
from bullet_lab.noise.systematic import SystematicErrors
from bullet_lab.studies.study import UnfinishedError
from bullet_lab.studies.umbmark.estimate import (
    PARAMETERS,
    Benchmark,
    SquareRun,
    centre_ellipse,
    closed_forms,
    fit,
    perfect_square,
    return_errors,
)
from bullet_lab.studies.umbmark.robots import (
    BenchmarkSettings,
    IdealRobot,
    drive_square,
    multipliers,
)
from bullet_lab.studies.umbmark.study import (
    calibrate_robot,
    campaign_summary,
    describe,
    describe_campaign,
    draw_robot,
    run_umbmark,
)

BASE = 0.38
NONE = SystematicErrors()
QUIET = BenchmarkSettings(runs=2, std=0.0)


def errors(diameter=0.0, base=0.0):
    return SystematicErrors(diameter_error=diameter, base_error=base)


def ideal_runs(wrong, side=4.0, correction=NONE):
    runs = []
    for turn in (0.5, -0.5):
        robot = IdealRobot(BASE, wrong, correction)
        runs.append(drive_square(robot, Square(side=side, speed=1.0, turn_speed=turn), "run"))
    return runs


def measured(ends, side=1.0, base=BASE):
    """Runs at squares that were perfect by the odometry, by (direction, true end)."""
    start = (0.0, 0.0, 0.0)
    return [
        SquareRun("run", perfect_square(side, way), start, tuple(end), base) for way, end in ends
    ]


# A wrong base makes each turn too small by alpha; unequal wheels bend each side left by beta.
SMALL = 1e-5
ALPHA = 0.5 * math.pi * (1.0 - 1.0 / (1.0 + SMALL))
BETA = 4.0 * SMALL / BASE


@pytest.mark.parametrize(
    ("wrong", "offset", "end"),
    [
        (errors(base=SMALL), 8.0 * ALPHA, (-1.0, 1.0, -0.5)),
        (errors(diameter=SMALL), 8.0 * BETA, (1.0, -1.0, 0.5)),
    ],
)
def test_small_errors_leave_both_centres_where_the_closed_form_has_them(wrong, offset, end):
    counter, clockwise = ideal_runs(wrong)
    assert (counter.direction, clockwise.direction) == ("ccw", "cw")
    assert counter.return_error() == pytest.approx(np.multiply(offset, end), rel=2e-3)
    assert clockwise.return_error()[:2] == pytest.approx((-offset, -offset), rel=2e-3)


def test_the_figures_are_those_of_the_paper():
    cw, ccw = (-0.05, -0.03, 0.0), (-0.01, 0.02, 0.0)
    found = closed_forms(measured([("cw", cw), ("ccw", ccw), ("ccw", ccw)], base=0.4), 1.0)
    alpha, beta = -0.06 / -4.0, -0.04 / -4.0
    radius = 0.5 / math.sin(0.5 * beta)
    expected = {
        "alpha_deg": math.degrees(alpha),
        "beta_deg": math.degrees(beta),
        "e_b": 90.0 / (90.0 - math.degrees(alpha)),
        "e_d": (radius + 0.2) / (radius - 0.2),
        "e_max_syst_m": math.hypot(0.05, 0.03),
        "r_ccw_m": math.hypot(0.01, 0.02),
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)


@cases("diameter, base: [[0.001, -0.03], [-0.01, 0.005]]")
def test_the_fit_recovers_what_was_injected_and_the_correction_undoes_it(diameter, base):
    wrong = errors(diameter, base)
    before = Benchmark.of(ideal_runs(wrong))
    found = before.estimate.errors
    assert values_of(found) == pytest.approx((diameter, base), rel=1e-4)
    after = Benchmark.of(ideal_runs(wrong, correction=found))
    assert after.figures["e_max_syst_m"] < 1e-4 * before.figures["e_max_syst_m"]


def test_corrected_parameters_keep_the_mean_of_the_diameters():
    corrected = multipliers(errors(0.01, 0.02))
    left, right, base = corrected.values()
    assert (left, right) == pytest.approx((2.0 / 2.01, 2.0 / (1.0 / 1.01 + 1.0)))
    assert left + right == pytest.approx(2.0)
    assert base == 1.02


def perturbed(generator, root):
    """Ten runs of wheels that are right, with noise at their ends; clockwise ones are mirrored."""
    ends = []
    for way, mirror in (("ccw", 1.0), ("cw", -1.0)):
        noise = generator.standard_normal((5, 3)) @ root.T
        ends += [(way, end * (1.0, mirror, mirror)) for end in noise]
    return measured(ends)


def test_an_interval_is_that_of_the_means_of_both_ways():
    root = 1e-4 * np.array(((1.0, 0.0, 0.0), (-0.5, 2.0, 0.0), (0.3, 1.0, 0.5)))
    runs = perturbed(np.random.default_rng(4), root)
    found = fit(runs)
    # In linear order an estimate is the sum of the means of two numbers, one for each way, of
    # which each run has its own: what it changes where its end is moved.
    ways = np.array([run.direction for run in runs])
    estimates = values_of(found.errors)
    shares = np.array([estimates - values_of(fit(without(runs, k)).errors) for k in range(10)])
    for own, (low, high), estimate in zip(shares.T, found.intervals.values(), estimates):
        variance = sum(own[ways == way].var(ddof=1) * 5.0 for way in ("cw", "ccw"))
        reach = stats.t.ppf(0.975, 8) * math.sqrt(variance)
        assert 0.5 * (high - low) == pytest.approx(reach, rel=0.01)
        assert 0.5 * (high + low) == pytest.approx(estimate)


def values_of(found):
    return np.array([getattr(found, name) for name in PARAMETERS])


def without(runs, number):
    """The runs without the noise of one of them."""
    run, others = runs[number], list(runs)
    others[number] = SquareRun(run.name, run.odometry, run.start, run.start, run.base)
    return others


def test_a_centre_lies_within_its_ellipse_by_hotelling():
    points = np.random.default_rng(6).normal(0.0, (1.0, 2.0), (6, 2))
    shape = centre_ellipse(points)
    t_squared = 2.0 * 5.0 / 4.0 * stats.f.ppf(0.95, 2, 4)
    border = ellipse_points(shape)
    lengths = np.einsum("ni,ij,nj->n", border, np.linalg.inv(np.cov(points.T) / 6.0), border)
    np.testing.assert_allclose(lengths, t_squared)
    assert t_squared > SQUARE_RADIUS
    assert centre_ellipse(points[:2]) is None


def test_squares_have_to_go_both_ways():
    one_way = measured([("ccw", (0.0, 0.0, 0.0))])
    with refuses("both ways"):
        Benchmark.of(one_way)
    assert return_errors(one_way, "cw").shape == (0, 3)


def test_a_robot_that_stands_does_not_come_round():
    robot = IdealRobot(BASE, NONE, NONE)
    robot.drive = lambda *_: robot.odometry.append(robot.odometry[-1])
    with refuses("does not complete its square", UnfinishedError):
        drive_square(robot, Square(side=0.2, speed=1.0, turn_speed=1.0), "run")


def test_noise_follows_from_the_seed():
    settings = BenchmarkSettings(side=0.5, speed=1.0, turn_speed=1.0)

    def end(number, laps):
        robot = IdealRobot(BASE, NONE, NONE)
        noise = settings.noise(number, laps, BASE)
        return drive_square(robot, settings.square("cw"), "run", noise).end

    assert end(0, 0) == end(0, 0)
    assert len({end(0, 0), end(1, 0), end(0, 1)}) == 3


def test_robots_of_a_campaign_are_drawn_by_their_number():
    robots = [draw_robot(QUIET, False, index) for index in range(40)]
    assert robots[7] == draw_robot(QUIET, False, 7)
    errors = np.array([values_of(drawn) for drawn, _ in robots])
    assert (np.abs(errors) >= (0.001, 0.005)).all() and (np.abs(errors) <= (0.01, 0.03)).all()
    assert len(np.unique(np.sign(errors), axis=0)) == 4
    assert draw_robot(QUIET, True, 3)[0].speed == QUIET.speed


def test_a_campaign_says_what_was_recovered():
    summary = campaign_summary([calibrate_robot(QUIET, False, 1)])
    assert [summary[name]["recovered"] for name in PARAMETERS] == [1, 1]
    assert summary["least_fall"] > 1000.0
    lines = describe_campaign(1, summary)
    assert lines[0].startswith("diameter_error without noise: 1 of 1 recovered")


@pytest.mark.long
def test_twenty_random_robots_are_calibrated():
    records = [calibrate_robot(BenchmarkSettings(), False, index) for index in range(20)]
    summary = campaign_summary(records)
    found = [summary[name] for name in PARAMETERS]
    assert [one["recovered"] for one in found] == [20, 20]
    # Of 40, with 99.9 % confidence.
    assert sum(one["held_by_interval"] for one in found) >= stats.binom.ppf(0.001, 40, 0.95)
    assert summary["least_fall"] > 10.0


@pytest.mark.long
def test_a_robot_on_the_floor_is_calibrated_as_well():
    summary = campaign_summary([calibrate_robot(BenchmarkSettings(runs=1, speed=0.4), True, 0)])
    assert [summary[name]["recovered"] for name in PARAMETERS] == [1, 1]
    assert summary["least_fall"] > 10.0


def test_results_are_left_behind(tmp_path, as_before):
    wrong = errors(0.002, 0.01)
    before = Benchmark.of(2 * ideal_runs(wrong, 1.0))
    after = Benchmark.of(2 * ideal_runs(wrong, 1.0, before.estimate.errors))
    # Without noise all runs are the same, and there are no intervals.
    summary = run_umbmark(tmp_path, before, after, {"seed": 1})
    assert summary.pop("falls_by") > 1e6
    told = [*lines_of(summary, "summary"), *sorted(names_in(tmp_path))]
    told += [*describe(before, None), describe(before, after)[-1]]
    told += (tmp_path / "returns.csv").read_text().replace(",", " ").splitlines()[:5]
    as_before(told, "results.txt", within=1e-4)


@cases("""
scale, trusted:
  - [[1.0, 1.0, 1.0], true]
  # In mm, in cm, in degrees, and mirrored.
  - [[1000.0, 1000.0, 1.0], false]
  - [[100.0, 100.0, 1.0], false]
  - [[1.0, 1.0, 57.3], false]
  - [[1.0, -1.0, -1.0], false]
""")
def test_returns_are_trusted_if_they_are_plausible(scale, trusted):
    generator = np.random.default_rng(5)
    returns = [
        (run.direction, scale * (run.return_error() + generator.normal(0.0, (0.01, 0.01, 0.005))))
        for run in 3 * ideal_runs(errors(0.002, 0.01))
    ]
    assert (Benchmark.of(measured(returns, side=4.0)).warnings() == []) == trusted


def both_ways(*end):
    return measured([(way, end) for way in ("cw", "ccw")], side=4.0)


def test_a_fit_on_its_bound_has_no_interval():
    generator = np.random.default_rng(7)
    turned = [(way, (*generator.normal(0, 0.1, 2), 1.5)) for way in ("cw", "ccw") * 3]
    found = Benchmark.of(measured(turned, side=4.0))
    assert found.estimate.intervals is None or not found.estimate.on_bounds()
    assert found.warnings()


def test_odometry_that_equals_the_truth_or_is_out_of_range():
    (warning,) = Benchmark.of(both_ways(0.0, 0.0, 0.0)).warnings()
    assert "equals the truth" in warning
    with refuses("out of range"):
        both_ways(-1e7, 0.0, 0.0)


def test_what_is_not_trusted_leaves_no_corrected_parameters(tmp_path):
    (tmp_path / "corrected.yaml").write_text("of an earlier run")
    before = Benchmark.of(both_ways(30.0, 20.0, 0.0))
    summary = run_umbmark(tmp_path, before, None, {})
    assert not summary["trusted"]
    assert not (tmp_path / "corrected.yaml").exists()
    assert describe(before, None)[0].startswith("NOT TO BE TRUSTED")
