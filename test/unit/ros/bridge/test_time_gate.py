import pytest
import yaml

from bullet_lab.ros.bridge.stepper import TimeGate

# Whom the gate waits for, and what happens then: each time the step up to which time may go on,
# and who holds it back.
STORIES = """
- - []
  - [leave nobody, .inf, []]
- - [b, a]
  - [grant b 100, -.inf, [a]]
  - [grant a 50, 50, [a]]
- - [a]
  - [grant a 50, 50, [a]]
  - [grant b 20, 20, [b]]
  - [grant c 20, 20, [b, c]]
  - [grant b 70, 20, [c]]
  - [grant c 80, 50, [a]]
- - [a, b]
  - [grant a 50, -.inf, [b]]
  - [leave b, 50, [a]]
  - [grant a inf, .inf, []]
  - [leave a, .inf, []]
# A restart takes grants back, but not those for ever.
- - [late]
  - [grant a 500, -.inf, [late]]
  - [grant b inf, -.inf, [late]]
  - [restart, -.inf, [late]]
  - [grant late 100, 0, [a]]
  - [leave a, 100, [late]]
"""


@pytest.mark.parametrize("story", yaml.safe_load(STORIES))
def test_time_goes_on_as_far_as_each_member_has_granted(story):
    expected, *events = story
    gate = TimeGate(expected)
    for words, limit, holding in events:
        do, *member = words.split()
        if do == "grant":
            gate.grant(member[0], float(member[1]))
        else:
            getattr(gate, do)(*member)
        assert (gate.limit(), gate.holding()) == (limit, tuple(holding)), words
