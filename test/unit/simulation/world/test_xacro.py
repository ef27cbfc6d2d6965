import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from sensor_worlds import INERTIAL
from shared import cases

from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world import urdf as xacro_files
from bullet_lab.simulation.world import xacro_child
from bullet_lab.simulation.world.description import Box
from bullet_lab.simulation.world.urdf import XacroError, expand_xacro, read_urdf_file

pytest.importorskip("xacro")

HEAD = '<robot name="made" xmlns:xacro="http://www.ros.org/wiki/xacro">'
LINK = (
    f'<link name="base">{INERTIAL}<collision><geometry><box size="${{2 * w}} ${{w}} 1"/></geometry>'
    "</collision></link>"
)


@pytest.fixture(autouse=True)
def without_coverage(monkeypatch):
    # The process that xacro runs in may write no file.
    monkeypatch.delenv("COVERAGE_PROCESS_START", raising=False)


@pytest.fixture
def limits(monkeypatch, capsys):
    """Expand in this process; return the limits that would be set for the other one."""

    def run(command, env, **options):
        found.update(options)
        monkeypatch.setattr(sys, "argv", command[2:])
        monkeypatch.setattr(sys, "path", ["", *sys.path])
        code, said = xacro_child.main(), capsys.readouterr()
        return subprocess.CompletedProcess(command, code, said.out.encode(), said.err.encode())

    found = {}
    monkeypatch.setattr(xacro_files.subprocess, "run", run)
    monkeypatch.setattr(resource, "setrlimit", found.__setitem__)
    for name in ("ament_index_python", "ament_index_python.packages"):
        monkeypatch.setitem(sys.modules, name, None)
    return found


@pytest.fixture
def write(tmp_path):
    def writer(body, name="robot.urdf.xacro", head=HEAD):
        path = tmp_path / name
        path.write_text(f"{head}{body}</robot>" if head else body)
        return path

    return writer


def test_properties_and_expressions(write):
    model = read_urdf_file(write('<xacro:property name="w" value="${0.1 + 0.2}"/>' + LINK))
    assert model.name == "made"
    assert model.links[0].collisions[0].geometry == Box(pytest.approx((0.6, 0.3, 1.0)))


def test_macros_arguments_and_conditions(write, limits):
    path = write(
        '<xacro:arg name="wide" default="true"/><xacro:property name="w" value="1"/>'
        '<xacro:macro name="plate" params="name w"><link name="${name}">'
        f'{INERTIAL}<collision><geometry><box size="${{w}} 1 1"/></geometry></collision></link>'
        '</xacro:macro><xacro:if value="$(arg wide)"><xacro:plate name="base" w="3"/></xacro:if>'
        '<xacro:unless value="$(arg wide)"><xacro:plate name="base" w="2"/></xacro:unless>'
    )
    assert read_urdf_file(path).links[0].collisions[0].geometry.size == (3, 1, 1)
    seconds, memory, nothing = (30, 30), (1 << 30,) * 2, (0, 0)
    assert limits == {
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_AS: memory,
        resource.RLIMIT_FSIZE: nothing,
        resource.RLIMIT_CORE: nothing,
        "stdin": subprocess.DEVNULL,
        "capture_output": True,
        "timeout": 60,
        "check": False,
    }


def test_includes_beside_it_and_in_packages(write, tmp_path, limits):
    write('<xacro:property name="w" value="0.5"/>', "sizes.xacro")
    model = read_urdf_file(write('<xacro:include filename="sizes.xacro"/>' + LINK))
    assert model.links[0].collisions[0].geometry.size == (1.0, 0.5, 1.0)
    here = '<xacro:include filename="$(find bullet_lab)/urdf/block_robot.urdf"/>'
    assert 'link name="laser_link"' in expand_xacro(write(here, "other.xacro"))


def test_a_package_that_is_not_there(write, limits):
    path = write('<xacro:include filename="$(find nowhere_at_all)/x.xacro"/>')
    with pytest.raises(XacroError, match="no ROS package 'nowhere_at_all'"):
        expand_xacro(path)


def test_it_can_be_spawned_by_its_path(write):
    path = write('<xacro:property name="w" value="0.5"/>' + LINK)
    with Simulation() as simulation:
        assert simulation.spawn(str(path)).name == "made"


@cases("""
body, message:
  - [<link, ': xacro: (no element found|unclosed token|not well-formed)']
  - ['<link name="${''ha'' * 10 ** 15}"/>', ': xacro took more than 1024 MB of memory$']
  - ['<link name="${no_such_name}"/>', no_such_name]
  - [<xacro:include filename="missing.xacro"/>, missing.xacro]
  - [<link name="$(arg never_given)"/>, never_given]
  - ['<property name="w" value="1"/><link name="${w}"/>', <property> is <xacro:prop]
""")
def test_refusals_are_one_line_with_the_file(write, limits, body, message):
    path = write(body)
    with pytest.raises(XacroError, match=message) as refusal:
        read_urdf_file(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert "\n" not in str(refusal.value)


def test_the_command_names_tags_of_before_noetic(write, monkeypatch, capsys):
    path = write('<macro name="m" params="a"><link name="${a}"/></macro>')
    monkeypatch.setattr(xacro_child, "find_packages_of_ros1", lambda: None)
    monkeypatch.setattr("sys.argv", ["xacro", str(path)])
    with pytest.raises(SystemExit):
        xacro_child.command()
    said = capsys.readouterr().err.splitlines()
    assert said[0] == f"xacro: error in {path}: since ROS Noetic, <macro> is <xacro:macro>"
    assert "name 'a' is not defined" in said[1]


@cases(r"""
code, out, error, said:
  - [0, <robot/>, a warning, <robot/>]
  - [0, <robot />, '', 'x: xacro makes more than 8 bytes of it']
  - [2, '', "one\n two, much longer", 'x: two, much']
  - [1, '', '', 'x: xacro failed without a message']
  - [-9, '', killed, 'x: xacro took more than 30 s']
  - [null, '', '', 'x: xacro took longer than 60 s']
""")
def test_what_the_process_leaves(monkeypatch, code, out, error, said):
    def run(command, **_):
        if code is None:
            raise subprocess.TimeoutExpired(command, 60.0)
        return subprocess.CompletedProcess(command, code, out.encode(), error.encode())

    monkeypatch.setattr(xacro_files.subprocess, "run", run)
    monkeypatch.setattr(xacro_files, "MAXIMUM_BYTES", 8)
    monkeypatch.setattr(xacro_files, "LONGEST_MESSAGE", 11)
    try:
        told = expand_xacro(Path("x"))
    except XacroError as refusal:
        told = str(refusal)
    assert told == said


def test_without_the_package_it_says_so(write, limits, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(XacroError, match="xacro is not installed"):
        expand_xacro(write(""))


@cases("""
attempt:
  - "${__import__('os').getpid()}"
  - "${xacro.load_yaml.__globals__}"
""")
def test_expressions_have_a_fence(write, attempt):
    with pytest.raises(XacroError):
        expand_xacro(write(f'<link name="{attempt}"/>'))


def test_it_takes_no_more_time_than_it_is_given(write, monkeypatch):
    monkeypatch.setattr(xacro_files, "SECONDS", 1)
    path = write('<link name="${9 ** 9 ** 9}"/>')
    with pytest.raises(XacroError, match=r"took (more|longer) than [12] s"):
        expand_xacro(path)


def test_it_takes_no_more_memory_than_it_is_given(write, monkeypatch):
    monkeypatch.setattr(xacro_files, "MEMORY_BYTES", 256 << 20)
    # Each line doubles what the one before says, as in the laughs by the billion.
    doubling = "".join(
        f'<xacro:property name="p{n + 1}" value="${{p{n} + p{n}}}"/>' for n in range(30)
    )
    body = f'<xacro:property name="p0" value="ha"/>{doubling}<link name="${{p30}}"/>'
    with pytest.raises(XacroError, match="took more than 256 MB of memory"):
        expand_xacro(write(body))


def test_it_writes_no_file(write, tmp_path, monkeypatch):
    # As if an expression had found its way through the fence.
    (tmp_path / "xacro.py").write_text(
        "def process_file(path, **_):\n"
        "    with open(path + '.copy', 'w') as file:\n"
        "        file.write('x')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    path = write("")
    with pytest.raises(XacroError):
        expand_xacro(path)
    copy = tmp_path / (path.name + ".copy")
    assert not copy.exists() or os.path.getsize(copy) == 0
