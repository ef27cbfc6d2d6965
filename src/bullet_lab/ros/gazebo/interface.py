"""All that the bridge offers under /gazebo, and what changes or shows the running world."""

from __future__ import annotations

from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.bridge.world_topics import WorldMarkers
from bullet_lab.ros.gazebo.forces import GazeboForces
from bullet_lab.ros.gazebo.models import GazeboModels
from bullet_lab.ros.gazebo.physics import GazeboPhysics
from bullet_lab.ros.gazebo.states import GazeboStates, GazeboTopics
from bullet_lab.ros.gazebo.world_saver import WorldSaver


class Gazebo:
    """Gazebo's services and topics on a running world.

    Args:
        world: the world.
        frame: the world's frame in RViz.
        hidden: name of the model that RViz shows as a robot.
        states_rate: messages per simulated second on /gazebo/model_states and link_states.
    """

    def __init__(self, world: RunningWorld, frame: str, hidden: str, states_rate: float):
        self._world = world
        self._markers = WorldMarkers(world, frame, hidden)
        self._topics = GazeboTopics(world, states_rate)
        self._services = [
            GazeboModels(world),
            GazeboStates(world),
            GazeboForces(world),
            GazeboPhysics(world),
            WorldSaver(world),
        ]

    def everything_moved(self) -> None:
        """Show that models were put elsewhere, by somebody else."""
        self._world.change(lambda: "")
