import pytest
import yaml

from bullet_lab.ros.bridge.stepper import SpeedWatch

# Wall seconds that pass, the step that is reached then, the wanted factor, and what is said.
STORIES = """
# Time that keeps its speed.
- [[5.0, 5000, 1.0, ""], [5.0, 10000, 1.0, ""], [5.0, 14600, 1.0, ""], [5.0, 19000, 1.0, falls]]
# Time that falls behind, which is counted anew then.
- - [4.9, 0, 1.0, ""]
  - - 0.1
    - 2500
    - 1.0
    - "simulated time falls behind: real-time factor 0.50 instead of 1 in the last 5 s"
  - [5.0, 7500, 1.0, ""]
  - [6.0, 16500, 2.0, 1.50 instead of 2 in the last 6 s]
# As fast as it goes is never too slow.
- [[5.0, 1, 0.0, ""]]
"""


@pytest.fixture
def watch(clock):
    return SpeedWatch(clock)


@pytest.mark.parametrize("story", yaml.safe_load(STORIES))
def test_what_is_said_of_the_speed(clock, watch, story):
    for seconds, step, wanted, said in story:
        clock.now += seconds
        found = watch.lag(step, wanted)
        assert said in found
        assert bool(found) == bool(said)


def test_a_machine_that_stays_too_slow_is_told_of_less_and_less_often(clock, watch):
    told = []
    for second in range(5, 400, 5):
        clock.now += 5.0
        if watch.lag(second, 1.0):
            told.append(second)
    assert told == [5, 10, 20, 40, 80, 160, 240, 320]
    # Once it is fast enough, it begins anew.
    for step, slow in ((100_000, False), (100_001, True)):
        clock.now += 5.0
        assert bool(watch.lag(step, 1.0)) == slow


def test_a_pause_does_not_count(clock, watch):
    clock.now += 100.0
    watch.restart(7)
    clock.now += 5.0
    assert not watch.lag(5007, 1.0)
