"""Where modules of versions before 2.0 went: their names still import, with a warning.

Goes with the next version.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
import warnings
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import Any, Callable, Dict, Optional

# Old and new folder, and the modules that went from one to the other: as `old=new` if renamed.
_TABLE = """
docking > docking: approach=state_machine candidate=marker_track cloud=belief corner_filter=filter
    decision=state_machine drive=control estimates=filter floor_map=costmap knowledge=belief
    lane=control marker_model=filter motion=odometry phases=state_machine pilot=planner
    settings=types size_test=marker_track undocking=task viewpoints=next_best_view watch=odometry
experiments > studies: dask_workers=workers dock_progress=study interruption=study
    own_thread=workers square_drive=squares squares
experiments > studies.detection_range: detection_range=study detection_scenes=scenes
    detection_tasks=study detection_trial=trial free_camera=scenes
experiments > studies.dock_campaign: dock_campaign=study dock_scenarios=trial dock_trial=trial
    docking
experiments > studies.noise_study: noise_study=study
experiments > studies.published_noise: published_noise=study
markers > markers: dots=faces images=faces plates=models
numerics > core: angles=se2 ellipse=se2 metrics=trajectory patterns=se2 pinhole se2 trajectory
numerics > drive: goal_driver=goal square_course=square square_driver=square
numerics > noise: exact_moments noisy_paths odometry_noise published_noise seeds=odometry_noise
numerics > reports: square_path=squares
numerics > studies.dock_campaign: binomial=results
numerics > studies.noise_study: path_metrics=statistics resampling=paths
    study_statistics=statistics
numerics > studies.published_noise: likeness=results published_defects=defects
    side_deviation=drawn_paths
plotting > core: floor_plan=figures style=figures
plotting > reports: beacons_figure=sensors docking_figure=dock fleet_figure=fleet goal_figure=goal
    noise_figure=squares sensors_figure=sensors vision_figure=vision
plotting > studies.detection_range: detection_figures=figures
plotting > studies.dock_campaign: campaign_figure=results
plotting > studies.noise_study: study_figures=figures
plotting > studies.published_noise: published_figures=figures
recording > core: files series=files
recording > reports: distances=sensors docking_run=dock fleet_summary=fleet goal_summary=goal
    paths=squares sensors squares_summary=squares
recording > studies.detection_range: detection_summary=study
recording > studies.dock_campaign: dock_log=results dock_summary=results
recording > studies.noise_study: study_files=paths
recording > studies.published_noise: published_figure=drawn_paths published_summary=results
ros > core: parameters
ros > reports: odometry_recorder=squares
ros > ros.bridge: loop_watch=timing odometry_frames=world_topics pace=timing
    simulators=running_world stepper time_gate=timing touches=world_topics wiring=running_world
    world_feed=world_topics
ros > ros.gazebo: gazebo_client=client gazebo_forces=services gazebo_models=services
    gazebo_physics=interface gazebo_services=services gazebo_states=services
    gazebo_topics=interface standing_models=client world_saver=interface
ros > ros.messages: camera_geometry=images conversions gazebo_messages=poses gazebo_types
    image_conversions=conversions image_messages=images marker_messages=images
    sensor_conversions=conversions stamps=poses world_markers=world
ros > ros.node: connections=lock_step demand=publishers diagnostics dock_sender=driving
    frame_finder=transforms free_rate=lock_step lock_step newest_odometry=odometry odometry
    publishers tf_prefix=transforms
ros > ros.nodes: aruco canny_edges depopulate=populate dock dock_errands=dock
    dock_goals=dock_messages dock_inputs=dock_messages dock_parameters=dock dock_topics=dock
    drive_squares drive_to_goal exported_paths=gzserver fleet=drive_squares
    fleet_names=drive_squares gazebo_server=gzserver gazebo_server_arguments=gzserver
    goal_parameters=drive_to_goal goal_topics=drive_to_goal good_features
    harris_corners image_node noisy_odom place_beacon populate save_world show_sensors
    spawn_arguments=spawn_model spawn_model track_robot view_camera
ros > ros.record: errand_recorder=recorder fleet_markers=rviz plot_beacons=plots
    plot_docking=plots plot_fleet=plots plot_goal=plots plot_noise=plots plot_sensors=plots
    plot_vision recorder
ros.launcher > ros.launcher: screen=output signals=command verdict=supervision
simulation > core: native_output pose schedule
simulation > simulation: entities=models model_instance=models view=simulation
simulation > simulation.physics: attached_frame bodies contact_points=contacts contacts engine
    joint_dynamics=bodies link_contacts=physics touched_shapes=contacts
simulation > simulation.plugins: dead_reckoning=wheel_drives samples support_patch=planar_move
    wheel=wheel_drives
simulation > simulation.world: description floor_plan gazebo_materials=gazebo_tags gazebo_tags
    inertia lumping=tree meshes model_reader=sdf model_writer=sdf_writer plugin_tags=gazebo_tags
    proportions=inertia resources sdf_elements=sdf_writer sdf_reader=sdf sdf_state=sdf
    sdf_unknown=gazebo_tags tree urdf_reader=urdf world_writer=sdf_writer xacro_child
    xacro_files=xacro xacro_packages=xacro_child xml_input=xml
simulation.devices > simulation.plugins: bumper camera depth_camera=camera device=plugin
    diff_drive=wheel_drives imu joint_states=true_states laser=ray_sensors noise=plugin
    p3d=true_states planar_move range_sensor=ray_sensors ray_scan=ray_sensors sensor_tag=plugin
    skid_steer=wheel_drives wheels=wheel_drives
simulation.rendering > simulation.rendering: choice=graphics
studies.detection_range > studies.detection_range: __main__=study
studies.dock_campaign > studies.dock_campaign: __main__=study
studies.noise_study > studies.noise_study: __main__=study
studies.published_noise > studies.published_noise: __main__=study
vision > vision: decoding=dictionaries edge_fit=quads errors=images explanation=marker_detector
    marker_observer=marker_pose nested=quads pose_memory=marker_pose sampling=images
    small_algebra=algebra
"""
# Folders that are gone, and where to look for names that one itself gave.
PACKAGES = {
    "experiments": "",
    "numerics": "",
    "plotting": "",
    "recording": "",
    "simulation.devices": "simulation.plugins",
}
_ROOT = "bullet_lab."


def _read(table: str) -> Dict[str, str]:
    found: Dict[str, str] = {}
    for line in table.strip().splitlines():
        folders, colon, words = line.rpartition(":")
        if colon:
            old_folder, new_folder = folders.split(" > ")
        for word in words.split():
            old, _, new = word.partition("=")
            found[f"{old_folder}.{old}"] = f"{new_folder}.{new or old}"
    return found


MOVED = _read(_TABLE)
"""New names by the old ones, below bullet_lab."""


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
        """Return the new module's code, for `python -m` with the old name."""
        if fullname.endswith(".__main__"):
            # What is defined in one would not be found by processes that it starts.
            return compile(f"from {self._name} import main\nmain()", fullname, "exec")
        loader: Any = importlib.util.find_spec(self._name).loader
        return loader.get_code(self._name)


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
        name = fullname[len(_ROOT) :] if fullname.startswith(_ROOT) else ""
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
