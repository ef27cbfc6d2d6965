"""The models that are put into the world to be looked at, and the floor that they stand on.

They stand far from what else is in the world, and high above it.
"""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Dict, Iterable, List, Sequence, Tuple
from xml.sax.saxutils import escape, quoteattr

from bullet_lab.ros.contract.rows import ContractError, Probe

Place = Tuple[float, float, float]

PREFIX = "contract_"
FLOOR = f"{PREFIX}floor"
# Where the probes stand: m, in the world.
CORNER = (90.0, -20.0, 100.0)
APART = 5.0
ROW_LENGTH = 10
# A slab below each probe, in m.
SLAB = (4.6, 4.6, 0.2)


def model_name(probe: Probe) -> str:
    """Return the name of a probe's model."""
    return f"{PREFIX}{probe.name}"


def namespace(probe: Probe) -> str:
    """Return the namespace that a probe's plugins have if they name none."""
    return f"contract/{probe.name}" if probe.namespace is None else str(probe.namespace)


def topic_name(name: str, probe: Probe) -> str:
    """Return the full name of a topic or service that a probe's plugin gives it."""
    space = namespace(probe).strip("/")
    full = name if name.startswith("/") or not space else f"/{space}/{name}"
    return full if full.startswith("/") else f"/{full}"


def places(probes: Iterable[Probe]) -> Dict[str, Place]:
    """Return where each probe is put, by its name."""
    x, y, z = CORNER
    return {
        probe.name: (x + APART * (number % ROW_LENGTH), y + APART * (number // ROW_LENGTH), z)
        for number, probe in enumerate(probes)
    }


def probe_text(probe: Probe, folder: Path) -> str:
    """Return the SDF of a probe; raises ContractError."""
    path = folder / "probes" / probe.robot
    fill = {"plugin": plugin_text(probe), **{key: str(value) for key, value in probe.fill.items()}}
    try:
        return Template(path.read_text(encoding="utf-8")).substitute(fill)
    except (OSError, KeyError, ValueError) as error:
        raise ContractError(f"{path}, for {probe.name}: {error!r}") from error


def plugin_text(probe: Probe) -> str:
    """Return the `<plugin>` of a probe; nothing for one that has none."""
    if not probe.plugin:
        return ""
    tags: List[str] = []
    for tag, value in probe.tags.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        tags.append(f"<{tag}>{escape(text)}</{tag}>")
    name, file = quoteattr(f"{probe.name}_plugin"), quoteattr(probe.plugin)
    return f"<plugin name={name} filename={file}>{''.join(tags)}</plugin>"


def floor_text(standing: Sequence[Place]) -> str:
    """Return the SDF of a static model with a slab below each place, in the world's frame."""
    width, depth, height = SLAB
    slabs = "".join(
        f'<collision name="slab_{number}"><pose>{x:g} {y:g} {z - height / 2:g} 0 0 0</pose>'
        f"<geometry><box><size>{width:g} {depth:g} {height:g}</size></box></geometry></collision>"
        for number, (x, y, z) in enumerate(standing)
    )
    link = f'<link name="link">{slabs}</link>'
    return f'<sdf version="1.6"><model name="floor"><static>true</static>{link}</model></sdf>'
