"""Where modules of versions before 2.0 went: their names still import, with a warning.

Goes with the next version.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
import types
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import Any, Callable, Dict, Optional

# By name below bullet_lab.
MOVED: Dict[str, str] = {
    "docking.approach": "docking.state_machine",
    "docking.candidate": "docking.marker_track",
    "docking.cloud": "docking.prior",
    "docking.corner_filter": "docking.filter",
    "docking.decision": "docking.state_machine",
    "docking.drive": "docking.control",
    "docking.estimates": "docking.filter",
    "docking.floor_map": "docking.costmap",
    "docking.knowledge": "docking.belief",
    "docking.lane": "docking.control",
    "docking.marker_model": "docking.filter",
    "docking.motion": "docking.odometry",
    "docking.phases": "docking.state_machine",
    "docking.pilot": "docking.planner",
    "docking.settings": "docking.types",
    "docking.size_test": "docking.marker_track",
    "docking.undocking": "docking.task",
    "docking.viewpoints": "docking.next_best_view",
    "docking.watch": "docking.odometry",
    "experiments.dask_workers": "studies.workers",
    "experiments.detection_range": "studies.detection_range.study",
    "experiments.detection_scenes": "studies.detection_range.scenes",
    "experiments.detection_tasks": "studies.detection_range.study",
    "experiments.detection_trial": "studies.detection_range.trial",
    "experiments.dock_campaign": "studies.dock_campaign.study",
    "experiments.dock_progress": "studies.study",
    "experiments.dock_scenarios": "studies.dock_campaign.trial",
    "experiments.dock_trial": "studies.dock_campaign.trial",
    "experiments.docking": "studies.dock_campaign.docking",
    "experiments.free_camera": "studies.detection_range.scenes",
    "experiments.interruption": "studies.study",
    "experiments.noise_study": "studies.noise_study.study",
    "experiments.own_thread": "studies.workers",
    "experiments.published_noise": "studies.published_noise.study",
    "experiments.square_drive": "studies.squares",
    "experiments.squares": "studies.squares",
    "markers.dots": "markers.images",
    "markers.plates": "markers.models",
    "numerics.angles": "core.angles",
    "numerics.binomial": "studies.dock_campaign.results",
    "numerics.ellipse": "core.ellipse",
    "numerics.exact_moments": "noise.exact_moments",
    "numerics.goal_driver": "drive.goal",
    "numerics.likeness": "studies.published_noise.results",
    "numerics.metrics": "core.trajectory",
    "numerics.noisy_paths": "noise.noisy_paths",
    "numerics.odometry_noise": "noise.odometry_noise",
    "numerics.path_metrics": "studies.noise_study.statistics",
    "numerics.patterns": "core.patterns",
    "numerics.pinhole": "core.pinhole",
    "numerics.published_defects": "studies.published_noise.defects",
    "numerics.published_noise": "noise.published_noise",
    "numerics.resampling": "studies.noise_study.paths",
    "numerics.se2": "core.se2",
    "numerics.seeds": "core.seeds",
    "numerics.side_deviation": "studies.published_noise.side_deviation",
    "numerics.square_course": "drive.square",
    "numerics.square_driver": "drive.square",
    "numerics.square_path": "reports.squares",
    "numerics.study_statistics": "studies.noise_study.statistics",
    "numerics.trajectory": "core.trajectory",
    "plotting.beacons_figure": "reports.beacons",
    "plotting.campaign_figure": "studies.dock_campaign.results",
    "plotting.detection_figures": "studies.detection_range.figures",
    "plotting.docking_figure": "reports.dock",
    "plotting.fleet_figure": "reports.fleet",
    "plotting.floor_plan": "core.figures",
    "plotting.goal_figure": "reports.goal",
    "plotting.noise_figure": "reports.squares",
    "plotting.published_figures": "studies.published_noise.figures",
    "plotting.sensors_figure": "reports.sensors",
    "plotting.study_figures": "studies.noise_study.figures",
    "plotting.style": "core.figures",
    "plotting.vision_figure": "reports.vision",
    "recording.detection_summary": "studies.detection_range.study",
    "recording.distances": "reports.beacons",
    "recording.dock_log": "studies.dock_campaign.results",
    "recording.dock_summary": "studies.dock_campaign.results",
    "recording.docking_run": "reports.dock",
    "recording.files": "core.files",
    "recording.fleet_summary": "reports.fleet",
    "recording.goal_summary": "reports.goal",
    "recording.paths": "reports.squares",
    "recording.published_figure": "studies.published_noise.side_deviation",
    "recording.published_summary": "studies.published_noise.results",
    "recording.sensors": "reports.sensors",
    "recording.series": "core.series",
    "recording.squares_summary": "reports.squares",
    "recording.study_files": "studies.noise_study.paths",
    "ros.aruco": "ros.nodes.aruco",
    "ros.camera_geometry": "ros.messages.images",
    "ros.canny_edges": "ros.nodes.canny_edges",
    "ros.connections": "ros.node.lock_step",
    "ros.conversions": "ros.messages.conversions",
    "ros.demand": "ros.node.publishers",
    "ros.depopulate": "ros.nodes.depopulate",
    "ros.diagnostics": "ros.node.diagnostics",
    "ros.dock": "ros.nodes.dock",
    "ros.dock_errands": "ros.nodes.dock",
    "ros.dock_goals": "ros.nodes.dock_messages",
    "ros.dock_inputs": "ros.nodes.dock_messages",
    "ros.dock_parameters": "ros.nodes.dock",
    "ros.dock_sender": "ros.node.commands",
    "ros.dock_topics": "ros.nodes.dock",
    "ros.drive_squares": "ros.nodes.drive_squares",
    "ros.drive_to_goal": "ros.nodes.drive_to_goal",
    "ros.errand_recorder": "ros.record.recorder",
    "ros.exported_paths": "ros.nodes.gzserver",
    "ros.fleet": "ros.nodes.fleet",
    "ros.fleet_markers": "ros.record.rviz",
    "ros.fleet_names": "ros.nodes.fleet",
    "ros.frame_finder": "ros.node.transforms",
    "ros.free_rate": "ros.node.lock_step",
    "ros.gazebo_client": "ros.gazebo.client",
    "ros.gazebo_forces": "ros.gazebo.forces",
    "ros.gazebo_messages": "ros.messages.poses",
    "ros.gazebo_models": "ros.gazebo.models",
    "ros.gazebo_physics": "ros.gazebo.interface",
    "ros.gazebo_server": "ros.nodes.gzserver",
    "ros.gazebo_server_arguments": "ros.nodes.gzserver",
    "ros.gazebo_services": "ros.gazebo.services",
    "ros.gazebo_states": "ros.gazebo.states",
    "ros.gazebo_topics": "ros.gazebo.states",
    "ros.gazebo_types": "ros.messages.gazebo_types",
    "ros.gazebo_window": "ros.nodes.gzclient",
    "ros.goal_parameters": "ros.nodes.drive_to_goal",
    "ros.goal_topics": "ros.nodes.drive_to_goal",
    "ros.good_features": "ros.nodes.good_features",
    "ros.harris_corners": "ros.nodes.harris_corners",
    "ros.image_conversions": "ros.messages.conversions",
    "ros.image_messages": "ros.messages.images",
    "ros.image_node": "ros.nodes.image_node",
    "ros.launcher.signals": "ros.launcher.command",
    "ros.launcher.verdict": "ros.launcher.supervision",
    "ros.lock_step": "ros.node.lock_step",
    "ros.loop_watch": "ros.bridge.speed",
    "ros.marker_messages": "ros.messages.markers",
    "ros.newest_odometry": "ros.node.odometry",
    "ros.noisy_odom": "ros.nodes.noisy_odom",
    "ros.odometry": "ros.node.odometry",
    "ros.odometry_frames": "ros.bridge.world_topics",
    "ros.odometry_recorder": "reports.squares",
    "ros.pace": "ros.bridge.speed",
    "ros.parameters": "core.parameters",
    "ros.place_beacon": "ros.nodes.place_beacon",
    "ros.plot_beacons": "ros.record.plot_beacons",
    "ros.plot_docking": "ros.record.plot_docking",
    "ros.plot_fleet": "ros.record.plot_fleet",
    "ros.plot_goal": "ros.record.plot_goal",
    "ros.plot_noise": "ros.record.plot_noise",
    "ros.plot_sensors": "ros.record.plot_sensors",
    "ros.plot_vision": "ros.record.plot_vision",
    "ros.populate": "ros.nodes.populate",
    "ros.publishers": "ros.node.publishers",
    "ros.recorder": "ros.record.recorder",
    "ros.save_world": "ros.nodes.save_world",
    "ros.sensor_conversions": "ros.messages.conversions",
    "ros.show_sensors": "ros.nodes.show_sensors",
    "ros.simulators": "ros.bridge.simulators",
    "ros.spawn_arguments": "ros.nodes.spawn_model",
    "ros.spawn_model": "ros.nodes.spawn_model",
    "ros.stamps": "ros.messages.poses",
    "ros.standing_models": "ros.gazebo.client",
    "ros.stepper": "ros.bridge.stepper",
    "ros.tf_prefix": "ros.node.transforms",
    "ros.time_gate": "ros.bridge.lock_step",
    "ros.touches": "ros.bridge.world_topics",
    "ros.track_robot": "ros.nodes.track_robot",
    "ros.view_camera": "ros.nodes.view_camera",
    "ros.wiring": "ros.bridge.device_topics",
    "ros.world_feed": "ros.bridge.world_topics",
    "ros.world_markers": "ros.messages.world",
    "ros.world_saver": "ros.gazebo.interface",
    "simulation.attached_frame": "simulation.physics.attached_frame",
    "simulation.bodies": "simulation.physics.bodies",
    "simulation.contact_points": "simulation.physics.contacts",
    "simulation.contacts": "simulation.physics.contacts",
    "simulation.dead_reckoning": "simulation.plugins.wheel_drives",
    "simulation.description": "simulation.world.description",
    "simulation.devices.bumper": "simulation.plugins.bumper",
    "simulation.devices.camera": "simulation.plugins.camera",
    "simulation.devices.depth_camera": "simulation.plugins.camera",
    "simulation.devices.device": "simulation.plugins.plugin",
    "simulation.devices.diff_drive": "simulation.plugins.wheel_drives",
    "simulation.devices.imu": "simulation.plugins.imu",
    "simulation.devices.joint_states": "simulation.plugins.joint_states",
    "simulation.devices.laser": "simulation.plugins.ray_sensors",
    "simulation.devices.noise": "simulation.plugins.plugin",
    "simulation.devices.p3d": "simulation.plugins.p3d",
    "simulation.devices.planar_move": "simulation.plugins.planar_move",
    "simulation.devices.range_sensor": "simulation.plugins.ray_sensors",
    "simulation.devices.ray_scan": "simulation.plugins.ray_sensors",
    "simulation.devices.sensor_tag": "simulation.plugins.plugin",
    "simulation.devices.skid_steer": "simulation.plugins.wheel_drives",
    "simulation.devices.wheels": "simulation.plugins.wheel_drives",
    "simulation.engine": "simulation.physics.engine",
    "simulation.entities": "simulation.models",
    "simulation.floor_plan": "simulation.world.floor_plan",
    "simulation.gazebo_materials": "simulation.world.gazebo_tags",
    "simulation.gazebo_tags": "simulation.world.gazebo_tags",
    "simulation.inertia": "simulation.world.inertia",
    "simulation.joint_dynamics": "simulation.physics.bodies",
    "simulation.link_contacts": "simulation.physics.physics",
    "simulation.lumping": "simulation.world.tree",
    "simulation.meshes": "simulation.world.meshes",
    "simulation.model_instance": "simulation.models",
    "simulation.model_reader": "simulation.world.sdf",
    "simulation.model_writer": "simulation.world.sdf_writer",
    "simulation.native_output": "core.native_output",
    "simulation.plugin_tags": "simulation.world.gazebo_tags",
    "simulation.pose": "core.pose",
    "simulation.proportions": "simulation.world.inertia",
    "simulation.rendering.choice": "simulation.rendering.graphics",
    "simulation.rendering.textures": "simulation.rendering.surfaces",
    "simulation.resources": "simulation.world.resources",
    "simulation.samples": "simulation.plugins.samples",
    "simulation.schedule": "core.schedule",
    "simulation.sdf_elements": "simulation.world.sdf_writer",
    "simulation.sdf_reader": "simulation.world.sdf",
    "simulation.sdf_state": "simulation.world.sdf",
    "simulation.sdf_unknown": "simulation.world.gazebo_tags",
    "simulation.support_patch": "simulation.plugins.planar_move",
    "simulation.touched_shapes": "simulation.physics.contacts",
    "simulation.tree": "simulation.world.tree",
    "simulation.urdf_reader": "simulation.world.urdf",
    "simulation.wheel": "simulation.plugins.wheel_drives",
    "simulation.world_writer": "simulation.world.sdf_writer",
    "simulation.xacro_child": "simulation.world.xacro_child",
    "simulation.xacro_files": "simulation.world.xacro",
    "simulation.xacro_packages": "simulation.world.xacro_child",
    "simulation.xml_input": "simulation.world.xml",
    "vision.edge_fit": "vision.quads",
    "vision.errors": "vision.images",
    "vision.explanation": "vision.marker_detector",
    "vision.nested": "vision.quads",
    "vision.pose_memory": "vision.marker_observer",
    "vision.sampling": "vision.images",
    "vision.small_algebra": "vision.algebra",
}
# Folders that are gone, and where to look for names that one itself gave.
PACKAGES = {
    "experiments": "",
    "numerics": "",
    "plotting": "",
    "recording": "",
    "simulation.devices": "simulation.plugins",
}
_ROOT = "bullet_lab."


class _Alias(Loader):
    """Gives the new module under its old name."""

    def __init__(self, name: str):
        self._name = name
        self._spec: Optional[ModuleSpec] = None

    def create_module(self, spec: ModuleSpec) -> types.ModuleType:
        warnings.warn(f"{spec.name} is now {self._name}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: types.ModuleType) -> None:
        # The import system has written the old name over it.
        module.__spec__ = self._spec

    def get_code(self, fullname: str) -> Any:
        """Return the new module's code, or its folder's, for `python -m` with the old name."""
        name = re.sub(r"\.study$", ".__main__", self._name)
        loader: Any = importlib.util.find_spec(name).loader
        return loader.get_code(name)


class _Folder(Loader):
    """An empty package: a folder that held modules once."""

    def create_module(self, spec: ModuleSpec) -> None:
        return None

    def exec_module(self, module: types.ModuleType) -> None:
        home = PACKAGES[module.__name__[len(_ROOT) :]]
        if home:
            vars(module)["__getattr__"] = names_of(module.__name__, _ROOT + home)


class _Finder(MetaPathFinder):
    """Finds modules by their old names, after all others have failed to."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Optional[ModuleSpec]:
        if not fullname.startswith(_ROOT):
            return None
        name = fullname[len(_ROOT) :]
        if name in MOVED:
            return ModuleSpec(fullname, _Alias(_ROOT + MOVED[name]), origin=fullname)
        if name in PACKAGES:
            return ModuleSpec(fullname, _Folder(), is_package=True)
        return None


def install() -> None:
    """Have the old names found; once a process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.append(_Finder())


def names_of(package: str, module: str) -> Callable[[str], Any]:
    """Return a `__getattr__` for a package that bears the name of what was one module.

    Args:
        package: the package's name.
        module: where what the module held is now.
    """

    def attribute(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            found = getattr(importlib.import_module(module), name)
        except AttributeError:
            raise AttributeError(f"module {package!r} has no attribute {name!r}") from None
        warnings.warn(f"{package}.{name} is now in {module}", DeprecationWarning, stacklevel=2)
        return found

    return attribute
