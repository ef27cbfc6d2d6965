"""Each plugin, by itself and with all tags, sends the same samples as before, also after a reset.

A change that means to send others renews the text: see `assert_as_before`.
"""

from dataclasses import replace
from pathlib import Path

import yaml
from alike import assert_as_before, lines_of
from shared import EMPTY_WORLD, PACKAGE

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import ImageSample, PlanarCommand, PointsSample
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf, read_urdf_file

HERE = Path(__file__).parent
PICTURES = ImageSample, PointsSample


def listen(plugins):
    """Return lists that grow with the samples on all topics but those of pictures."""
    samples = {}
    for name, plugin in plugins:
        for output in plugin.outputs:
            heard = samples.setdefault(f"{name}/{output.topic}", [])
            output.connect(heard.append, lambda kind=output.kind: kind not in PICTURES)
    return samples


def test_samples_are_as_before(caplog):
    with Simulation(read_world_file(HERE / "plugins.world")) as simulation:
        plugins = [(name, p) for name, model in simulation.models.items() for p in model.plugins]
        inputs = [(name, entry) for name, plugin in plugins for entry in plugin.inputs]
        heard = listen(plugins)
        for _ in range(2):
            for _, entry in inputs:
                if entry.kind is PlanarCommand:
                    entry.handle(PlanarCommand(0.5, 0.1, 0.4))
            simulation.run_for(1.05)
            told = [*caplog.messages, *(f"{name} takes {entry.topic}" for name, entry in inputs)]
            for topic, samples in heard.items():
                told += [f"{topic}: {len(samples)}", *lines_of(samples[:1] + samples[-1:], topic)]
                samples.clear()
            assert_as_before(told, HERE / "plugins.txt")
            simulation.reset_simulation()


def drive_of(robot, tags=None, file=""):
    """Return a robot with another drive, or with other tags of its own."""
    model = read_urdf(robot, "r") if robot.startswith("<") else read_urdf_file(PACKAGE / robot)
    plugin = next(tag for tag in model.plugins if tag.name.endswith(("drive", "move")))
    changed = {**plugin.tags, **(tags or {})}
    return replace(
        model, plugins=(replace(plugin, filename=file or plugin.filename, tags=changed),)
    )


def test_drives_are_as_before(caplog):
    told = []
    for name, case in yaml.safe_load((HERE / "drives.yaml").read_text()).items():
        steps, start = case.pop("steps"), Pose.from_rpy(*case.pop("start", [[0.0] * 3] * 2))
        with Simulation.of(EMPTY_WORLD) as simulation:
            robot = simulation.add(drive_of(**case), pose=start)
            heard = listen((name, plugin) for plugin in robot.plugins)
            for *velocity, seconds in steps:
                robot.command("cmd_vel", PlanarCommand(*velocity))
                simulation.run_for(seconds)
                told += lines_of([*robot.pose().position, robot.pose().yaw], f"{name} is at")
                told += lines_of(getattr(robot.plugins[0], "origin", None), f"{name} from")
                for body in robot.bodies.values():
                    for joint in body.joint_names:
                        state = body.joint_state(joint)
                        told += lines_of((joint, state.position, state.velocity), name)
        for topic, samples in heard.items():
            told += [f"{topic}: {len(samples)}", *lines_of(samples[-5:], topic)]
    # What rubs and bumps grows from one step to the next.
    assert_as_before([*told, *caplog.messages], HERE / "drives.txt", 1e-4)


def test_wrong_tags_are_named_as_before(caplog):
    with Simulation(read_world_file(HERE / "wrong.world")):
        assert_as_before(caplog.messages, HERE / "wrong.txt")


def test_wrong_tags_of_drives_are_named_as_before(caplog):
    models = {model.name: model for model in read_world_file(HERE / "plugins.world").models}
    for name, cases in yaml.safe_load((HERE / "wrong_drives.yaml").read_text()).items():
        drive = next(tag for tag in models[name].plugins if tag.name == "drive")
        for tags in cases:
            changed = replace(drive, tags={**drive.tags, **tags})
            with Simulation() as simulation:
                simulation.add(replace(models[name], plugins=(changed,)))
    assert_as_before(caplog.messages, HERE / "wrong_drives.txt")
