from shared import cases, refuses

from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.nodes import save_world as module
from bullet_lab.ros.nodes.save_world import SaveWorldParameters, save_world


@cases("words: [[], [one.world, another.world]]")
def test_one_file_is_named(monkeypatch, words):
    monkeypatch.setattr(module.sys, "argv", ["save_world.py", *words])
    with refuses(r"^usage: save_world\.py FILE$", NodeError):
        save_world.__wrapped__(SaveWorldParameters())
