"""What packages export for Gazebo: folders with models and with media.

`<export><gazebo_ros gazebo_model_path="${prefix}/models"/></export>` in a package.xml adds a folder
to GAZEBO_MODEL_PATH; gazebo_media_path is one of GAZEBO_RESOURCE_PATH.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Dict, Iterable, List
from xml.etree.ElementTree import Element

import rospkg

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.resources import listed_folders
from bullet_lab.simulation.world.xml import parse_text, read_text

# What packages export, and the variables that it goes into.
VARIABLES = {
    "gazebo_model_path": "GAZEBO_MODEL_PATH",
    "gazebo_media_path": "GAZEBO_RESOURCE_PATH",
}
EXPORTER = "gazebo_ros"


def add_exported_paths() -> None:
    """Add what all packages export to the environment of this process."""
    packages = rospkg.RosPack()
    folders = (Path(packages.get_path(name)) for name in sorted(packages.list()))
    for variable, paths in exported_paths(folders).items():
        known = list(map(str, listed_folders(variable)))
        new = [path for path in paths if path not in known]
        if new:
            os.environ[variable] = os.pathsep.join([*known, *new])


def exported_paths(folders: Iterable[Path]) -> Dict[str, List[str]]:
    """Return the folders that packages export, by the names of environment variables.

    Args:
        folders: of the packages; a package.xml that makes no sense is passed over.
    """
    found: Dict[str, List[str]] = {variable: [] for variable in VARIABLES.values()}
    for folder in folders:
        for element in _exports(folder / "package.xml"):
            for attribute, variable in VARIABLES.items():
                value = element.get(attribute, "").replace("${prefix}", str(folder))
                found[variable].extend(part for part in value.split(os.pathsep) if part)
    return found


def _exports(manifest: Path) -> List[Element]:
    try:
        text = read_text(manifest)
        # There may be hundreds of packages, and few of them know Gazebo.
        if EXPORTER not in text:
            return []
        return parse_text(text, str(manifest)).findall(f"export/{EXPORTER}")
    except LabError:
        return []
