"""Makes marker images, textured meshes, and models of panels and docks that bear a marker.

Examples:
    rosrun bullet_lab make_marker.py my_marker --id 7 --size 0.1
    rosrun bullet_lab make_marker.py ~/.gazebo/models/my_panel --on panel --dictionary 4x4_50
    rosrun bullet_lab make_marker.py models/docking_station_dots --on dock --dots
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from typing import Any, NoReturn, Sequence

from bullet_lab.core.parameters import ArgumentParser
from bullet_lab.errors import LabError
from bullet_lab.markers.faces import (
    PLATE_THICKNESS,
    Print,
    dots_face,
    nested_face,
    plate_face,
    wall_face,
    write_dock,
    write_panel,
    write_plate,
)
from bullet_lab.vision.dictionaries import DICTIONARY_NAMES, simple_name

STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130
NAME = re.compile(r"[A-Za-z0-9_.-]+")


def make(values: argparse.Namespace) -> str:
    """Make what the command line asks for, and return a sentence that describes it.

    Raises:
        LabError: it cannot be made.
    """
    folder = values.out
    if not NAME.fullmatch(folder.absolute().name):
        raise LabError(f"'{folder.name}' is no name of a model: letters, digits, _ - and .")
    marker = Print(values.dictionary, values.id, values.size, values.quiet)
    made = f"Marker {marker.identifier} of {marker.dictionary}, {marker.size:g} m"
    if values.on != "dock":
        if values.dots or values.around is not None:
            raise LabError("--dots and --around are for the back wall: add --on dock")
        if values.on == "panel":
            write_panel(plate_face(marker), values.height, folder, f"{made}, on a panel.")
        else:
            write_plate(plate_face(marker), PLATE_THICKNESS, folder, folder.absolute().name)
        return made
    if values.dots and values.around is not None:
        raise LabError("a back wall has either --dots or a marker --around, not both")
    face = wall_face(marker)
    if values.dots:
        face = dots_face(marker, values.seed)
        made += f", among dots (seed {values.seed})"
    elif values.around is not None:
        identifier = values.id if values.around_id is None else values.around_id
        around = Print(values.dictionary, identifier, values.around, values.quiet)
        face = nested_face(marker, around)
        made += f", as a white cell of marker {identifier}, {values.around:g} m"
    made += ", on a docking station's back wall"
    write_dock(face, folder, f"{made}.")
    return made


def parser() -> ArgumentParser:
    """Return the parser of the command line."""
    form = argparse.RawDescriptionHelpFormatter
    made = ArgumentParser(prog="make_marker.py", description=__doc__, formatter_class=form)
    made.add_argument("out", type=Path, help="folder that is written to; its name is the model's")

    def option(name: str, default: Any, about: str, **more: Any) -> None:
        if default is not None:
            about += " [%(default)s]"
        made.add_argument(name, default=default, help=about.strip(), **more)

    names = ", ".join(simple_name(name).lower() for name in DICTIONARY_NAMES)
    option("--dictionary", Print.dictionary, f"of OpenCV: {names}")
    option("--id", Print.identifier, "", type=int)
    option("--size", Print.size, "edge of the black square, m", type=float)
    option("--quiet", Print.quiet, "white cells around it", type=int)
    option(
        "--on",
        "plate",
        "plate: image and mesh only; panel: a model that stands on a post; dock: the model "
        "of a docking station with the marker on its back wall",
        choices=("plate", "panel", "dock"),
    )
    option("--height", 0.5, "of a panel's middle, m", type=float)
    made.add_argument("--dots", action="store_true", help="strew the back wall with dots")
    option("--seed", 1, "of the dots", type=int)
    option("--around", None, "size of a larger marker that has this one as a cell, m", type=float)
    option("--around-id", None, "its number [that of the marker]", type=int)
    return made


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line, and exit: 0 done, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    # roslaunch adds its own: __name:=… and __log:=…
    words = [word for word in words if not re.match(r"__\w+:=", word)]
    try:
        made = make(parser().parse_args(words))
    except LabError as error:
        print(f"make_marker: {error}", file=sys.stderr, flush=True)
        sys.exit(STATUS_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    print(f"make_marker: {made}", flush=True)
    sys.exit(0)


if __name__ == "__main__":
    main()
