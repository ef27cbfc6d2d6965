"""Which packages overlay.sh builds, and what it says of the others."""

import os
from pathlib import Path

import pytest
from shared import cases, module_of

MANIFEST = """<package format="2"><name>{0}</name><version>0.1.0</version>
<description>d</description><license>MIT</license>
<maintainer email="a@example.org">a</maintainer>{1}</package>"""
PLAIN = "<export><build_type>cmake</build_type></export>"


@pytest.fixture
def overlay(monkeypatch):
    """The program, as a module; without Debian's lists."""
    pytest.importorskip("catkin_pkg")
    pytest.importorskip("rospy")
    module = module_of("../scripts/setup/overlay.py")
    monkeypatch.setattr(module, "CONFIGURATIONS", ("/nowhere/{0}",))
    known = {"tf": "libtf-dev"}
    monkeypatch.setattr(module, "debian_package", lambda name, forms: known.get(name, ""))
    return module


@pytest.fixture
def build(overlay, tmp_path, capsys):
    """A function that writes packages and links them; returns the links and what is said."""

    def build(cmake, **manifests):
        (tmp_path / "ws").mkdir()
        for path, text in cmake.items():
            folder = tmp_path / "ws" / path
            folder.mkdir(parents=True)
            name = Path(path).name
            (folder / "package.xml").write_text(MANIFEST.format(name, manifests.get(name, "")))
            (folder / "CMakeLists.txt").write_text(text)
        (tmp_path / "base/share/built/cmake").mkdir(parents=True)
        (tmp_path / "base/share/built/cmake/builtConfig.cmake").touch()
        work = tmp_path / "work"
        overlay.main(work, str(tmp_path / "base"), [str(tmp_path / "ws")])
        said = capsys.readouterr()
        return sorted(os.listdir(work / "src")), said.out.split(), said.err.splitlines()

    return build


def of(*names):
    return f"find_package(catkin REQUIRED COMPONENTS\n  {' '.join(names)}  # tf\n)"


def test_packages_are_linked_and_those_that_miss_others_are_named(build):
    cmake = {
        "src/first": of("built"),
        "src/deep/second": "Find_Package( catkin COMPONENTS first REQUIRED )",
        "src/lost": of("nix", "tf", "built"),
        "src/later": of("lost"),
        "src/alone": "find_package(catkin REQUIRED)",
        "build/left": "",
        "src/bullet_lab": "",
    }
    links, tool, said = build(cmake)
    assert links == ["alone", "first", "second"]
    assert tool == ["catkin_make"]
    none = "nix (Debian has none that is known)"
    assert said == [
        f"overlay: lost: left out; it needs {none}, tf (Debian has it: libtf-dev)",
        "overlay: later: left out; it needs lost (left out)",
    ]


def test_a_package_that_is_no_catkin_package_is_built_in_isolation(build):
    _, tool, _ = build({"src/plain": "", "src/other": ""}, plain=PLAIN)
    assert tool == ["catkin_make_isolated"]


@cases("""
cmake, message:
  - [{}, no package.xml in]
  - [{a/same: "", b/same: ""}, another package 'same']
""")
def test_what_cannot_be_built_is_one_line(build, cmake, message):
    try:
        _, _, said = build(cmake)
    except SystemExit as error:
        said = [str(error)]
    assert len(said) == 1 and message in said[0]
