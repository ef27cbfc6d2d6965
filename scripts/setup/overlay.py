"""Links packages into the workspace of overlay.sh, and names what their builds miss.

Usage: overlay.py WORKSPACE PREFIX FOLDER…; PREFIX is a folder with built packages, beside those of
ROS. Each folder is a package, or has packages below it.

Prints the command that builds them: catkin_make, or catkin_make_isolated if one of them is a
package of plain CMake. Without such a line, there is nothing to build.
"""

from __future__ import annotations

import glob
import re
import shutil
import sys
from pathlib import Path
from typing import Iterator, Mapping

from catkin_pkg.package import InvalidPackage, Package
from catkin_pkg.packages import find_packages_allowing_duplicates

from bullet_lab.ros.record.robot_parts import debian_package

LAB = "bullet_lab"
COMMENT = re.compile(r"#.*")
COMPONENTS = re.compile(r"find_package\s*\(\s*catkin\b[^)]*?\bCOMPONENTS\b([^)]*)\)", re.IGNORECASE)
# Words between the components of find_package.
OPTIONS = ("REQUIRED", "OPTIONAL_COMPONENTS", "QUIET")
# Names of Debian packages with what a build needs of a ROS package, the likeliest first.
DEBIAN = ("lib{}-dev", "ros-{}", "ros-noetic-{}", "lib{}lib-dev", "{}", "python3-{}")
CONFIGURATIONS = ("/opt/ros/noetic/share/{0}/cmake", "/usr/share/{0}/cmake", "/usr/lib/*/cmake/{0}")


def packages_in(folders: list[str]) -> dict[Path, Package]:
    """Return the packages by their folders; of two with one name the first, and never the lab."""
    found: dict[Path, Package] = {}
    names: set[str] = set()
    for folder in map(Path, folders):
        if not folder.is_dir():
            raise SystemExit(f"overlay: {folder}: no such folder")
        try:
            below = find_packages_allowing_duplicates(str(folder.resolve()))
        except InvalidPackage as error:
            raise SystemExit(f"overlay: {' '.join(str(error).split())}") from error
        for path, package in sorted(below.items()):
            place = (folder / path).resolve()
            # What catkin and the lab have built is in such folders.
            if package.name == LAB or {"build", "devel", "install"} & {*Path(path).parts}:
                continue
            if package.name in names:
                say(f"{place}: left out; there is another package '{package.name}'")
                continue
            names.add(package.name)
            found[place] = package
    return found


def components_of(folder: Path) -> list[str]:
    """Return the names of the packages that find_package(catkin … COMPONENTS …) has."""
    file = folder / "CMakeLists.txt"
    text = COMMENT.sub("", file.read_text(errors="replace")) if file.is_file() else ""
    words = " ".join(COMPONENTS.findall(text)).split()
    return [word for word in words if word not in OPTIONS and "$" not in word]


def is_built(name: str, prefix: str) -> bool:
    """Return whether CMake finds a package."""
    places = (*CONFIGURATIONS, f"{prefix}/share/{{0}}/cmake")
    return any(glob.glob(f"{place.format(name)}/{name}Config.cmake") for place in places)


def missing(packages: Mapping[Path, Package], prefix: str) -> Iterator[tuple[Path, list[str]]]:
    """Yield the packages that cannot be built, each with what it misses."""
    names = {package.name for package in packages.values()}
    needs = {folder: components_of(folder) for folder in packages}
    without: dict[Path, list[str]] = {}
    while True:
        lost = {packages[folder].name for folder in without}
        for folder, wanted in needs.items():
            gone = [n for n in wanted if n in lost or (n not in names and not is_built(n, prefix))]
            if gone and folder not in without:
                without[folder] = gone
                break
        else:
            yield from without.items()
            return


def hint(name: str) -> str:
    """Return where to get a package."""
    debian = debian_package(name, DEBIAN)
    return f"{name} ({f'Debian has it: {debian}' if debian else 'Debian has none that is known'})"


def say(line: str) -> None:
    """Print a line to people."""
    print(f"overlay: {line}", file=sys.stderr)


def main(workspace: Path, prefix: str, folders: list[str]) -> None:
    """Make the links."""
    packages = packages_in(folders)
    if not packages:
        raise SystemExit(f"overlay: no package.xml in {', '.join(folders)} or below")
    lost = {package.name for package in packages.values()}
    for folder, names in missing(packages, prefix):
        package = packages.pop(folder)
        gone = [f"{name} (left out)" if name in lost else hint(name) for name in names]
        say(f"{package.name}: left out; it needs {', '.join(gone)}")
    shutil.rmtree(workspace / "src", ignore_errors=True)
    (workspace / "src").mkdir(parents=True)
    for folder, package in packages.items():
        (workspace / "src" / package.name).symlink_to(folder)
    if packages:
        kinds = {package.get_build_type() for package in packages.values()}
        print("catkin_make" if kinds == {"catkin"} else "catkin_make_isolated")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3:])
