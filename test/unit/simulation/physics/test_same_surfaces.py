"""Which wheels skid, which directions turn with them, and all surfaces are as before.

A change that means to find others renews wheels.txt.
"""

from pathlib import Path

from alike import lines_of

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.physics.surfaces import (
    ContactSurface,
    Footing,
    axle_of,
    directed_wheels,
    heavy_enough,
    on_treads,
    skidding_wheels,
)
from bullet_lab.simulation.world.sdf import read_world_file

HERE = Path(__file__).parent


def surfaces_of(model):
    """Yield what is found out about a model, as lines."""
    links, joints = model.links, model.joints
    skidding = skidding_wheels(links, joints)
    names = {wheel.link for wheel in skidding}
    yield from lines_of((*skidding, *directed_wheels(links, joints)), model.name)
    axles = {joint.child: axle_of(joint) for joint in joints}
    footing = Footing.of(links, joints, names)
    for link in heavy_enough(links, skidding) if skidding else links:
        name, axle = f"{model.name}.{link.name}", axles.get(link.name)
        yield from lines_of(link.inertia and link.inertia.matrix, name)
        for shape in on_treads(link.collisions, axle, link.name in names):
            surface = footing.surface(link, ContactSurface.of(shape, axle))
            yield from lines_of((shape.geometry, shape.pose), name)
            yield from lines_of(surface.properties(Pose(), model.static), name)


def test_surfaces_are_as_before():
    models = read_world_file(HERE / "wheels.world").models
    told = "\n".join(line for model in models for line in surfaces_of(model))
    assert told == (HERE / "wheels.txt").read_text()
