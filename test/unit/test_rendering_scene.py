import pytest
from picture_worlds import CAMERA, simulation_of, thing

from bullet_lab.simulation.description import Box, World
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.simulation import Simulation

AHEAD = Pose((0.0, 0.0, 0.5))
BLUE = (0, 0, 255)
RED, GREEN = (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)


def cube(name, colour, x=2.0):
    return thing(name, Box((0.5, 0.5, 0.5)), Pose((x, 0.0, 0.5)), colour)


def middle(simulation):
    return tuple(simulation.renderer().picture(AHEAD, Shot(CAMERA))[240, 320])


def test_models_come_and_go():
    with simulation_of() as simulation:
        assert middle(simulation) == BLUE
        simulation.add(cube("a", RED))
        assert middle(simulation) == (255, 0, 0)
        simulation.add(cube("b", GREEN, 1.0))
        assert middle(simulation) == (0, 255, 0)
        simulation.remove("b")
        assert middle(simulation) == (255, 0, 0)
        simulation.remove("a")
        # Another model by the same name.
        simulation.add(cube("a", GREEN))
        assert middle(simulation) == (0, 255, 0)


def test_models_are_seen_where_they_are_put():
    with simulation_of(cube("a", RED)) as simulation:
        assert middle(simulation) == (255, 0, 0)
        simulation.models["a"].place(Pose((2.0, 3.0, 0.5)))
        assert middle(simulation) == BLUE
        simulation.reset_world()
        assert middle(simulation) == (255, 0, 0)


def test_two_simulations_by_turns():
    first = simulation_of(cube("a", RED))
    second = simulation_of(cube("a", GREEN))
    for _ in range(3):
        assert middle(first) == (255, 0, 0)
        assert middle(second) == (0, 255, 0)
    first.close()
    assert middle(second) == (0, 255, 0)
    second.close()


def test_one_simulation_after_the_other_leaves_nothing():
    for colour, wanted in ((RED, (255, 0, 0)), (GREEN, (0, 255, 0))) * 3:
        with simulation_of(cube("a", colour)) as simulation:
            assert middle(simulation) == wanted
    with simulation_of() as simulation:
        assert middle(simulation) == BLUE


def test_a_world_again_gives_the_same_bytes():
    pictures = set()
    for _ in range(2):
        with Simulation.of("package://bullet_lab/worlds/docking.world") as one:
            pictures.add(one.renderer().picture(AHEAD, Shot(CAMERA)).tobytes())
        with Simulation(World("other", (cube("a", RED),))) as other:
            middle(other)
    assert len(pictures) == 1


def test_physics_does_not_notice_the_pictures():
    ends = set()
    for looks in (0, 3):
        with Simulation.of("package://bullet_lab/worlds/docking.world") as simulation:
            robot = simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
            for _ in range(10):
                simulation.run_for(0.05)
                for _ in range(looks):
                    simulation.renderer().picture(AHEAD, Shot(CAMERA))
            ends.add((robot.pose(), robot.bodies["base_footprint"].velocity()))
    assert len(ends) == 1
