import math

import pytest
from shared import cases

from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.controllers.joints import Pid


def pid_of(**told):
    return Pid(ControlParameters(told, "/bot/pid"))


def test_the_first_step_has_all_three_terms():
    pid = pid_of(p=2.0, i=3.0, d=0.5, i_clamp=10.0)
    assert pid.command(0.4, 0.1) == pytest.approx(2 * 0.4 + 3 * 0.04 + 0.5 * 4.0)
    assert pid.command(0.3, 0.1) == pytest.approx(2 * 0.3 + 3 * 0.07 - 0.5 * 1.0)


def test_without_a_clamp_the_integral_contributes_nothing():
    pid = pid_of(p=0.0, i=5.0)
    assert [pid.command(1.0, 0.1) for _ in range(3)] == [0.0, 0.0, 0.0]


@cases("antiwindup, steps_to_turn: [[false, 90], [true, 1]]")
def test_only_antiwindup_keeps_the_integral_itself_small(antiwindup, steps_to_turn):
    pid = pid_of(p=0.0, i=1.0, i_clamp=1.0, antiwindup=antiwindup)
    for _ in range(100):
        assert pid.command(1.0, 0.1) <= 1.0
    # Wound up to 10, it takes 9 s of the opposite error to come back to the clamp.
    turned = next(n for n in range(1, 200) if pid.command(-1.0, 0.1) < 1.0 - 1e-9)
    assert turned == pytest.approx(steps_to_turn, abs=1)


def test_clamps_may_differ():
    pid = pid_of(p=0.0, i=1.0, i_clamp_min=-0.2, i_clamp_max=0.7)
    assert pid.command(100.0, 1.0) == 0.7
    pid.reset()
    assert pid.command(-100.0, 1.0) == -0.2


def test_what_is_not_finite_gives_nothing_and_leaves_no_trace():
    pid = pid_of(p=1.0, i=1.0, d=1.0, i_clamp=5.0)
    assert pid.command(math.nan, 0.1) == pid.command(1.0, 0.0) == 0.0
    assert pid.command(1.0, 0.1) == pytest.approx(1.0 + 0.1 + 10.0)


def test_there_is_no_loop_without_p():
    with pytest.raises(ControlError, match="/bot/pid/p is missing"):
        pid_of(i=1.0)
