import math
from dataclasses import replace

import numpy as np
import pytest

from bullet_lab.simulation.description import (
    Attenuation,
    Box,
    Cylinder,
    Light,
    Mesh,
    Plane,
    Sphere,
    World,
)
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.casters import casters_of
from bullet_lab.simulation.rendering.lighting import Lighting
from bullet_lab.simulation.rendering.patchwork import OVERLAP
from bullet_lab.simulation.rendering.shadows import Shadows
from bullet_lab.simulation.rendering.surfaces import surfaces_of

WHITE = (1.0, 1.0, 1.0, 1.0)
FLOOR = surfaces_of(Plane(size=(40.0, 40.0)))[0]
SLANTING = math.sqrt(0.5)
SUN = Light("sun", "directional", Pose(), WHITE, (SLANTING, 0.0, -SLANTING), casts_shadows=True)
LAMP = Light(
    "lamp",
    "point",
    Pose((0.0, 0.0, 4.0)),
    WHITE,
    casts_shadows=True,
    attenuation=Attenuation(range=100.0),
)


def casters(geometry, pose, shape=1):
    return casters_of(geometry, [s.moved(pose) for s in surfaces_of(geometry)], shape)


def shadows(*bodies, lights=(SUN,), **world):
    return Shadows(World("w", lights=lights, **world), [c for body in bodies for c in body])


def area(surface):
    a, b, c = (surface.corners[:, k] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def dark(found, surface, light=0):
    """Area that does not see a light."""
    return 0.0 if found is None else float(area(found.of(surface))[found.unseen[:, light]].sum())


def dark_extent(found, surface, light=0):
    """Least and greatest corner of what does not see a light."""
    corners = found.of(surface).corners[found.unseen[:, light]].reshape(-1, 3)
    return np.stack((corners.min(axis=0), corners.max(axis=0)))


def test_the_shadow_of_a_box_under_a_sun():
    # A cube of 1 m, 1 m above the floor: the light falls at 45 degrees along x.
    found = shadows(casters(Box((1.0, 1.0, 1.0)), Pose((0.0, 0.0, 1.5)))).on(FLOOR, 0)
    extent = dark_extent(found, FLOOR)
    assert extent == pytest.approx(np.array([(0.5, -0.5, 0.0), (2.5, 0.5, 0.0)]), abs=2e-3)
    assert dark(found, FLOOR) == pytest.approx(2.0, abs=0.01)


def test_the_shadow_of_a_box_under_a_lamp():
    # From 4 m above, the upper side at 2 m is what counts: twice as large, the lower one 4 / 3.
    found = shadows(casters(Box((1.0, 1.0, 1.0)), Pose((1.0, 0.0, 1.5))), lights=(LAMP,))
    cut = found.on(FLOOR, 0)
    low, high = (0.5 * 4 / 3, -1.0, 0.0), (3.0, 1.0, 0.0)
    assert dark_extent(cut, FLOOR) == pytest.approx(np.array((low, high)), abs=2e-3)


def test_the_shadow_of_a_ball_under_a_sun_is_an_ellipse():
    found = shadows(casters(Sphere(0.5), Pose((0.0, 0.0, 2.0)))).on(FLOOR, 0)
    assert dark(found, FLOOR) == pytest.approx(math.pi * 0.5 * 0.5 * math.sqrt(2.0), rel=0.02)


def test_the_shadow_of_an_upright_cylinder_that_stands_on_the_floor():
    found = shadows(casters(Cylinder(0.2, 1.0), Pose((0.0, 0.0, 0.5)))).on(FLOOR, 0)
    # Two half discs and a rectangle of 1 m.
    assert dark(found, FLOOR) == pytest.approx(math.pi * 0.04 + 0.4, rel=0.01)


def test_a_body_that_goes_through_the_floor_shades_with_what_is_above():
    found = shadows(casters(Box((1.0, 1.0, 3.0)), Pose((0.0, 0.0, 0.0)))).on(FLOOR, 0)
    assert dark(found, FLOOR) == pytest.approx(1.0 + 1.5, abs=0.01)


def test_what_lies_behind_throws_no_shadow():
    assert shadows(casters(Box((1.0, 1.0, 1.0)), Pose((0, 0, -2.0)))).on(FLOOR, 0) is None
    above = casters(Box((1.0, 1.0, 1.0)), Pose((1.0, 0.0, 5.0)))
    assert shadows(above, lights=(LAMP,)).on(FLOOR, 0) is None


def test_a_body_higher_and_lower_than_a_lamp_shades_to_where_the_light_ends():
    found = shadows(casters(Box((0.2, 1.0, 6.0)), Pose((2.0, 0.0, 3.0))), lights=(LAMP,))
    extent = dark_extent(found.on(FLOOR, 0), FLOOR)
    # From 1.9 m on, as wide as the wall there, and on to the floor's edge.
    assert extent[:, 0] == pytest.approx((1.9, 20.0), abs=2e-3)
    assert extent[:, 1] == pytest.approx((-0.5 / 1.9 * 20.0, 0.5 / 1.9 * 20.0), abs=5e-3)


def test_a_lamp_shines_through_the_ball_around_it_but_not_through_another():
    bulb = casters(Sphere(0.1), Pose((0.0, 0.0, 4.0)))
    assert shadows(bulb, lights=(LAMP,)).on(FLOOR, 0) is None
    moved = casters(Sphere(0.1), Pose((0.0, 0.0, 3.7)))
    assert dark(shadows(moved, lights=(LAMP,)).on(FLOOR, 0), FLOOR) > 0.5


def test_a_lamp_beside_a_slanting_wall_is_not_inside_it():
    wall = casters(Box((0.1, 8.0, 2.0)), Pose.from_rpy((0.5, 0.5, 1.5), (0.0, 0.0, 0.8)))
    lamp = replace(LAMP, pose=Pose((0.0, 0.0, 1.5)))
    assert dark(shadows(wall, lights=(lamp,)).on(FLOOR, 0), FLOOR) > 50.0


@pytest.mark.parametrize("geometry", [Box((1.0, 1.0, 1.0)), Cylinder(0.4, 1.0), Sphere(0.5)])
@pytest.mark.parametrize("light", [SUN, replace(LAMP, pose=Pose((-1.0, 0.4, 2.0)))])
def test_a_convex_body_does_not_shade_itself(geometry, light):
    pose = Pose.from_rpy((0.1, 0.2, 0.7), (0.3, 0.2, 0.5))
    surface = surfaces_of(geometry)[0].moved(pose)
    assert shadows(casters(geometry, pose, 5), lights=(light,)).on(surface, 5) is None


def test_bodies_that_touch_shade_only_what_they_cover():
    # A small box on a large one: its shadow begins at its side.
    large = surfaces_of(Box((4.0, 4.0, 1.0)))[0]
    small = casters(Box((0.5, 0.5, 0.5)), Pose((0.0, 0.0, 0.75)))
    assert dark(shadows(small).on(large, 0), large) == pytest.approx(0.5 * (0.5 + 0.5), abs=5e-3)
    lid = surfaces_of(Box((0.5, 0.5, 0.5)))[0].moved(Pose((0.0, 0.0, 0.75)))
    assert shadows(casters(Box((4.0, 4.0, 1.0)), Pose())).on(lid, 0) is None


def write_obj(folder, points, faces):
    path = folder / "shape.obj"
    lines = ["v {} {} {}".format(*p) for p in points] + ["f {} {} {}".format(*f) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return Mesh(path, path.name)


def test_a_mesh_of_few_triangles_throws_its_own_shadow_not_its_hulls(tmp_path):
    # An L of 3 m², lying 1 m above the floor; its hull has 3.5. With and without a fin on it.
    points = [(0, 0, 1), (2, 0, 1), (2, 1, 1), (1, 1, 1), (1, 2, 1), (0, 2, 1), (1, 0.5, 2)]
    faces = [(1, 2, 3), (1, 3, 4), (1, 4, 5), (1, 5, 6), (1, 2, 7)]
    for count in (4, 5):
        mesh = write_obj(tmp_path, points, faces[:count])
        found = shadows(casters(mesh, Pose())).on(FLOOR, 0)
        assert dark(found, FLOOR) == pytest.approx(3.0, abs=0.01)


def test_a_mesh_of_a_box_is_one_body(tmp_path):
    box = surfaces_of(Box((1.0, 1.0, 1.0)))[0].corners
    points = box.reshape(-1, 3).tolist()
    faces = np.arange(1, 37).reshape(12, 3).tolist()
    (body,) = casters(write_obj(tmp_path, points, faces), Pose((0.0, 0.0, 1.5)))
    assert len(body.points) == 8
    assert dark(shadows([body]).on(FLOOR, 0), FLOOR) == pytest.approx(2.0, abs=0.01)


def test_two_parts_of_a_mesh_are_two_bodies(tmp_path):
    corners = [(x, y, 1) for x in (0, 4) for y in (0, 1, 2)]
    points = [*corners, *((x + 1, y, z) for x, y, z in corners)]
    faces = [(1, 3, 9), (1, 9, 7), (4, 6, 12), (4, 12, 10)]
    found = shadows(casters(write_obj(tmp_path, points, faces), Pose())).on(FLOOR, 0)
    assert dark(found, FLOOR) == pytest.approx(4.0, abs=0.01)


def test_a_plane_throws_no_shadow():
    assert casters(Plane(), Pose((0.0, 0.0, 2.0))) == []


@pytest.mark.parametrize(
    ("lights", "shadow"),
    [((SUN,), True), ((replace(SUN, casts_shadows=False),), False), ((), False)],
)
def test_lights_cast_shadows_if_they_say_so(lights, shadow):
    found = shadows(casters(Box((1.0, 1.0, 1.0)), Pose((0, 0, 1.0))), lights=lights)
    assert (found.on(FLOOR, 0) is not None) is shadow


def test_a_scene_without_shadows_has_none():
    box = casters(Box((1.0, 1.0, 1.0)), Pose((0, 0, 1.0)))
    assert shadows(box, shadows=False).on(FLOOR, 0) is None


def test_each_light_has_shadows_of_its_own():
    steep = replace(SUN, direction=(0.0, 0.0, -1.0))
    plain = replace(SUN, casts_shadows=False)
    box = casters(Box((1.0, 1.0, 1.0)), Pose((0.0, 0.0, 1.5)))
    found = shadows(box, lights=(plain, steep, SUN)).on(FLOOR, 0)
    assert [dark(found, FLOOR, k) for k in range(3)] == pytest.approx([0.0, 1.0, 2.0], abs=0.01)
    brightness = Lighting(World("w", lights=(plain, steep, SUN), ambient=(0.1, 0.1, 0.1, 1.0)))
    pieces = found.of(FLOOR)
    shades = brightness.shade(pieces.corners, pieces.normals, found.unseen)
    wanted = 0.1 + SLANTING + np.where(found.unseen[:, 1], 0.0, 1.0)
    wanted += np.where(found.unseen[:, 2], 0.0, SLANTING)
    assert shades == pytest.approx(np.repeat(wanted[:, None], 3, axis=1))


def test_pieces_make_up_the_whole_and_overlap_by_hardly_anything():
    random = np.random.default_rng(4)
    bodies = [
        casters(Box((0.5, 0.4, 0.6)), Pose.from_rpy((x, y, 0.6), tuple(random.uniform(-3, 3, 3))))
        for x, y in random.uniform(-3.0, 3.0, (30, 2))
    ]
    found = shadows(*bodies).on(FLOOR, 0)
    pieces = found.of(FLOOR)
    edges = np.linalg.norm(pieces.corners - np.roll(pieces.corners, 1, axis=1), axis=-1).sum()
    extra = area(pieces).sum() - 1600.0
    assert 0.0 < extra < edges * OVERLAP * 2.0
    # Each place is in a piece, and those that it is in agree about the light.
    places = random.uniform(-4.0, 6.0, (400, 2))
    a, b, c = (pieces.corners[:, k, :2] for k in range(3))
    for place in places:
        inside = np.all([_left(p, q, place) > -1e-9 for p, q in ((a, b), (b, c), (c, a))], axis=0)
        assert inside.any()
        assert len(set(found.unseen[inside, 0])) == 1


def _left(start, end, place):
    side, away = end - start, place - start
    return side[:, 0] * away[:, 1] - side[:, 1] * away[:, 0]


def test_normals_and_places_in_the_picture_are_those_of_the_whole():
    # Normals tilt along x, the picture is turned and stretched.
    corners = FLOOR.corners
    normals = np.stack((corners[..., 0] / 40.0, 0.0 * corners[..., 0], np.ones(corners.shape[:2])))
    normals = np.moveaxis(normals, 0, -1)
    picture = corners[..., :2] @ np.array(((0.3, 0.1), (-0.2, 0.4))) + (0.5, 0.25)
    surface = FLOOR.with_triangles(corners, normals, picture)
    found = shadows(casters(Box((1.0, 1.0, 1.0)), Pose((3.0, 2.0, 1.5)))).on(surface, 0)
    pieces = found.of(surface)
    told = pieces.corners[..., :2] @ np.array(((0.3, 0.1), (-0.2, 0.4))) + (0.5, 0.25)
    assert pieces.picture == pytest.approx(told)
    tilt = pieces.normals[..., 0] / pieces.normals[..., 2]
    assert tilt == pytest.approx(pieces.corners[..., 0] / 40.0)
    assert np.linalg.norm(pieces.normals, axis=-1) == pytest.approx(np.ones(tilt.shape))
    # All pieces look up, as the floor does.
    a, b, c = (pieces.corners[:, k] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()


def test_what_no_shadow_reaches_stays_as_it_is():
    far = surfaces_of(Box((1.0, 1.0, 1.0)))[0].moved(Pose((0.0, 15.0, 0.5)))
    box = casters(Box((1.0, 1.0, 1.0)), Pose((0.0, 0.0, 0.5)))
    assert shadows(box).on(far, 0) is None
    assert shadows(box).reaching(far.corners, 0) == []
    assert [number for number, _ in shadows(box).reaching(FLOOR.corners, 0)] == [0]
