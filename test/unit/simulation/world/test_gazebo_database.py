"""The models of Gazebo's database that worlds use most, made anew from simple shapes."""

import numpy as np
import pytest
from shared import PACKAGE, cases

from bullet_lab.simulation.models import bounds
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file

# Name, size in m with its origin, and mass in kg: 0 for those that do not move.
TABLE = """
asphalt_plane         20     20     0.1    0
beer                  0.11   0.11   0.23   0.39
bookshelf             0.92   0.405  1.2    0
bowl                  0.196  0.196  0.035  0.1
brick_box_3x1x3       3      1      3      0
cabinet               0.47   0.49   1.02   0
cafe_table            0.913  0.913  0.775  0
cardboard_box         0.5    0.4    0.3    2
cinder_block          0.435  0.203  0.203  5
coke_can              0.067  0.067  0.124  0.39
construction_barrel   1.02   1.02   1.55   500
construction_cone     0.503  0.503  1.089  1
cube_20k              1      1      1      1
drc_practice_blue_cylinder         0.559  0.559  0.863  0
drc_practice_orange_jersey_barrier 0.608  1.74   1.05   0
drc_practice_white_jersey_barrier  0.608  1.74   1.05   0
dumpster              2.505  1.535  1.773  1
fire_hydrant          0.424  0.424  0.929  0
first_2015_trash_can  0.565  0.638  0.737  4.83076
grey_wall             7.5    0.2    2.8    0
jersey_barrier        4.065  0.811  1.143  0
nist_maze_wall_120    1.2    0.605  1.2    0
nist_maze_wall_240    1.2    0.605  2.4    0
table                 1.5    0.8    1.015  0
wood_cube_10cm        0.1    0.1    0.1    0.5167
wood_cube_2_5cm       0.025  0.025  0.025  0.0073
wood_cube_5cm         0.05   0.05   0.05   0.0565
wood_cube_7_5cm       0.075  0.075  0.075  0.2249
"""
MODELS = {
    name: [float(number) for number in numbers]
    for name, *numbers in map(str.split, TABLE.strip().splitlines())
}
# Files of the originals that worlds name in which Gazebo has saved such a model: with the scale and
# the height there, and for others 1 and 0.
SAVED = """
bowl                               bowl.dae
brick_box_3x1x3                    simple_box.dae  3 1 3  1.5
cafe_table                         cafe_table.dae
cardboard_box                      cardboard_box.dae  1.25931896 1.007455168 0.755591376  0
cinder_block                       cinder_block.dae
coke_can                           coke_can.dae  1 1 1  -0.18
construction_barrel                construction_barrel.dae
construction_cone                  construction_cone.dae  10 10 10  0
cube_20k                           cube_20k.stl  0.5 0.5 0.5  0.5
drc_practice_blue_cylinder         cylinder.dae
drc_practice_orange_jersey_barrier jersey_barrier.dae
drc_practice_white_jersey_barrier  jersey_barrier.dae
dumpster                           dumpster.dae  1.5 1.5 1.5  0
fire_hydrant                       fire_hydrant.dae
first_2015_trash_can               trash_can.dae
jersey_barrier                     jersey_barrier.dae
nist_maze_wall_120                 nist_maze_wall_120.dae
nist_maze_wall_240                 nist_maze_wall_240.dae
"""
INCLUDED = '<include><uri>model://{0}</uri><name>{0}</name><pose>{1} 0 0 0 0 0</pose></include>'


@pytest.fixture(scope="module")
def row(tmp_path_factory):
    """All of them in a row on the floor, after 0.3 s, and their places along x."""
    places = {name: 25.0 * (number + 1) for number, name in enumerate(MODELS)}
    parts = "".join(INCLUDED.format(name, x) for name, x in places.items())
    text = f"<include><uri>model://ground_plane</uri></include>{parts}"
    path = tmp_path_factory.mktemp("row") / "row.world"
    path.write_text(f'<sdf version="1.6"><world name="w">{text}</world></sdf>')
    with Simulation(read_world_file(path)) as simulation:
        simulation.run_for(0.3)
        yield simulation, places


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_its_size_and_mass_and_stands_still(row, name):
    simulation, places = row
    model, (*size, mass) = simulation.models[name], MODELS[name]
    least, greatest = bounds(model)
    assert [b - a for a, b in zip(least, greatest)] == pytest.approx(size, abs=6e-3)
    assert model.model.static == (mass == 0)
    if mass:
        assert sum(link.inertia.mass for link in model.model.links) == pytest.approx(mass)
    if name != "asphalt_plane":
        assert least[2] == pytest.approx(0.0, abs=2e-3)
    x, _, _ = model.pose().position
    assert x == pytest.approx(places[name], abs=1e-3)


def test_every_model_of_the_database_is_in_the_table():
    others = {"beacon", "ground_plane", "sun"}
    names = {path.name for path in (PACKAGE / "models").iterdir()}
    found = {name for name in names if not name.startswith(("docking_station", "marker_panel"))}
    assert found == {*MODELS, *others}


@pytest.mark.parametrize("row", SAVED.strip().splitlines())
def test_a_mesh_that_saved_worlds_name_has_the_size_of_its_model(row, read_world):
    name, file, *numbers = row.split()
    *scale, height = numbers or (1, 1, 1, 0)
    scaled = "<scale>{} {} {}</scale>".format(*scale)
    mesh = f"<mesh><uri>model://{name}/meshes/{file}</uri>{scaled}</mesh>"
    shape = f"<pose>0 0 {height} 0 0 0</pose><geometry>{mesh}</geometry>"
    link = f'<link name="link"><collision name="c">{shape}</collision></link>'
    with Simulation(read_world(f'<model name="m"><static>1</static>{link}</model>')) as simulation:
        least, greatest = bounds(simulation.models["m"])
    assert np.subtract(greatest, least) == pytest.approx(MODELS[name][:3], abs=6e-3)


@cases("""
name, material:
  - [asphalt_plane, vrc/asphalt]
  - [beer, Beer/Diffuse]
  - [brick_box_3x1x3, BrickBox/Diffuse]
  - [dumpster, Dumpster/Diffuse]
  - [grey_wall, vrc/grey_wall]
""")
def test_a_material_that_saved_worlds_name_has_the_colour_of_its_model(
    name, material, read_world, caplog
):
    folders = (f"model://{name}/materials/{part}" for part in ("scripts", "textures"))
    uris = "".join(f"<uri>{folder}</uri>" for folder in folders)
    script = f"<material><script>{uris}<name>{material}</name></script></material>"
    shape = "<geometry><box><size>1 1 1</size></box></geometry>"
    saved = f'<link name="link"><visual name="v">{shape}{script}</visual></link>'
    included = f"<include><uri>model://{name}</uri></include>"
    world = read_world(f'<model name="saved"><static>1</static>{saved}</model>{included}')
    (visual,), others = (model.links[0].visuals for model in world.models)
    assert visual.colour in [other.colour for other in others]
    assert caplog.messages == []
