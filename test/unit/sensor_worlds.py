"""Robots and things that the tests of sensors share."""

import re

import numpy as np
from shared import complains

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import World
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.simulation.world.urdf import read_urdf

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'


def empty(seed=0, gravity=(0.0, 0.0, 0.0)):
    """A world of nothing; things float in it."""
    return Simulation(World("empty", gravity=gravity), seed)


def held(seed=0):
    """A world with gravity, which sensors know of, and in which nothing falls."""
    simulation = Simulation(World("held"), seed)
    simulation._physics.set_gravity((0.0, 0.0, 0.0))
    return simulation


def carrier(gazebo="", collision="", links="", name="carrier"):
    """A robot of one link, with what stands in it and hangs on it, and <gazebo> elements."""
    return read_urdf(
        f'<robot name="{name}"><link name="base">{INERTIAL}{collision}</link>{links}{gazebo}'
        "</robot>",
        "carrier",
    )


def sensor(kind, inner, plugin, tags="", link="base"):
    """A <gazebo> element with a sensor in it."""
    return (
        f'<gazebo reference="{link}"><sensor type="{kind}" name="the_sensor">{inner}'
        f'<plugin name="the_sensor_plugin" filename="{plugin}">{tags}</plugin></sensor></gazebo>'
    )


def thing(geometry, pose="0 0 0 0 0 0", name="thing"):
    """A model that stands still."""
    return read_spawned(
        f'<sdf><model name="{name}"><static>true</static><pose>{pose}</pose><link name="l">'
        f'<collision name="c"><geometry>{geometry}</geometry></collision></link></model></sdf>',
        name,
    )


def box(size, pose, name="thing"):
    """A box that stands still."""
    return thing(f"<box><size>{size}</size></box>", pose, name)


def record(robot, topic):
    """A list that grows with the samples on a topic."""
    samples = []
    robot.listen(topic, samples.append)
    return samples


def steps(samples):
    """The simulated times of samples."""
    return [sample.step for sample in samples]


def table(samples, name):
    """An attribute of samples, a row for each."""
    return np.array([getattr(sample, name) for sample in samples])


def drive(world, robot, seconds, vx=0.0, wz=0.0, vy=0.0, topic="cmd_vel"):
    """Command a velocity, m/s and rad/s, and return how the robot moves after that."""
    start = robot.pose()
    robot.command(topic, PlanarCommand(vx, vy, wz))
    world.run_for(seconds)
    return start.inverse() * robot.pose()


def readings(model, topic, seconds=0.1, things=(), world=empty, seed=0, **where):
    """What a robot among some things sends on a topic from the beginning on."""
    with world(seed) as simulation:
        for one in things:
            simulation.add(one)
        samples = record(simulation.add(model, **where), topic)
        simulation.run_for(seconds)
    return samples


def saved_again(simulation, folder):
    """A simulation of the world as it is saved."""
    text, _ = world_text(simulation.snapshot(), folder)
    (folder / "again.world").write_text(text)
    return Simulation.of(str(folder / "again.world"))


def check_refusal(model, message):
    """Check that a robot is not simulated as it is, for a reason that is said."""
    with empty() as simulation, complains(re.escape(message)):
        simulation.add(model)
