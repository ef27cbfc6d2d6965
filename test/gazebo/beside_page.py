"""The page docs/beside_gazebo.md: its table, and the pictures of paths and of cameras."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Dict, List, Mapping, Sequence

import cv2
import numpy as np
from beside_scenarios import DRIVES, PACKAGE, Played
from beside_table import FAILED, OK, Row, both

from bullet_lab.core.figures import BLUE, ORANGE, new_figure, plan_axes, save

PAGE = PACKAGE / "docs" / "beside_gazebo.md"
IMAGES = PACKAGE / "docs" / "images"
BEGIN, END = "<!-- table: written by --page -->\n", "<!-- end of table -->\n"
HEADER = "| scenario | figures within | the farthest one | Gazebo | here | allowed |"


def write_page(
    rows: Sequence[Row], played: Mapping[str, Played], known: Mapping[str, Played], out: Path
) -> None:
    """Write the table into the page, and draw its pictures."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}{short_table(rows)}\n{END}{after}", encoding="utf-8")
    draw_paths(played, known, IMAGES / "beside_paths.png")
    if (out / "cam.png").exists():
        draw_pictures(out / "cam.png", IMAGES / "beside_pictures.png")


def short_table(rows: Sequence[Row]) -> str:
    """Return a line of Markdown for each scenario: how many figures agree, and the farthest."""
    by_name: Dict[str, List[Row]] = {}
    for row in rows:
        if row.verdict in (OK, FAILED):
            by_name.setdefault(row.scenario, []).append(row)
    lines = [HEADER, "|---|---|---|---|---|---|"]
    for name, judged in by_name.items():
        agree = sum(row.verdict == OK for row in judged)
        far = max(judged, key=lambda row: row.apart)
        count = f"{agree} of {len(judged)}"
        count = count if agree == len(judged) else f"**{count}**"
        cells = (name, count, far.quantity, *both(far), far.allowed)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_paths(played: Mapping[str, Played], known: Mapping[str, Played], path: Path) -> None:
    """Draw the paths of all drives, Gazebo's and those here."""
    names = [d.name for d in DRIVES if known[d.name].path and d.name in played]
    columns = 4
    figure = new_figure(11.0, 2.6 * math.ceil(len(names) / columns))
    axes = list(figure.subplots(math.ceil(len(names) / columns), columns, squeeze=False).flat)
    for one, name in zip(axes, names):
        for source, colour, width, word in (
            (known, ORANGE, 3.0, "Gazebo"),
            (played, BLUE, 1.2, "here"),
        ):
            track = np.array([(0.0, *_start(source[name])), *source[name].path])
            one.plot(track[:, 1], track[:, 2], color=colour, linewidth=width, label=word)
            end = track[-1]
            ahead = 0.15 * np.array((math.cos(end[3]), math.sin(end[3])))
            one.annotate(
                "", end[1:3] + ahead, end[1:3], arrowprops={"arrowstyle": "->", "color": colour}
            )
        plan_axes(one, title=name, xlabel="", ylabel="")
    for one in axes[len(names) :]:
        one.set_axis_off()
    figure.axes[0].legend()
    figure.tight_layout()
    save(figure, path)


def _start(played: Played) -> Sequence[float]:
    return 0.0, 0.0, played.path[0][3]


def draw_pictures(here: Path, path: Path) -> None:
    """Draw Gazebo's picture, that of this simulator, and where they differ by more than 3."""
    pictures = [cv2.imread(str(file)) for file in (PACKAGE / "data/gazebo/cam.png", here)]
    apart = np.abs(pictures[0].astype(int) - pictures[1]).max(axis=2)
    share = 100.0 * float((apart > 3).mean())
    shown = [picture[:, :, ::-1] for picture in pictures] + [255 * (apart <= 3).astype(np.uint8)]
    titles = ("Gazebo", "here", f"{share:.1f} % differ by more than 3 levels")
    figure = new_figure(11.0, 3.1)
    for axes, image, title in zip(figure.subplots(1, 3), shown, titles):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.set_title(title)
        axes.set_axis_off()
    figure.tight_layout()
    save(figure, path)
