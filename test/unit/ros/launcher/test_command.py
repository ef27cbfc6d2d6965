"""The launcher as a process, and the packages of files among its arguments."""

import os

from shared import cases, python

from bullet_lab.ros.launcher.command import STATUS_FAILED, make_package_known

ENDING = """
import os, signal
from bullet_lab.ros.launcher import command

class Last:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

command._dispatch = lambda server, words: command.STATUS_FAILED
last = Last()
command.main(None)
"""


def test_ctrl_c_while_python_ends_changes_no_status():
    assert python(ENDING)[0] == STATUS_FAILED


@cases("""
known:
  - ""
  - /somewhere
""")
def test_the_folder_of_an_unknown_package_is_added_to_the_path(known, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", known)
    (tmp_path / "checkout/launch").mkdir(parents=True)
    (tmp_path / "checkout/package.xml").write_text("<package><name>nobodys</name></package>")
    make_package_known(tmp_path / "checkout/launch/a.launch")
    listed = os.environ["ROS_PACKAGE_PATH"].split(os.pathsep)
    assert listed == [*filter(None, [known]), str(tmp_path)]


def test_a_package_is_known_by_its_name_not_by_its_folder(tmp_path, monkeypatch):
    # Otherwise rospack would search all folders beside it, in a home or in /tmp.
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    (tmp_path / "package.xml").write_text("<package><name>bullet_lab</name></package>")
    make_package_known(tmp_path / "launch/squares.launch")
    assert os.environ["ROS_PACKAGE_PATH"] == ""
