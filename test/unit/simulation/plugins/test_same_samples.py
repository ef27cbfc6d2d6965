"""Each plugin, by itself and with all tags, sends the same samples as before.

A change that means to send others renews the text: see `assert_as_before`.
"""

from pathlib import Path

from alike import assert_as_before, lines_of

from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_world_file

HERE = Path(__file__).parent


def samples_of(path):
    """Return the samples on all topics in 1.05 s, while all that drives is to drive."""
    samples = {}
    with Simulation(read_world_file(path)) as simulation:
        for name, model in simulation.models.items():
            for plugin in model.plugins:
                for output in plugin.outputs:
                    output.connect(samples.setdefault(f"{name}/{output.topic}", []).append)
                for entry in plugin.inputs:
                    if entry.kind is PlanarCommand:
                        entry.handle(PlanarCommand(0.5, 0.1, 0.4))
        simulation.run_for(1.05)
    return samples


def test_samples_are_as_before():
    told = []
    for topic, samples in samples_of(HERE / "plugins.world").items():
        told += [f"{topic}: {len(samples)}", *lines_of(samples[-1:], topic)]
    assert_as_before(told, HERE / "plugins.txt")
