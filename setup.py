"""Tells catkin where the Python packages are, and makes the package that pip installs.

pip puts worlds, robots, launch files and executables where an install space of catkin has them, so
that one search finds both.
"""

import os
from glob import glob

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import find_packages, setup

SHARED = ("config", "data", "launch", "meshes", "models", "urdf", "worlds")


def files_by_folder():
    """Return the shared files and the executables by their folders in the environment."""
    folders = {"share/bullet_lab": ["package.xml"], "lib/bullet_lab": glob("scripts/*.py")}
    for shared in SHARED:
        for folder, _, names in os.walk(shared):
            folders[f"share/bullet_lab/{folder}"] = [os.path.join(folder, name) for name in names]
    return folders


def requirements():
    """Return the lines of requirements.txt without comments."""
    with open("requirements.txt") as file:
        return [line.strip() for line in file if line.strip() and not line.startswith("#")]


options = generate_distutils_setup(
    packages=find_packages("src"),
    package_dir={"": "src"},
    package_data={
        "bullet_lab.ros.view": ["*.js"],
        "bullet_lab.simulation.rendering": ["*.vert", "*.frag"],
    },
)
# catkin reads this file under another name, and installs shared files and executables itself.
if __name__ == "__main__" and "CATKIN_BINARY_DIR" not in os.environ:
    options.update(
        python_requires=">=3.8",
        install_requires=requirements(),
        data_files=list(files_by_folder().items()),
        entry_points={"console_scripts": ["bullet_lab=bullet_lab.entry:command"]},
    )
setup(**options)
