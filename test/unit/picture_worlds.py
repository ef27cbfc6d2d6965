"""Worlds to take pictures of, written into a folder."""

import math

import numpy as np
from PIL import Image

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.renderer import Shot, centred_camera
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Link, Mesh, Model, Visual, World

WHITE_LIGHT = (1.0, 1.0, 1.0, 1.0)
CAMERA = centred_camera(640, 480, math.radians(65))

# Of the quarters of a picture: upper left, upper right, lower left, lower right.
COLOURS = np.array([(200, 30, 30), (30, 200, 30), (30, 30, 200), (200, 200, 30)])


def quarters():
    """A picture whose quarters have four colours."""
    return COLOURS[np.kron([[0, 1], [2, 3]], np.ones((32, 32), int))].astype(np.uint8)


def around_the_middle(picture, offset=30):
    """The colours at the corners of a square around the middle, as in `COLOURS`."""
    rows, columns = (np.array([m - offset, m + offset]) for m in (240, 320))
    return picture[np.ix_(rows, columns)].reshape(4, 3).astype(int)


def checkers(columns, rows, pixels=16):
    """A checkerboard, dark at the top left."""
    squares = np.indices((rows, columns)).sum(axis=0) % 2
    return np.where(np.kron(squares, np.ones((pixels, pixels))), 235, 20).astype(np.uint8)


def write_plate(folder, name, pixels, width, height):
    """Write an upright plate, seen along +x, with an image on it; return its .obj file."""
    Image.fromarray(pixels).save(folder / f"{name}.png")
    (folder / f"{name}.mtl").write_text(f"newmtl face\nmap_Kd {name}.png\n")
    y, z = 0.5 * width, 0.5 * height
    lines = [f"mtllib {name}.mtl", "usemtl face"]
    lines += [f"v 0 {a} {b}" for a, b in ((y, -z), (-y, -z), (-y, z), (y, z))]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f 1/1 2/2 3/3 4/4"]
    path = folder / f"{name}.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def thing(name, geometry, pose=None, colour=WHITE_LIGHT, static=True):
    """A model of one shape."""
    link = Link("link", visuals=(Visual(geometry, colour=colour),))
    return Model(name, (link,), pose=pose or Pose(), static=static)


def plate(path, pose):
    """A model of a plate with an image."""
    return thing(path.stem, Mesh(path, path.name), pose)


def simulation_of(*models, **light):
    """A simulation with these models, by default in even light that leaves all as it is."""
    world = {"ambient": WHITE_LIGHT, "background": (0.0, 0.0, 1.0, 1.0), **light}
    return Simulation(World("pictures", tuple(models), **world))


def picture_of(*models, eye, **light):
    """What a camera at a pose sees of these models."""
    with simulation_of(*models, **light) as simulation:
        return simulation.renderer().picture(eye, Shot(CAMERA))
