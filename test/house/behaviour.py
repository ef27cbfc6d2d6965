"""Prints what users rely on, a line each, for a diff before and after a change of the structure.

Jobs with their arguments, parameters of executables, types with md5 sums, rows of the contract and
plugins. With --live also the topics and services of a running bridge and its nodes. With --results
DIR also the files in a folder of results, the columns of its tables and the keys of its summaries.
"""

import argparse
import csv
import importlib
import json
import runpy
import sys
import tempfile
from dataclasses import MISSING
from pathlib import Path

import yaml

from bullet_lab.core.parameters import declarations
from bullet_lab.jobs.declaration import find_jobs, parameter_kinds
from bullet_lab.simulation.plugins import known_plugins

PACKAGE = Path(__file__).resolve().parents[2]
CONTRACT = PACKAGE / "test" / "contract"


def jobs():
    """Yield the arguments of each job with their defaults."""
    for name, job in find_jobs(PACKAGE).items():
        for argument in job.arguments.values():
            yield f"job {name} {argument.name}:={argument.default}"


def executables():
    """Yield each executable's parameters with their defaults and what is allowed."""
    sys.path.insert(0, str(CONTRACT))
    for script in sorted([*(PACKAGE / "scripts").glob("*.py"), CONTRACT / "gazebo_contract.py"]):
        yield f"executable {script.name}"
        for kind in parameter_kinds(runpy.run_path(str(script))["MAIN"]):
            for entry in declarations(kind).values():
                default = "" if entry.default is MISSING else f"={entry.default_text}"
                limits = entry.allowed
                yield f"executable {script.name} {entry.name}{default} [{limits}]"


def types():
    """Yield the md5 sums of this package's messages, services and actions."""
    for folder, ending in (("msg", ""), ("srv", ""), ("action", "Action")):
        for path in sorted((PACKAGE / folder).glob(f"*.{folder}")):
            module = "srv" if folder == "srv" else "msg"
            name = path.stem + ending
            kind = getattr(importlib.import_module(f"bullet_lab.{module}"), name)
            yield f"{folder} {path.stem} {kind._md5sum}"


def contract():
    """Yield the rows of the contract, and the files of plugins that are simulated."""
    for path in sorted((CONTRACT / "rows").glob("*.yaml")):
        content = yaml.safe_load(path.read_text())
        for row in content.get("rows", ()) if isinstance(content, dict) else ():
            yield f"contract {path.stem}: {row.get('name') or row}"
    yield from (f"plugin {name}" for name in known_plugins())


def live():
    """Yield the topics and services of a running bridge and the nodes around it."""
    import rosgraph
    import rospy
    import rosservice

    sys.path.insert(0, str(PACKAGE / "test" / "fuzz"))
    from live import FuzzedLab

    from bullet_lab.ros.launcher.supervision import prepare_master

    prepare_master()
    rospy.init_node("behaviour", disable_signals=True)
    rospy.set_param("/use_sim_time", True)
    with tempfile.TemporaryDirectory() as folder:
        lab = FuzzedLab(Path(folder))
        master = rosgraph.Master("/behaviour")
        published, subscribed, services = master.getSystemState()
        kinds = dict(master.getTopicTypes())
        for what, listed in (("published", published), ("subscribed", subscribed)):
            for topic, nodes in listed:
                for node in sorted(set(nodes) - {"/behaviour"}):
                    yield f"{what} {topic} {kinds.get(topic, '?')} {node}"
        for name, nodes in services:
            if not name.endswith(("get_loggers", "set_logger_level")):
                yield f"service {name} {rosservice.get_service_type(name)} {nodes[0]}"
        lab.end()


def results(folder):
    """Yield the files of results with the columns of tables and the keys of JSON files."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.suffix == ".csv":
            with path.open(newline="") as file:
                yield f"result {name}: {','.join(next(csv.reader(file), []))}"
        elif path.suffix == ".json":
            yield from (f"result {name}: {key}" for key in keys_of(json.loads(path.read_text())))
        elif path.is_file():
            yield f"result {name}"


def keys_of(value, above=""):
    """Yield the keys of nested dictionaries, with those above them; of lists, their first entry."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield f"{above}/{key}"
            yield from keys_of(entry, f"{above}/{key}")
    elif isinstance(value, list) and value:
        yield from keys_of(value[0], f"{above}[]")


def main():
    """Print all lines, sorted within each kind."""
    parser = argparse.ArgumentParser(prog="house.sh behaviour", description=__doc__.splitlines()[0])
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--results", type=Path)
    wanted = parser.parse_args()
    parts = [jobs(), executables(), types(), contract()]
    if wanted.live:
        parts.append(live())
    if wanted.results:
        parts.append(results(wanted.results))
    for part in parts:
        print("\n".join(sorted(set(part))))


if __name__ == "__main__":
    main()
