import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shared import BLOCK_ROBOT, EMPTY_WORLD, cases, complains

from bullet_lab.core.pose import Pose
from bullet_lab.core.schedule import ScheduleError
from bullet_lab.errors import LabError
from bullet_lab.simulation import plugins
from bullet_lab.simulation.models import EntityError
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation, SimulationError, View, take_picture
from bullet_lab.simulation.world.description import (
    Box,
    Collision,
    Inertia,
    Link,
    Mesh,
    Model,
    PluginTag,
    Visual,
    World,
)

UNIT = Inertia(1.0, (0.0, 0.0, 0.0), 0.01 * np.eye(3))
CUBE = Box((0.2, 0.2, 0.2))
PICTURE = View(eye=(-0.6, -0.5, 0.5), target=(0.0, 0.0, 0.0), width=80, height=60)


def thing(name="cube", geometry=CUBE, inertia=UNIT, pose=Pose(), **parts):  # noqa: B008
    link = Link("link", Pose(), inertia, (Visual(geometry),), (Collision(geometry),))
    return Model(name, (link,), pose=pose, **parts)


def bodies(simulation):
    return pybullet.getNumBodies(simulation.client)


def drive(simulation, robot):
    """Drive about and return all that can be seen of it."""
    samples = []
    robot.listen("odom", samples.append)
    for command in (PlanarCommand(0.3, 0.05, 0.4), PlanarCommand(-0.2, 0.0, -1.0)):
        robot.command("cmd_vel", command)
        simulation.run_for(1.5)
    return list(samples), take_picture(simulation, PICTURE).tobytes()


def crowded():
    """A world in which the robot runs into two boxes, one of them fixed."""
    simulation = Simulation.of(EMPTY_WORLD)
    simulation.add(thing("fixed", pose=Pose((0.3, 0.0, 0.1)), static=True))
    simulation.add(thing("loose", pose=Pose((-0.2, 0.0, 0.1))))
    return simulation


def test_a_reset_simulation_is_as_good_as_a_new_one():
    with crowded() as simulation:
        robot = simulation.spawn(BLOCK_ROBOT)
        first = drive(simulation, robot)
        simulation.reset_simulation()
        assert simulation.step == 0
        assert len(first[0]) == 3000 // 51
        # Also where everything has only stood.
        for seconds in (0.0, 0.1):
            simulation.run_for(seconds)
            simulation.reset_simulation()
            assert drive(simulation, robot) == first
            simulation.reset_simulation()


def test_simulations_do_not_disturb_each_other():
    with crowded() as alone:
        expected = drive(alone, alone.spawn(BLOCK_ROBOT))
    with crowded() as one, Simulation(World("other", gravity=(0.0, 0.0, 0.0))) as other:
        robot = one.spawn(BLOCK_ROBOT)
        floating = other.add(thing(pose=Pose((0, 0, 5))))
        one.every(10.0, lambda _: other.run_for(0.07))
        assert drive(one, robot) == expected
        assert floating.pose().position == (0, 0, 5)
        assert (one.step, other.step) == (3000, 2100)


def test_adding_naming_and_removing(world):
    added = world.add(thing(), "mine", Pose((1, 2, 3)))
    assert world.models["mine"] is added
    assert added.name == "mine"
    with pytest.raises(SimulationError, match="^a model named 'mine' exists already$"):
        world.add(thing("mine"))
    count = bodies(world)
    world.remove("mine")
    assert bodies(world) == count - 1
    assert list(world.models) == ["ground_plane"]
    with pytest.raises(EntityError, match="mine"):
        world.remove("mine")
    world.add(thing("mine"))


def test_a_removed_robot_is_silent(world, robot):
    samples = []
    robot.listen("odom", samples.append)
    world.remove(robot.name)
    world.run_for(1.0)
    assert samples == []


@cases(r"""
position, quaternion, message:
  - [[0, .inf, 0], [0, 0, 0, 1], its pose is not finite]
  - [[0, 0, 0], [0, 0, .nan, 1], its pose is not finite]
  - [[0, 0, 0], [0, 0, 0, 2], a quaternion of length 2; needs 1]
  - [[0, -1.0e+7, 0], [0, 0, 0, 1], its position exceeds 1e\+06 m]
""")
def test_impossible_poses_leave_the_simulation_unharmed(
    world, robot, position, quaternion, message
):
    pose = Pose(tuple(position), tuple(quaternion))
    count, before = bodies(world), robot.state()
    with pytest.raises(SimulationError, match=f"^model 'cube': {message}"):
        world.add(thing(), pose=pose)
    with pytest.raises(SimulationError, match=message):
        robot.place(pose)
    assert (bodies(world), robot.state()) == (count, before)
    assert "cube" not in world.models


def test_what_is_not_usable_of_a_model_is_left_out(world, tmp_path):
    (tmp_path / "bad.stl").write_text("nonsense")
    bad = Mesh(tmp_path / "bad.stl", "bad.stl")
    good = thing().links[0]
    for shapes in ({"visuals": (Visual(bad),)}, {"collisions": (Collision(bad),)}):
        with complains("^model 'm': link 'other': .*bad.stl: .*; it is left out$"):
            made = world.add(Model("m", (good, Link("other", inertia=UNIT, **shapes)))).model
        assert (made.links[1].visuals, made.links[1].collisions) == ((), ())
        world.remove("m")


def test_timers(world):
    calls = []
    world.run_for(0.005)
    world.every(100.0, calls.append)
    world.run_for(0.03)
    assert calls == [15, 25, 35]
    world.reset_simulation()
    world.run_for(0.01)
    assert calls[3:] == [10]
    assert world.seconds == 0.01
    with pytest.raises(ScheduleError):
        world.every(math.nan, calls.append)


def test_timers_come_before_samples_of_their_step(world, robot):
    order = []
    robot.listen("odom", lambda sample: order.append(("odom", sample.step)))
    world.every(1000.0 / 51, lambda step: order.append(("clock", step)))
    world.run_for(0.102)
    assert order == [("clock", 51), ("odom", 51), ("clock", 102), ("odom", 102)]


def test_how_time_is_cut_does_not_matter(world, robot):
    def drive_in(slices):
        world.reset_simulation()
        robot.command("cmd_vel", PlanarCommand(vx=0.2, wz=0.1))
        for _ in range(slices):
            world.run_until(world.step + 1000 // slices)
        return robot.pose()

    assert drive_in(1) == drive_in(8) == drive_in(1000)


def test_reset_world_lets_time_go_on(world, robot):
    cube = world.add(thing(), pose=Pose((1, 0, 3)))
    robot.command("cmd_vel", PlanarCommand(vx=0.2))
    world.run_for(0.2)
    world.reset_world()
    assert world.step == 200
    assert cube.pose().position == pytest.approx((1, 0, 3))
    world.run_for(0.1)
    assert cube.pose().position[2] == pytest.approx(3 - 0.5 * 9.8 * 0.01, abs=1e-3)
    assert robot.pose().position[0] == pytest.approx(0.0, abs=1e-4)


def test_many_models_come_and_go_and_leave_nothing(package, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    mesh = Mesh(package / "meshes" / "beacon.dae", "", (0.1, 0.1, 0.1))
    world = Simulation.of(EMPTY_WORLD)
    count = bodies(world)
    for number in range(10):
        for model in (thing(), thing("mesh", mesh)):
            world.add(model, pose=Pose((number, 0, 1)))
        for name in ("cube", "mesh"):
            world.remove(name)
    assert list(world.models) == ["ground_plane"]
    assert bodies(world) == count
    for _ in range(2):
        world.close()
        assert not pybullet.isConnected(world.client)
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_cannot_be_leaves_the_rest_of_its_world():
    good, bad = thing(), thing("bad", inertia=None)
    with complains("model 'bad'"), Simulation(World("w", (good, bad))) as simulation:
        assert list(simulation.models) == ["cube"]


class Faulty(plugins.Plugin):
    """Raises what no plugin should, in one of its methods."""

    acts = True

    def __init__(self, mount):
        super().__init__(mount)
        self.fault = mount.text("fault")
        self.schedule = mount.schedule("rate", 100.0)
        self.raise_in("load")

    def raise_in(self, method):
        if self.fault == method:
            raise ZeroDivisionError(f"in {method}")

    def before_step(self, step):
        self.raise_in("before_step")

    def prepare(self):
        self.raise_in("prepare")

    def produce(self, step):
        self.raise_in("produce")


@pytest.fixture
def world(world, monkeypatch):
    """An empty world that knows the faulty plugin."""
    monkeypatch.setitem(plugins._KINDS, "libfaulty.so", Faulty)
    return world


def faulty(fault):
    tag = PluginTag("libfaulty.so", "bad", {"fault": fault})
    return replace(thing(pose=Pose((3.0, 0.0, 0.1))), plugins=(tag,))


@cases("""
fault, count:
  # What has raised before time goes on is due once more.
  - [before_step, 100]
  - [prepare, 11]
  - [produce, 10]
  - ["", 0]
""")
def test_a_plugin_that_raises_is_reported_and_all_others_go_on(world, fault, count):
    world.add(faulty(fault))
    robot, failed, samples = world.spawn(BLOCK_ROBOT), [], []
    robot.listen("odom", samples.append)
    robot.command("cmd_vel", PlanarCommand(vx=0.5))
    if fault:
        with pytest.raises(ZeroDivisionError, match=fault):
            world.run_for(0.1)
    world.go_on_after(lambda name, error: failed.append((name, str(error))))
    before, x = world.step, robot.pose().position[0]
    world.run_for(0.1)
    assert failed == [("plugin 'bad' of 'cube'", f"in {fault}")] * count
    assert world.step == before + 100
    assert robot.pose().position[0] - x == pytest.approx(0.05, rel=0.1)
    assert samples


def test_a_plugin_that_cannot_be_made_leaves_the_rest_of_its_model(world):
    with complains("plugin 'bad' \\(libfaulty.so\\) is left out: ZeroDivisionError: in load"):
        assert not world.add(faulty("load")).plugins
    world.run_for(0.01)


def test_an_error_of_the_simulator_itself_is_raised(world):
    class Broken:
        active = True

        def before_step(self, _):
            raise ZeroDivisionError

    world.forces = Broken()
    world.go_on_after(lambda *_: None)
    with pytest.raises(ZeroDivisionError):
        world.run_for(0.01)


def test_files_that_the_user_names(tmp_path):
    for name in ("nix.world", str(tmp_path), "package://bullet_lab/worlds/nix.world"):
        with pytest.raises(LabError) as caught:
            Simulation.of(name)
        assert "\n" not in str(caught.value)
        assert Path(name).name in str(caught.value)


def lose(simulation, instance, number=math.nan, seconds=0.5):
    """Give a model an absurd velocity and let time go on."""
    instance.bodies["link"].set_velocity((number, 0.0, 0.0), (0.0, 0.0, 0.0))
    simulation.run_for(seconds)


PLACES = {"lost": (0.0, 0.0, 0.5), "on_top": (0.0, 0.0, 1.51), "far": (8.0, 0.0, 0.5)}


@cases("number, count: [[.nan, 3], [.inf, 3], [.nan, 1]]")
def test_a_model_that_is_no_longer_finite_is_named_and_reset_and_harms_no_other(
    world, number, count
):
    instances = [world.add(thing(n, pose=Pose(p))) for n, p in list(PLACES.items())[:count]]
    world.run_for(0.5)
    before = [instance.pose().position for instance in instances]
    with complains("model 'lost': its pose is no longer finite"):
        lose(world, instances[0], number)
    instances.append(world.add(thing("later", pose=Pose((-8.0, 0.0, 0.5)))))
    world.run_for(0.5)
    after = [instance.pose().position for instance in instances]
    assert np.array(after) == pytest.approx(np.array([*before, (-8.0, 0.0, 0.1)]), abs=0.02)


def test_resets_again_and_again_are_warned_of_once_a_second(world, caplog, monkeypatch):
    monkeypatch.setattr(time, "monotonic", lambda: 7.0)
    lost = world.add(thing("lost", pose=Pose((0.0, 0.0, 0.5))))
    for _ in range(5):
        lose(world, lost, seconds=0.02)
    assert caplog.text.count("model 'lost': its pose is no longer finite") == 1
