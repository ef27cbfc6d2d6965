import pytest

from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import World


@pytest.fixture
def space():
    """A world of nothing, without gravity."""
    with Simulation(World("space", gravity=(0.0, 0.0, 0.0))) as simulation:
        yield simulation


@pytest.fixture
def falling(space):
    """The same with gravity."""
    space.set_gravity(World.gravity)
    return space
