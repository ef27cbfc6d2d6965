"""How each job is run to be verified, and what came out on the machine of the references."""

from __future__ import annotations

import json
import platform
import re
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Dict, List, Mapping

import yaml

from bullet_lab.core.files import write_json
from bullet_lab.errors import LabError
from bullet_lab.ros.verify.fingerprints import Fingerprint

PLAN = "config/verify.yaml"
REFERENCES = "data/verify.json"
_FEATURES = ("avx", "avx2", "avx512f", "fma")
_LIBRARIES = (
    *("matplotlib", "numpy", "opencv-python-headless", "panda3d", "Pillow", "pybullet"),
    *("scipy", "trimesh"),
)


class ReferencesError(LabError):
    """The plan or the references cannot be used."""


@dataclass(frozen=True)
class Plan:
    """How a job is run to be verified, and how its results are compared with the reference.

    Attributes:
        words: arguments that make it small, such as n:=2, with spaces between them.
        tolerance: how far numbers may be off, see `Fingerprint.difference`; 0: not a byte may
            differ, pictures apart.
        left_out: keys of JSON files that are not compared, and why.
    """

    words: str = ""
    tolerance: float = 1e-6
    left_out: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def of(job: str, package: Path) -> Plan:
        """Read the plan of a job; one that has none is run as by default."""
        path = package / PLAN
        try:
            return Plan(**yaml.safe_load(path.read_text()).get(job, {}))
        except (OSError, yaml.YAMLError, TypeError, AttributeError) as error:
            raise ReferencesError(f"cannot use {path} for {job}: {error}") from error


@dataclass(frozen=True)
class References:
    """What came out on one machine.

    Attributes:
        machine: processor and libraries there, see `this_machine`.
        files: by job, the fingerprints of its results by their names.
    """

    machine: Mapping[str, str]
    files: Mapping[str, Mapping[str, Fingerprint]]

    @staticmethod
    def read(path: Path) -> References:
        """Read a file of references; raises ReferencesError."""
        try:
            kept = json.loads(path.read_text())
            files = {
                job: {name: Fingerprint(**entry) for name, entry in files.items()}
                for job, files in kept["files"].items()
            }
            return References(kept["machine"], files)
        except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
            raise ReferencesError(f"cannot use {path}: {error}") from error

    def write(self, path: Path) -> None:
        """Write the file; raises FileError."""
        files = {
            job: {name: asdict(entry) for name, entry in sorted(files.items())}
            for job, files in sorted(self.files.items())
        }
        write_json(path, {"machine": self.machine, "files": files})

    def elsewhere(self) -> List[str]:
        """What this machine has that the reference's had not, in words."""
        return [
            f"{name}: {mine} (reference: {self.machine.get(name, 'unknown')})"
            for name, mine in this_machine().items()
            if self.machine.get(name) != mine
        ]


def this_machine() -> Dict[str, str]:
    """Return what results may depend on, by its name."""
    return {
        "architecture": platform.machine(),
        **_processor(),
        "libc": " ".join(platform.libc_ver()),
        "python": platform.python_version(),
        **{name: _version(name) for name in _LIBRARIES},
    }


def _processor() -> Dict[str, str]:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return {}
    model = re.search(r"^model name\s*: (.*)", text, re.MULTILINE)
    flags = re.search(r"^flags\s*: (.*)", text, re.MULTILINE)
    known = flags[1].split() if flags else ()
    features = " ".join(one for one in _FEATURES if one in known)
    return {"processor": model[1] if model else "unknown", "features": features or "none"}


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "not installed"
