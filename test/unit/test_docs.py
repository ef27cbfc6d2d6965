"""The documents keep up with the code: links lead somewhere, no job or plugin without a page."""

import ast
import re
from pathlib import Path

import pytest

from bullet_lab.simulation.plugins import known_plugins

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
PLUGINS = ROOT / "src" / "bullet_lab" / "simulation" / "plugins"
# How a plugin reads its own tags.
READERS = ("text", "number", "boolean", "vector", "schedule", "at_least", "output", "wheel_joint")
TAG = re.compile(r"[a-zA-Z]\w*")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    links = [link for link in LINK.findall(page.read_text()) if "://" not in link]
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing


def test_each_job_has_a_page_that_the_readme_names():
    readme = (ROOT / "README.md").read_text()
    for launch in (ROOT / "launch").glob("*.launch"):
        page = f"docs/jobs/{launch.stem}.md"
        assert (ROOT / page).is_file()
        assert page in readme


def test_each_plugin_has_a_page():
    titles = "\n".join(page.read_text().split("\n", 1)[0] for page in plugin_pages())
    missing = [name for name in known_plugins() if name not in titles]
    assert not missing


def test_each_tag_that_a_plugin_reads_is_on_its_page():
    for page in plugin_pages():
        text = page.read_text()
        files = re.findall(r"libgazebo_ros_\w+\.so", text.split("\n", 1)[0])
        for module in PLUGINS.glob("*.py"):
            source = module.read_text()
            if any(f'"{name}"' in source for name in files):
                missing = [tag for tag in tags_read(source) if tag not in text]
                assert not missing, f"{page.name}: {missing}"


def plugin_pages():
    pages = sorted((ROOT / "docs" / "plugins").glob("*.md"))
    return [page for page in pages if page.name != "README.md"]


def tags_read(source):
    """Return what is asked of `mount`, or named where a mount is handed on."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = getattr(function, "attr", getattr(function, "id", ""))
        asked = getattr(getattr(function, "value", None), "id", "mount")
        if name in READERS and asked == "mount":
            for argument in node.args[:2]:
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    if TAG.fullmatch(argument.value):
                        yield argument.value
                    break
