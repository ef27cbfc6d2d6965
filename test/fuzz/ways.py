"""The ways in for what comes from outside as a file or as words, and what becomes of it.

Each takes a mutant and returns the numbers that came of it; it may raise LabError, nothing else.
"""

import dataclasses
import functools
import importlib
import math
import pkgutil
import tempfile
from pathlib import Path
from typing import Callable, NamedTuple

import rosbag
import rospy
import trimesh
import yaml
from nav_msgs.msg import Odometry

import bullet_lab.ros.nodes
from bullet_lab.core.parameters import declarations, read_parameters
from bullet_lab.core.trajectory import read_tum
from bullet_lab.docking.database import parse_docks
from bullet_lab.jobs.declaration import find_jobs, read_assignments, read_job
from bullet_lab.navigation.occupancy import read_map
from bullet_lab.simulation.rendering.drawables import read_pixels
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Model, Texture
from bullet_lab.simulation.world.materials import parse_script
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.simulation.world.shapes import Mesh, load_triangles
from bullet_lab.simulation.world.urdf import expand_xacro
from bullet_lab.studies.paths import read_path

PACKAGE = Path(__file__).resolve().parents[2]
EMPTY = "package://bullet_lab/worlds/empty.world"
# Simulated seconds that a world with a mutant runs.
SECONDS = 0.02


class NonsenseError(Exception):
    """A mutant was taken for what makes no sense, and nothing was said."""


class Way(NamedTuple):
    """A way in.

    Attributes:
        seeds: files that make sense, or what stands for them.
        suffix: of the mutants' files.
        enter: takes the path of a mutant; a list that it returns has to be of finite numbers.
        share: how many mutants go this way in a round; those that take long are fewer.
    """

    seeds: Callable
    suffix: str
    enter: Callable
    share: int = 8


def text_of(path, errors="replace"):
    """Return a mutant as text."""
    return path.read_text(encoding="utf-8", errors=errors)


def files(*patterns):
    """Return the contents of files of the package that patterns name."""
    return lambda: [path.read_bytes() for one in patterns for path in sorted(PACKAGE.glob(one))]


@functools.lru_cache(maxsize=None)
def hall():
    """Return the world that all models come into, with a robot of ours that is to live on."""
    simulation = Simulation.of(EMPTY)
    simulation.spawn("package://bullet_lab/urdf/block_robot.urdf", "witness")
    return simulation


def numbers_of(simulation):
    """Return where everything is and how it moves."""
    found = []
    for instance in simulation.models.values():
        state = instance.state()
        for frame in state.links.values():
            found += [*frame.pose.position, *frame.linear, *frame.angular]
    return found


def spawn(path):
    """Spawn a text, as the services do, let it live for a while, and take it away."""
    simulation = hall()
    part = read_spawned(text_of(path, "surrogateescape"), "mutant")
    if not isinstance(part, Model):
        return []
    before = simulation.step
    simulation.add(part, "mutant")
    try:
        simulation.run_for(SECONDS)
        return numbers_of(simulation)
    finally:
        simulation.remove("mutant")
        if simulation.step == before:
            raise NonsenseError("time stands still")


def load_world(path):
    """Load a world, let it run, and load what is saved of it."""
    with Simulation.of(str(path)) as simulation:
        simulation.run_for(SECONDS)
        text, _ = world_text(simulation.snapshot(), path.parent)
        numbers = numbers_of(simulation)
        count = len(simulation.models)
    again = path.with_name("again.world")
    again.write_text(text, encoding="utf-8")
    with Simulation.of(str(again)) as simulation:
        if len(simulation.models) != count:
            raise NonsenseError(f"{count} models were saved, {len(simulation.models)} loaded")
    return numbers


def load_mesh(path):
    """Read a mesh."""
    triangles = load_triangles(Mesh(path, path.name))
    if triangles.faces.size and triangles.faces.max() >= len(triangles.vertices):
        raise NonsenseError("a triangle has corners that are not there")
    return triangles.vertices.ravel().tolist()


def read_docks_file(path):
    """Read a dock database."""
    docks = parse_docks(text_of(path))
    return [value for dock in docks.values() for value in _floats(dataclasses.astuple(dock))]


def read_map_file(path):
    """Read a map, with an image beside it."""
    path.with_name("house.pgm").write_bytes(b"P5\n2 2\n255\n\0\xfe\xcd\xff")
    found = read_map(path)
    return [found.resolution, *found.origin, *found.cells.ravel().tolist()]


def _floats(value):
    if isinstance(value, (tuple, list)):
        for one in value:
            yield from _floats(one)
    elif isinstance(value, float):
        yield value


def trajectory(path):
    """Read a path, as the studies do."""
    found = read_tum(path) if path.suffix == ".tum" else read_path(path)
    return [*found.stamps.ravel().tolist(), *found.poses.ravel().tolist()]


def expanded(path):
    """Expand a xacro file and read what it stands for."""
    read_spawned(expand_xacro(path), "mutant")


@functools.lru_cache(maxsize=None)
def jobs():
    """Return the jobs of the package."""
    return find_jobs(PACKAGE)


def assignments():
    """Return command lines: every argument of every job with its default."""
    texts = []
    for name, job in jobs().items():
        words = (f"{one.name}:={one.default}" for one in job.arguments.values())
        texts.append("\n".join([name, *words]).encode())
    return texts


def assign(path):
    """Check the words of a command line."""
    name, *words = text_of(path, "surrogateescape").split("\n")
    job = jobs().get(name) or next(iter(jobs().values()))
    read_assignments(job, words)


@functools.lru_cache(maxsize=None)
def parameter_kinds():
    """Return the declarations of parameters of all nodes."""
    found = {}
    for entry in pkgutil.iter_modules(bullet_lab.ros.nodes.__path__):
        module = importlib.import_module(f"bullet_lab.ros.nodes.{entry.name}")
        for name, kind in vars(module).items():
            if name.endswith("Parameters") and dataclasses.is_dataclass(kind):
                found[name] = kind
    return tuple(found[name] for name in sorted(found))


def parameter_files():
    """Return every node's parameters with their defaults, as YAML."""
    texts = []
    for kind in parameter_kinds():
        defaults = {name: one.default_text for name, one in declarations(kind).items()}
        texts.append(yaml.safe_dump({kind.__name__: defaults}).encode())
    return texts


def set_parameters(path):
    """Check private parameters of a node, as roslaunch would have put them on the server."""
    try:
        given = yaml.safe_load(path.read_bytes())
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError):
        # roslaunch's own matter.
        return []
    (name, values), *_ = given.items() if isinstance(given, dict) and given else [("", given)]
    values = values if isinstance(values, dict) else {"std": values}
    kinds = {kind.__name__: kind for kind in parameter_kinds()}
    kind = kinds.get(name) or parameter_kinds()[0]
    values = {str(key): value for key, value in values.items()}
    read = read_parameters(kind, lambda key, default: values.get(key[1:], default), values)
    return list(_floats(dataclasses.astuple(read)))


def stl_files():
    """Return a box as STL, in bytes and in words."""
    box = trimesh.creation.box((1.0, 2.0, 0.5))
    return [box.export(file_type="stl"), box.export(file_type="stl_ascii").encode()]


def bags():
    """Return a short bag with odometry."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "path.bag"
        with rosbag.Bag(str(path), "w") as bag:
            for number in range(20):
                message = Odometry()
                message.header.stamp = rospy.Time(1, 50_000_000 * number)
                message.header.frame_id = "odom"
                message.pose.pose.position.x = 0.1 * number
                message.pose.pose.orientation.w = 1.0
                bag.write("/odom", message, message.header.stamp)
        return [path.read_bytes()]


WAYS = {
    "urdf": Way(files("urdf/*.urdf", "test/tutorials/urdf/*.urdf"), ".urdf", spawn, 16),
    "sdf": Way(files("models/*/model.sdf"), ".sdf", spawn, 16),
    "world": Way(files("worlds/*.world"), ".world", load_world, 4),
    "stl": Way(stl_files, ".stl", load_mesh),
    "dae": Way(files("meshes/*.dae"), ".dae", load_mesh),
    "obj": Way(files("models/**/*.obj"), ".obj", load_mesh),
    "material": Way(
        files("test/fuzz/examples/*.material"),
        ".material",
        lambda path: parse_script(text_of(path)),
    ),
    "picture": Way(files("models/**/*.png"), ".png", lambda path: read_pixels(Texture(path))),
    "docks": Way(files("config/docks.yaml"), ".yaml", read_docks_file),
    "map": Way(files("worlds/house.yaml"), ".yaml", read_map_file),
    "tum": Way(files("test/fuzz/examples/*.tum"), ".tum", trajectory),
    "csv": Way(files("test/fuzz/examples/*.csv"), ".csv", trajectory),
    "bag": Way(bags, ".bag", trajectory),
    "xacro": Way(files("test/tutorials/**/*.xacro"), ".xacro", expanded, 1),
    "launch": Way(files("launch/*.launch"), ".launch", lambda path: read_job(path, PACKAGE)),
    "words": Way(assignments, ".txt", assign),
    "parameters": Way(parameter_files, ".yaml", set_parameters),
}


def check_numbers(found):
    """Raise NonsenseError where a number in a list is not finite."""
    for number in found if isinstance(found, list) else ():
        if not math.isfinite(number):
            raise NonsenseError(f"{number} came out")
