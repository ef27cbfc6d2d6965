"""The documents keep up with the code: links lead somewhere, no job or plugin without a page."""

import ast
import re

from shared import PACKAGE

from bullet_lab.simulation.plugins import known_plugins

PAGES = sorted([*PACKAGE.glob("*.md"), *(PACKAGE / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
PLUGINS = PACKAGE / "src" / "bullet_lab" / "simulation" / "plugins"
# How a plugin reads its own tags.
READERS = (
    *("text", "number", "boolean", "vector", "schedule"),
    *("required", "choice", "output", "wheel_joint"),
)
TAG = re.compile(r"[a-zA-Z]\w*")


def test_links_lead_somewhere():
    for page in PAGES:
        links = [link for link in LINK.findall(page.read_text()) if "://" not in link]
        assert not [link for link in links if not (page.parent / link).exists()], page


def test_each_job_has_a_page_that_the_readme_names():
    readme = (PACKAGE / "README.md").read_text()
    for launch in (PACKAGE / "launch").glob("*.launch"):
        page = f"docs/jobs/{launch.stem}.md"
        assert (PACKAGE / page).is_file()
        assert page in readme


def test_each_plugin_and_each_tag_that_it_reads_has_a_page():
    trees = [ast.parse(module.read_text()) for module in PLUGINS.glob("*.py")]
    kinds = [kind for tree in trees for kind in tree.body if isinstance(kind, ast.ClassDef)]
    described = set()
    for page in (PACKAGE / "docs" / "plugins").glob("[!R]*.md"):
        text = page.read_text()
        files = set(re.findall(r"lib\w+\.so", text.split("\n", 1)[0]))
        described |= files
        own = [kind for kind in kinds if files & literals(kind)]
        missing = [tag for kind in own for tag in tags_read(kind) if tag not in text]
        assert not missing, f"{page.name}: {missing}"
    assert described == set(known_plugins())


def tags_read(kind):
    """Return what a class asks of `mount`, or names where a mount is handed on."""
    for call in ast.walk(kind):
        if isinstance(call, ast.Call):
            yield from tag_of(call)


def literals(tree):
    return {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)}


def tag_of(call):
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    asked = getattr(getattr(call.func, "value", None), "id", "mount")
    if name in READERS and asked == "mount":
        texts = [a.value for a in call.args[:2] if isinstance(a, ast.Constant)]
        yield from (t for t in texts[:1] if isinstance(t, str) and TAG.fullmatch(t))
