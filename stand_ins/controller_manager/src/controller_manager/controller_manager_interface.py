"""The functions that scripts call to load, start, stop and unload controllers.

Each prints what came of it, and those that change something return whether it succeeded.
"""

from __future__ import annotations

from typing import Any, Sequence

import rospy
from controller_manager_msgs.srv import (
    ListControllers,
    ListControllerTypes,
    LoadController,
    ReloadControllerLibraries,
    SwitchController,
    SwitchControllerRequest,
    UnloadController,
)


def list_controller_types() -> None:
    """Print the kinds of controllers that there are."""
    for kind in _call("list_controller_types", ListControllerTypes).types:
        print(kind)


def list_controllers() -> None:
    """Print the controllers that are loaded, their hardware interfaces and states."""
    controllers = _call("list_controllers", ListControllers).controller
    if not controllers:
        print("No controllers are loaded")
    for controller in controllers:
        claimed = sorted({one.hardware_interface for one in controller.claimed_resources})
        print(f"'{controller.name}' - '{'+'.join(claimed)}' ( {controller.state} )")


def reload_libraries(force_kill: bool, restore: bool = False) -> bool:
    """Unload all controllers; with `restore`, load and start them again."""
    before = _call("list_controllers", ListControllers).controller if restore else ()
    done = _call("reload_controller_libraries", ReloadControllerLibraries, force_kill).ok
    print("Libraries reloaded" if done else "Libraries not reloaded: are controllers loaded?")
    for controller in before:
        load_controller(controller.name)
    running = [controller.name for controller in before if controller.state == "running"]
    if running:
        start_controllers(running)
    return done


def load_controller(name: str) -> bool:
    """Load a controller by the parameters in its namespace."""
    return _told(_call("load_controller", LoadController, name).ok, "Loaded", [name])


def unload_controller(name: str) -> bool:
    """Unload a controller that does not run."""
    return _told(_call("unload_controller", UnloadController, name).ok, "Unloaded", [name])


def start_controller(name: str) -> bool:
    """Start a controller."""
    return start_controllers([name])


def start_controllers(names: Sequence[str]) -> bool:
    """Start controllers, all or none."""
    return start_stop_controllers(start_controllers=names)


def stop_controller(name: str) -> bool:
    """Stop a controller."""
    return stop_controllers([name])


def stop_controllers(names: Sequence[str]) -> bool:
    """Stop controllers, all or none."""
    return start_stop_controllers(stop_controllers=names)


def start_stop_controllers(
    start_controllers: Sequence[str] = (), stop_controllers: Sequence[str] = ()
) -> bool:
    """Stop some controllers and start others, all or none."""
    strict = SwitchControllerRequest.STRICT
    wanted = (start_controllers, stop_controllers, strict, False, 0.0)
    done = _call("switch_controller", SwitchController, *wanted).ok
    for names, what in ((start_controllers, "Started"), (stop_controllers, "Stopped")):
        if names:
            _told(done, what, names)
    return done


def _told(done: bool, what: str, names: Sequence[str]) -> bool:
    listed = ", ".join(f"'{name}'" for name in names)
    print(f"{what} {listed}" if done else f"Error: not {what.lower()}: {listed}")
    return done


def _call(name: str, kind: Any, *wanted: Any) -> Any:
    service = f"controller_manager/{name}"
    rospy.wait_for_service(service)
    return rospy.ServiceProxy(service, kind)(*wanted)
