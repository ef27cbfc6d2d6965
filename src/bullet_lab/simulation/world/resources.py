"""Find the files that worlds and robots refer to.

`package://` is searched in ROS packages; `model://` in ~/.gazebo/models, the folders of
GAZEBO_MODEL_PATH, this package's `models/` and the ROS package of that name; a relative path beside
its document, then in the folders of GAZEBO_RESOURCE_PATH, like `file://media/…`. A reference never
reaches the network, nor a file outside these folders.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Sequence
from urllib.parse import quote, unquote, urlsplit

from bullet_lab.errors import LabError

PACKAGE = "bullet_lab"
# What to do if a model is not found: Gazebo would download it.
OF_GAZEBO = "copy one of Gazebo's from github.com/osrf/gazebo_models to ~/.gazebo/models"


class ResourceError(LabError):
    """A file does not exist, or the document may not read it."""


def package_share() -> Path:
    """Return the folder that holds this package's worlds, models, meshes and URDF files.

    Raises:
        ResourceError: these folders are neither in the source tree nor installed.
    """
    library = Path(__file__).resolve().parents[2]
    source_tree, *above = list(library.parents)[1:4]
    for folder in (source_tree, *(prefix / "share" / PACKAGE for prefix in above[1:])):
        if (folder / "package.xml").is_file():
            return folder
    raise ResourceError(f"the shared files of {PACKAGE} are neither in {source_tree} nor installed")


def ros_package_folder(name: str) -> Path | None:
    """Return the folder of a ROS package, or None if it is unknown or ROS is not installed.

    A process searches the folders of ROS_PACKAGE_PATH once.
    """
    if name == PACKAGE:
        return package_share()
    try:
        import rospkg
    except ImportError:
        return None
    try:
        return Path(rospkg.RosPack.get_instance().get_path(name))
    except rospkg.ResourceNotFound:
        return None


def gazebo_model_folders() -> tuple[Path, ...]:
    """Return the folders of `model://`, in Gazebo's order."""
    home = os.environ.get("HOME", "")
    own = (Path(home) / ".gazebo" / "models",) if home else ()
    return (*own, *listed_folders("GAZEBO_MODEL_PATH"), package_share() / "models")


# Where Gazebo searches for files in a folder of GAZEBO_RESOURCE_PATH.
RESOURCES = ("", "models", "media/models", "Media/models")
# Where OGRE searches for scripts and pictures in a folder of media.
MEDIA = ("", "materials/scripts", "materials/textures", "materials/programs", "media/models")


def gazebo_media_folders() -> tuple[Path, ...]:
    """Return the folders in GAZEBO_RESOURCE_PATH that may hold materials and pictures."""
    found = []
    for folder in listed_folders("GAZEBO_RESOURCE_PATH"):
        media = (folder / name / part for name in ("media", "Media") for part in MEDIA)
        found += [place for place in (folder, *media) if place.is_dir()]
    return tuple(found)


def listed_folders(variable: str) -> tuple[Path, ...]:
    """Return the folders in an environment variable, which are separated by colons."""
    listed = os.environ.get(variable, "").split(os.pathsep)
    return tuple(Path(folder) for folder in listed if folder)


def package_uri(path: Path) -> str:
    """Return the package:// or model:// URI of a file; empty if it has none."""
    for folder in _package_above(path):
        # A checkout of this package may have any name; those of others have the package's name.
        for name in (PACKAGE, folder.name):
            known = ros_package_folder(name)
            if known is not None and os.path.realpath(known) == os.path.realpath(folder):
                return f"package://{name}/{quote(os.path.relpath(path, folder))}"
    for folder in gazebo_model_folders():
        if is_below(path, folder):
            return f"model://{quote(os.path.relpath(path, os.path.realpath(folder)))}"
    return ""


class ResourceFinder:
    """Finds the files that a document in a folder refers to; None for one that came as text."""

    def __init__(self, folder: Path | None = None):
        self._own = () if folder is None else (folder,)

    @classmethod
    def anywhere(cls) -> ResourceFinder:
        """Return a finder for references by the user, who may name any file."""
        return _UserFinder(Path.cwd())

    def find(self, uri: str) -> Path:
        """Return the file or folder that a URI or a path means.

        Raises:
            ResourceError: unknown kind of reference, unknown package or model, a path that
                leaves its folder, or no such file.
        """
        try:
            return self._find(uri)
        except (OSError, ValueError) as error:
            # For example a name that is too long, a zero byte, or half an IPv6 address.
            reason = error.strerror if isinstance(error, OSError) else error
            raise ResourceError(f"'{uri[:80]}': {reason}") from error

    def _find(self, uri: str) -> Path:
        if not uri:
            raise ResourceError("no file is named; a path or a URI is needed")
        parts = urlsplit(uri)
        if parts.scheme == "package":
            folder = ros_package_folder(parts.netloc)
            if folder is None:
                raise ResourceError(f"'{uri}': no ROS package '{parts.netloc}'")
            return _search((folder,), unquote(parts.path).lstrip("/"), uri)
        if parts.scheme == "model":
            path = (parts.netloc + unquote(parts.path)).lstrip("/")
            missing = f"in none of the model folders (GAZEBO_MODEL_PATH); {OF_GAZEBO}"
            folders, (name, _, rest) = gazebo_model_folders(), path.partition("/")
            is_model = any((folder / name).exists() for folder in folders)
            package = None if is_model else ros_package_folder(name)
            if package is not None and (package / (rest or "model.config")).exists():
                return _search((package,), rest, uri)
            return _search(folders, path, uri, missing)
        if parts.scheme == "file" and parts.netloc in ("", "localhost"):
            return self._absolute(uri, Path(unquote(parts.path)))
        if parts.scheme == "file":
            return self._relative(uri, parts.netloc + unquote(parts.path))
        if parts.scheme:
            raise ResourceError(f"'{uri}': only package://, model://, file:// and paths are read")
        path = Path(uri)
        if path.is_absolute():
            return self._absolute(uri, path)
        return self._relative(uri, uri)

    def _relative(self, uri: str, path: str) -> Path:
        listed = listed_folders("GAZEBO_RESOURCE_PATH")
        folders = (*self._own, *(folder / part for folder in listed for part in RESOURCES))
        if not folders:
            raise ResourceError(f"'{uri}': a relative path in a text; use a URI")
        return _search(folders, path, uri)

    def _absolute(self, uri: str, path: Path) -> Path:
        """Allow an absolute path only below the document, a model folder or a ROS package.

        One of another machine, as in worlds that were saved there, is searched in the package here
        that has the name of a folder in it.
        """
        roots = (*gazebo_model_folders(), *self._own, *_package_above(path))
        if any(is_below(path, root) for root in roots):
            return _existing(path, uri)
        for holder in path.parents:
            package = ros_package_folder(holder.name)
            if package is not None:
                return _search((package,), str(path.relative_to(holder)), uri)
        raise ResourceError(f"'{uri}': outside the folders of the document and of all packages")


class _UserFinder(ResourceFinder):
    """Finds any file that the user names."""

    def _find(self, uri: str) -> Path:
        if "://" in uri:
            return super()._find(uri)
        return _existing(Path(uri).expanduser().absolute(), uri)

    def _absolute(self, uri: str, path: Path) -> Path:
        return _existing(path, uri)


def _package_above(path: Path) -> tuple[Path, ...]:
    """Return the folder of the ROS package that holds a path, if one does."""
    holders = (folder for folder in path.parents if (folder / "package.xml").is_file())
    return tuple(holders)[:1]


def _search(folders: Sequence[Path], path: str, uri: str, missing: str = "") -> Path:
    """Return a path in the first folder that contains it, or whose ROS package does.

    Raises:
        ResourceError: the path leads out of a folder, without revealing whether such a file
            exists; or it is in none of them, which is said as `missing`.
    """
    leaves = False
    for folder in folders:
        inside = (folder, *_package_above(folder / path))
        if not any(is_below(folder / path, root) for root in inside):
            leaves = True
        elif (folder / path).exists():
            return folder / path
    if leaves:
        raise ResourceError(f"'{uri}': leaves its folder")
    raise ResourceError(f"'{uri}': {missing or f'no such file ({folders[0] / path})'}")


def is_below(path: Path, folder: Path) -> bool:
    """Return whether a path leads to a file in a folder."""
    # realpath: neither ".." nor a symbolic link may lead out of the folder.
    inner, outer = os.path.realpath(path), os.path.realpath(folder)
    return os.path.commonpath([inner, outer]) == outer


def _existing(path: Path, uri: str) -> Path:
    if not path.exists():
        raise ResourceError(f"'{uri}': no such file ({path})")
    return path
