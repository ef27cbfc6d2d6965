"""A client checks the md5 sums of definitions: those of Gazebo, ros_control and Kobuki."""

import functools
import re
import runpy
import shutil

import genmsg
import pytest
import rospkg
import yaml
from genmsg.gentools import compute_md5
from genmsg.msg_loader import load_depends, load_msg_from_file, load_srv_from_file

# By package.
SUMS = yaml.safe_load(
    """
gazebo_msgs:
  SpawnModel: 9ed9c82c96abe1a00c3e8cdaeee24413
  DeleteModel: 9ce56b4e9e54616de25d796dc972a262
  GetModelState: 4c515e936d3319c9610c559c60bfc3d4
  SetModelState: 5b3ab0281d4f5445def017e3a2e4a07b
  GetWorldProperties: 36bb0f2eccf4d8be971410c22818ba3f
  GetModelProperties: 5717f7bd34ed990fa80e28b3015027a3
  GetPhysicsProperties: 575a5e74786981b7df2e3afc567693a6
  SetPhysicsProperties: 97e2057080558ce4730434b5fae75c91
  ApplyBodyWrench: 585b9f9618aa0581b207e2f2d90866bc
  ModelState: 9330fd35f2fcd82d457e54bd54e10593
  ModelStates: 48c080191eb15c41858319b4d8a609c2
  ODEPhysics: 667d56ddbd547918c32d1934503dc335
  # Of gazebo_msgs as well, though not in the lab's table.
  ApplyJointEffort: c0039811b8cc919490b3cff748cdf46b
  BodyRequest: 5eade9afe7f232d78005bd0cafeab755
  ContactState: 48c0ffb054b8c444f870cecea1ee50d9
  ContactsState: acbcb1601a8e525bf72509f18e6f668d
  GetJointProperties: 7b30be900f50aa21efec4a0ec92d91c9
  GetLinkProperties: 0e06a70386d0ee3fb880c02f23fcd821
  GetLinkState: 09d6c98cce97b35f7ab9bd70300657ab
  JointRequest: 0be1351618e1dc030eb7959d9a4902de
  LinkState: 0818ebbf28ce3a08d48ab1eaa7309ebe
  LinkStates: 48c080191eb15c41858319b4d8a609c2
  SetLinkState: 8a5146eb66ae4d26b0860b08f3f271be
  SetModelConfiguration: 10e3139d3b669c40afc057d38956fff7
  DeleteLight: ae11ea8100d536d5b92c2b5917abf912
  GetLightProperties: df2cef87e13e2e6990e81e8aaa454c19
  ODEJointProperties: 1b744c32a920af979f53afe2f9c3511f
  PerformanceMetrics: 884f71fd5037b886ec5e126b83c4425a
  SensorPerformanceMetric: 01762ded18cfe9ebc7c8222667c99547
  SetJointProperties: 15a76e921b1410c698d82782ea5fa370
  SetLightProperties: e6f13430c57278bb364aca53a1bf5ebf
  SetLinkProperties: d534ce1b36ee99de0ffa806c3a6348f0
  WorldState: de1a9de3ab7ba97ac0e9ec01a4eb481e
  # The bridge offers no such service, as Gazebo's node does not.
  SetJointTrajectory: 88f5c10979e3f9649d5ae87a3b12aa65
# For Noetic; those below the first are of version 1.5.
control_msgs:
  JointControllerState: 987ad85e4756f3aef7f1e5e7fe0595d1
  GripperCommand: 680acaff79486f017132a7f198d40f08
  JointJog: 1685da700c8c2e1254afc92a5fb89c96
  JointTolerance: f544fe9c16cf04547e135dd6063ff5be
  JointTrajectoryControllerState: 10817c60c2486ef6b33e97dcd87f4474
  PidState: b138ec00e886c10e73f27e8712252ea6
  QueryCalibrationState: 28af3beedcb84986b8e470dc5470507d
  QueryTrajectoryState: ec93cdecbd8062d761aa52b7c90cd44b
controller_manager_msgs:
  ControllerState: aeb6b261d97793ab74099a3740245272
  HardwareInterfaceResources: f25b55cbf1d1f76e82e5ec9e83f76258
  ListControllerTypes: c1d4cd11aefa9f97ba4aeb5b33987f4e
  ListControllers: 1341feb2e63fa791f855565d0da950d8
  LoadController: 647e5c54b8d6468952d8d31f1efe96c0
  ReloadControllerLibraries: 40e8c411fd1797d2e2c486018f846040
  SwitchController: b29a7abc673b2c54c14b54e50f8d06a5
  UnloadController: 647e5c54b8d6468952d8d31f1efe96c0
ackermann_msgs:
  AckermannDrive: 3512e91b48d69674a0e86fadf1ea8231
  AckermannDriveStamped: 1fd5d7f58889cefd44d29f6653240d0c
# For Noetic.
kobuki_msgs:
  BumperEvent: ffe360cd50f14f9251d9844083e72ac5
  ButtonEvent: 49eca512765dbdec759a79083ffcec8d
  CliffEvent: c5b106efbb1427a94f517c5e05f06295
  ControllerInfo: 46af38e72f0640f41ed22174d43a2550
  DigitalInputEvent: 93da823c8b121f8a3940ef3830c58e44
  DigitalOutput: 1e97cd7f196a0270516b506e8bf29ca2
  DockInfraRed: a3d77f7d15e50579473dcc24e9b97b34
  ExternalPower: 95149d524971a4c6d19e64c827307194
  KeyboardInput: 9288b95cb32b48719d84d696be253401
  Led: 4391183b0cf05f8f25d04220401b9f43
  MotorPower: 8f77c0161e0f2021493136bb5f3f0e51
  PowerSystemEvent: f6464657d6c911b00c7bc7b43a154bf8
  RobotStateEvent: c6eccd4cb1f95df95635b56d6226ea32
  ScanAngle: 06e2c839dc5c7f5c13ac09a8b4ff0a6a
  SensorState: 430a4bfd78449c8740bfef32b26613a6
  Sound: dfeab0daae67749c426c1db741a4f420
  VersionInfo: 3dc0ce6edd49be1fc86730f4a4a21861
  WheelDropEvent: e102837d89384d67669a0df86b63f33b
"""
)
ACTION_SUMS = yaml.safe_load(
    """
    FollowJointTrajectory: bc4f9b743838566551c0390c65f1a248
    GripperCommand: 950b2a6ebe831f5d4f4ceaba3d8be01e
    JointTrajectory: a04ba3ee8f6a2d0985a6aeaf23d9d7ad
    PointHead: 7252920f1243de1b741f14f214125371
    SingleJointPosition: c4a786b7d53e5d0983decf967a5a779e
    """
)


@functools.lru_cache(maxsize=None)
def loaded(folder, package):
    """Return where types are loaded to, and where those of other packages are."""
    pack = rospkg.RosPack()
    names = ("actionlib_msgs", "geometry_msgs", "std_msgs", "trajectory_msgs")
    folders = {name: [f"{pack.get_path(name)}/msg"] for name in names}
    return genmsg.MsgContext.create_default(), {**folders, package: [str(folder / "msg")]}


def md5_of(folder, name, package):
    (path,) = folder.glob(f"[ms][sr][gv]/{name}.[ms][sr][gv]")
    context, folders = loaded(folder, package)
    load = load_msg_from_file if path.suffix == ".msg" else load_srv_from_file
    spec = load(context, str(path), f"{package}/{path.stem}")
    load_depends(context, spec, folders)
    return compute_md5(context, spec)


@pytest.mark.parametrize("stand_in", SUMS)
def test_a_stand_in_has_all_types_and_the_package_those_that_it_links_to(package, stand_in):
    folder, built = package / "stand_ins" / stand_in, (package / "CMakeLists.txt").read_text()
    listed = set(re.findall(r"\w+\.(?:msg|srv)", (folder / "CMakeLists.txt").read_text()))
    files = list(folder.glob("[ms][sr][gv]/*"))
    assert listed == {path.name for path in files}
    assert {path.stem for path in files} == set(SUMS[stand_in])
    for path in files:
        assert (path.name in built) == path.is_symlink(), path
        for folder_of_type in (folder, package) if path.is_symlink() else (folder,):
            # The type's own package name is part of no sum, but is what clients import.
            assert md5_of(folder_of_type, path.stem, stand_in) == SUMS[stand_in][path.stem], path


def test_the_types_of_actions(package, tmp_path):
    folder = package / "stand_ins/control_msgs"
    # As the set-up makes the messages of actions.
    generator = runpy.run_path(str(package / "scripts/setup/workspace.py"))
    shutil.copytree(folder / "msg", tmp_path / "msg")
    for action in folder.glob("action/*"):
        generator["action_messages"](action, tmp_path / "msg")
    sums = {name: md5_of(tmp_path, f"{name}Action", "control_msgs") for name in ACTION_SUMS}
    assert sums == ACTION_SUMS
    built = (folder / "CMakeLists.txt").read_text()
    assert set(re.findall(r"(\w+)\.action", built)) == set(ACTION_SUMS)
