from bullet_lab.ros.bridge.stepper import FOR_EVER, NOT_YET, TimeGate


def test_without_members_time_is_free():
    gate = TimeGate()
    assert gate.limit() == FOR_EVER
    assert gate.holding() == ()


def test_time_does_not_start_before_all_have_joined():
    gate = TimeGate(["b", "a"])
    gate.grant("b", 100)
    assert gate.limit() == NOT_YET
    assert gate.holding() == ("a",)
    gate.grant("a", 50)
    assert gate.limit() == 50


def test_the_least_grant_counts_and_its_givers_hold_time_back():
    gate = TimeGate(["a"])
    gate.grant("a", 50)
    gate.grant("b", 20)
    gate.grant("c", 20)
    assert gate.limit() == 20
    assert gate.holding() == ("b", "c")
    gate.grant("b", 70)
    gate.grant("c", 80)
    assert gate.limit() == 50
    assert gate.holding() == ("a",)


def test_who_leaves_or_grants_for_ever_holds_nothing_back():
    gate = TimeGate(["a", "b"])
    gate.grant("a", 50)
    gate.leave("b")
    assert gate.limit() == 50
    gate.grant("a", FOR_EVER)
    assert gate.limit() == FOR_EVER
    assert gate.holding() == ()
    gate.leave("a")
    gate.leave("never joined")
    assert gate.limit() == FOR_EVER


def test_a_restart_takes_grants_back_but_not_those_for_ever():
    gate = TimeGate(["late"])
    gate.grant("a", 500)
    gate.grant("b", FOR_EVER)
    gate.restart()
    assert gate.limit() == NOT_YET
    gate.grant("late", 100)
    assert gate.limit() == 0
    assert gate.holding() == ("a",)
    gate.leave("a")
    assert gate.limit() == 100
