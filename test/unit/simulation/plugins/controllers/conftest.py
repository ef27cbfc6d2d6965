import pytest
from control_robots import spawn


@pytest.fixture
def manager(world):
    """The manager of the controllers of a robot in an empty world."""
    return spawn(world)[1]
