"""Pictures and depths of boxes on a floor, beside what rays that are traced here say."""

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from picture_worlds import CAMERA, simulation_of, thing

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.rendering.renderer import Shot
from bullet_lab.simulation.world.description import Attenuation, Box, Cone, Inertia, Light, Plane

AMBIENT = (0.2, 0.25, 0.15, 1.0)
EYE = Pose.from_rpy((-1.0, 0.3, 2.6), (0.05, 0.55, 0.0))
FAR = Attenuation(range=9.0, constant=0.6, linear=0.1, quadratic=0.02)
SUN = Light("sun", "directional", Pose(), (0.4, 0.35, 0.3, 1.0), (0.5, 0.3, -0.8), True)
LAMP = Light("lamp", "point", Pose((2.2, 0.6, 2.4)), (0.5, 0.3, 0.4, 1.0), (0.0, 0.0, -1.0), True,
             attenuation=FAR)  # fmt: skip
SPOT = Light("spot", "spot", Pose.from_rpy((0.5, -1.5, 3.0), (0.3, -0.5, 0.2)),
             (0.3, 0.5, 0.5, 1.0), (0.0, 0.0, -1.0), True, attenuation=FAR,
             cone=Cone(math.radians(40), math.radians(75), 1.5))  # fmt: skip
# So near to a shadow's edge, or to what is behind it, a picture and a ray may differ.
EDGE = np.ones((7, 7), np.uint8)


def boxes():
    random = np.random.default_rng(5)
    for _ in range(12):
        x, y, z = random.uniform((1.0, -1.8, 0.1), (5.0, 1.8, 1.2))
        pose = Pose.from_rpy((x, y, z), tuple(random.uniform(-3.0, 3.0, 3)))
        size = tuple(random.uniform(0.15, 0.7, 3))
        yield pose, size, (*random.uniform(0.3, 1.0, 3), 1.0)


BOXES = tuple(boxes())
FLOOR_COLOUR = (0.7, 0.8, 0.9, 1.0)


def models(moving):
    yield thing("floor", Plane(), colour=FLOOR_COLOUR)
    for k, (pose, size, colour) in enumerate(BOXES):
        model = thing(f"box{k}", Box(size), pose, colour, static=not moving)
        mass = Inertia(1.0, (0.0, 0.0, 0.0), np.eye(3))
        (link,) = model.links
        yield replace(model, links=(replace(link, inertia=mass),)) if moving else model


def nearest(starts, ways):
    """Where rays first meet something: distances (inf for none), colours, normals, and on what."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -starts[:, 2] / ways[:, 2]
        distance = np.where((distance > 1e-9) & (starts[:, 2] > 0), distance, np.inf)
        colour = np.tile(FLOOR_COLOUR[:3], (len(ways), 1))
        normal = np.tile((0.0, 0.0, 1.0), (len(ways), 1))
        what = np.where(np.isfinite(distance), 0, -1)
        for number, (pose, size, own) in enumerate(BOXES, start=1):
            turn = pose.rotation_matrix()
            start, way = (starts - pose.position) @ turn, ways @ turn
            half = 0.5 * np.array(size)
            ends = np.stack(((-half - start) / way, (half - start) / way))
            first, last = ends.min(axis=0), ends.max(axis=0).min(axis=1)
            axis = first.argmax(axis=1)
            enters = first.max(axis=1)
            hit = (enters < last) & (enters > 1e-9) & (enters < distance)
            side = -np.sign(way[np.arange(len(way)), axis])[:, None] * np.eye(3)[axis]
            distance = np.where(hit, enters, distance)
            colour[hit], normal[hit], what[hit] = own[:3], (side @ turn.T)[hit], number
    return distance, colour, normal, what


@lru_cache(maxsize=None)
def first_hits():
    """Where the picture's rays meet something: places, distances, colours, normals, on what."""
    v, u = np.mgrid[0:480, 0:640]
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    local = np.stack((np.ones_like(x), -x, -y), axis=-1).reshape(-1, 3)
    ways = local @ EYE.rotation_matrix().T
    distance, *found = nearest(np.tile(EYE.position, (len(ways), 1)), ways)
    places = np.where(np.isfinite(distance), distance, 0.0)[:, None] * ways + EYE.position
    return (places, distance, *found)


@lru_cache(maxsize=None)
def brightness(light):
    """What one light adds to each pixel of a white world, (n, 3)."""
    places, _, _, normal, _ = first_hits()
    along = np.array(light.pose.rotate(light.direction))
    along /= np.linalg.norm(along)
    if light.kind == "directional":
        towards, far, share = np.tile(-along, (len(places), 1)), np.inf, 1.0
    else:
        offsets = light.pose.position - places
        far = np.linalg.norm(offsets, axis=1)
        towards = offsets / far[:, None]
        fade = light.attenuation
        fading = fade.constant + far * (fade.linear + far * fade.quadratic)
        share = np.where(far > fade.range, 0.0, 1.0 / np.maximum(1.0, fading))
        if light.kind == "spot":
            inside, outside = np.cos(0.5 * light.cone.inner), np.cos(0.5 * light.cone.outer)
            edge = (-(towards @ along) - outside) / max(1e-9, inside - outside)
            share = share * np.clip(edge, 0.0, 1.0) ** light.cone.falloff
    cosine = np.maximum(0.0, np.sum(normal * towards, axis=1))
    if light.casts_shadows:
        cosine[nearest(places + 1e-6 * normal, towards)[0] < far] = 0.0
    return (cosine * share)[:, None] * np.array(light.diffuse[:3])


def reference(lights):
    """A picture (480, 640, 3), white at 1, depths and what is seen, both (480, 640)."""
    _, distance, colour, _, what = first_hits()
    lit = sum(map(brightness, lights), np.array(AMBIENT[:3]))
    picture = np.where(np.isfinite(distance)[:, None], colour * lit, (0.0, 0.0, 1.0))
    return picture.reshape(480, 640, 3), distance.reshape(480, 640), what.reshape(480, 640)


def flat_parts(picture, what):
    """Where nothing changes abruptly nearby."""
    grey = np.clip(255 * picture, 0, 255).astype(np.float32)
    changes = (cv2.dilate(grey, EDGE) - cv2.erode(grey, EDGE)).max(axis=2) > 4
    known = what.astype(np.float32)
    return ~changes & (cv2.dilate(known, EDGE) == cv2.erode(known, EDGE))


@pytest.mark.parametrize(
    ("moving", "lights"),
    [
        (False, (SUN, LAMP, SPOT)),
        (True, (SUN, SPOT, replace(LAMP, casts_shadows=False))),
    ],
)
def test_light_and_shadows_of_still_and_moving_things(moving, lights):
    picture, _, what = reference(lights)
    with simulation_of(*models(moving), ambient=AMBIENT, lights=lights) as simulation:
        draw = simulation.renderer().picture
        drawn = [draw(EYE, Shot(CAMERA, samples=samples)) for samples in (1, 4)]
    wanted = np.clip(255 * picture, 0, 255)
    flat = flat_parts(picture, what)
    assert flat.mean() > 0.5
    for seen in drawn:
        off = np.abs(seen - wanted).max(axis=2)[flat]
        assert np.quantile(off, 0.999) < 2.0
        assert off.max() < 6.0


def test_depth_of_boxes_and_floor():
    _, wanted, what = reference(())
    flat = flat_parts(np.zeros((480, 640, 3)), what) & (wanted < 4.0)
    with simulation_of(*models(False)) as simulation:
        depths = simulation.renderer().depths(EYE, Shot(CAMERA, near=0.01))
    assert flat.mean() > 0.3
    assert np.abs(depths - wanted)[flat].max() < 1e-4
    assert np.isinf(depths[np.isinf(wanted)]).all()
