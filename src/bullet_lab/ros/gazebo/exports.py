"""The folders with models and media that packages export for Gazebo.

`<export><gazebo_ros gazebo_model_path="${prefix}/models"/></export>` in a package.xml adds a folder
to GAZEBO_MODEL_PATH; gazebo_media_path adds one to GAZEBO_RESOURCE_PATH.
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

# Environment variables by the attributes that extend them.
VARIABLES = {
    "gazebo_model_path": "GAZEBO_MODEL_PATH",
    "gazebo_media_path": "GAZEBO_RESOURCE_PATH",
}
EXPORTER = "gazebo_ros"


def add_exported_paths() -> None:
    """Add the folders that all packages export to the environment of this process."""
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
        folders: of the packages; an invalid package.xml is ignored.
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
        # A quick test first: of hundreds of packages, few export anything for Gazebo.
        if EXPORTER not in text:
            return []
        return parse_text(text, str(manifest)).findall(f"export/{EXPORTER}")
    except LabError:
        return []
