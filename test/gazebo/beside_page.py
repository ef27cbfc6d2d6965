"""The page docs/beside_gazebo.md: its table, and the pictures of paths and of cameras."""

import math

import cv2
import numpy as np
from beside_scenarios import DRIVES, PACKAGE
from beside_table import FAILED, OK, both

from bullet_lab.core.figures import BLUE, ORANGE, new_figure, plan_axes, save

PAGE = PACKAGE / "docs" / "beside_gazebo.md"
IMAGES = PACKAGE / "docs" / "images"
BEGIN, END = "<!-- table: written by --page -->\n", "<!-- end of table -->\n"
HEADER = "| scenario | figures within | the farthest one | Gazebo | here | allowed |"


def write_page(rows, played, known, out):
    """Write the table into the page, and draw its pictures."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    PAGE.write_text(f"{before}{BEGIN}{short_table(rows)}\n{END}{after}", encoding="utf-8")
    draw_paths(played, known, IMAGES / "beside_paths.png")
    if (out / "cam.png").exists():
        draw_pictures(out / "cam.png", IMAGES / "beside_pictures.png")


def short_table(rows):
    """Return a line of Markdown for each scenario: how many figures agree, and the farthest."""
    by_name = {}
    for row in rows:
        if row.verdict in (OK, FAILED):
            by_name.setdefault(row.scenario, []).append(row)
    lines = [HEADER, "|---|---|---|---|---|---|"]
    for name, judged in by_name.items():
        agree = sum(row.verdict == OK for row in judged)
        far = max(judged, key=lambda row: row.apart)
        bold = "" if agree == len(judged) else "**"
        count = f"{bold}{agree} of {len(judged)}{bold}"
        cells = (name, count, far.quantity, *both(far), far.allowed)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_paths(played, known, path):
    """Draw the paths of all drives, Gazebo's and those here."""
    names = [d.name for d in DRIVES if known[d.name].path and d.name in played]
    columns = 4
    rows = math.ceil(len(names) / columns)
    figure = new_figure(11.0, 2.6 * rows)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    sources = ((known, ORANGE, 3.0, "Gazebo"), (played, BLUE, 1.2, "here"))
    for one, name in zip(axes, names):
        for source, colour, width, word in sources:
            points = source[name].path
            track = np.array([(0.0, 0.0, 0.0, points[0][3]), *points])
            one.plot(track[:, 1], track[:, 2], color=colour, linewidth=width, label=word)
            _, x, y, yaw = track[-1]
            tip = x + 0.15 * math.cos(yaw), y + 0.15 * math.sin(yaw)
            one.annotate("", tip, (x, y), arrowprops={"arrowstyle": "->", "color": colour})
        plan_axes(one, title=name, xlabel="", ylabel="")
    for one in axes[len(names) :]:
        one.set_axis_off()
    figure.axes[0].legend()
    figure.tight_layout()
    save(figure, path)


def draw_pictures(here, path):
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
