"""All that the bridge offers under /gazebo, with what is about the whole world.

The latter are /bullet_lab/save_world, the running world as an SDF file, and the topics
/gazebo/model_states, link_states and performance_metrics.
"""

from __future__ import annotations

import contextlib
import threading
import time
from pathlib import Path
from typing import Any, Callable, Dict

import rospy

from bullet_lab.core.files import ConfinedFolder, FileError
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.stepper import StepperError
from bullet_lab.ros.bridge.world_topics import WorldMarkers
from bullet_lab.ros.gazebo.cameras import SensorServices
from bullet_lab.ros.gazebo.lights import GazeboLights
from bullet_lab.ros.gazebo.performance import Performance
from bullet_lab.ros.gazebo.physics import GazeboPhysics
from bullet_lab.ros.gazebo.properties import GazeboProperties
from bullet_lab.ros.gazebo.services import GazeboServices
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import pose_message, time_of, twist_message
from bullet_lab.simulation.models import Entity, ModelInstance, link_entities, model_entity
from bullet_lab.simulation.world.sdf_writer import world_text
from bullet_lab.srv import SaveWorld, SaveWorldResponse


class SaveError(LabError):
    """A world cannot be saved there."""


class WorldSaver:
    """Offers the service; only the look at where everything is holds the simulation up.

    The bridge writes below one folder only. Whoever wants a file elsewhere takes the text and
    writes it with rights of their own, as `save_world.py` does.
    """

    def __init__(self, world: RunningWorld, folder: Path):
        self._world = world
        self._folder = ConfinedFolder(folder)
        self._lock = threading.Lock()
        self._service = rospy.Service("/bullet_lab/save_world", SaveWorld, self._save)

    def _save(self, request: Any) -> SaveWorldResponse:
        start = time.perf_counter()
        try:
            if not request.path or "\0" in request.path:
                raise SaveError("no file is named")
            if request.return_text:
                response = self._describe(self._folder.path / request.path)
            else:
                # One at a time, or the later file could be put in place before the earlier one.
                with self._lock:
                    response = self._write(request.path)
        except (LabError, OSError, RuntimeError) as error:
            # Of the latter, names that are too long and links in circles.
            return SaveWorldResponse(success=False, status_message=str(LabError(error)))
        response.seconds = time.perf_counter() - start
        return response

    def _write(self, name: str) -> SaveWorldResponse:
        try:
            path = self._folder.place(name)
        except FileError as error:
            hint = "~save_folder is the bridge's; save_world.py writes anywhere"
            raise SaveError(f"{error}; {hint}") from error
        response = self._describe(path)
        text, response.text = response.text, ""
        self._folder.write(path, text)
        return response

    def _describe(self, path: Path) -> SaveWorldResponse:
        snapshot = self._world.do(self._world.simulation.snapshot)
        text, notes = world_text(snapshot, path.parent)
        return SaveWorldResponse(
            success=True,
            status_message="; ".join(notes),
            path=str(path),
            text=text,
            models=len(snapshot.models),
            saved_at=time_of(snapshot.step),
        )


class _States(rospy.SubscribeListener):
    """A topic that says where things are.

    Its messages are made while somebody listens, `rate` times per simulated second. In between,
    whoever subscribes is told at once how things are, and everybody when something was added,
    taken away or put elsewhere: so it is of use while time stands still, too.
    """

    def __init__(
        self,
        world: RunningWorld,
        topic: str,
        kind: type,
        entities: Callable[[ModelInstance], Dict[str, Entity]],
        rate: float,
    ):
        super().__init__()
        self._world = world
        self._kind = kind
        self._entities = entities
        self._publisher = world.topics.publisher(topic, kind)
        self._publisher.impl.add_subscriber_listener(self)
        world.changed.append(self._changed)
        world.simulation.every(rate, self._publish)

    def peer_subscribe(
        self, _topic: str, _publish: Callable[[Any], None], peer_publish: Callable[[Any], None]
    ) -> None:
        """Tell a new subscriber how things are."""
        # What a bridge that ends can no longer tell, nobody needs. In the thread of the others
        # that write to this subscriber, or messages would mix.
        with contextlib.suppress(StepperError, rospy.ROSException):
            self._world.do(lambda: peer_publish(self._message()))

    def _publish(self, _step: int = 0) -> None:
        if self._publisher.has_connections():
            self._publisher.publish(self._message())

    def _changed(self, _name: str) -> None:
        self._publish()
        self._publisher.flush()

    def _message(self) -> Any:
        message = self._kind()
        for instance in self._world.models.values():
            for name, entity in self._entities(instance).items():
                state = entity.state()
                message.name.append(name)
                message.pose.append(pose_message(state.pose))
                message.twist.append(twist_message(state))
        return message


def _model(instance: ModelInstance) -> Dict[str, Entity]:
    return {instance.name: model_entity(instance)}


def _links(instance: ModelInstance) -> Dict[str, Entity]:
    return {f"{instance.name}::{link.link}": link for link in link_entities(instance)}


class Gazebo:
    """Gazebo's services and topics on a running world, and its markers in a frame of RViz.

    RViz shows the model `hidden` as a robot. `states_rate` is that of /gazebo/model_states and
    link_states, in messages per simulated second. Worlds are saved in `folder`.
    """

    def __init__(
        self, world: RunningWorld, frame: str, hidden: str, states_rate: float, folder: Path
    ):
        self._world = world
        self._parts = [
            WorldMarkers(world, frame, hidden),
            _States(world, "/gazebo/model_states", msg.ModelStates, _model, states_rate),
            _States(world, "/gazebo/link_states", msg.LinkStates, _links, states_rate),
            Performance(world),
            GazeboServices(world),
            GazeboProperties(world),
            GazeboLights(world),
            GazeboPhysics(world),
            WorldSaver(world, folder),
            SensorServices(world),
        ]

    def everything_moved(self) -> None:
        """Show that models were put elsewhere, by somebody else."""
        self._world.change(lambda: "")
