"""A stage in this process: the simulation itself, without ROS."""

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.forces import Effort, Period, Wrench
from bullet_lab.simulation.models import find_joint, find_link
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import FrameState
from bullet_lab.simulation.world.sdf import read_spawned

FLOOR = "package://bullet_lab/worlds/empty.world"


class DirectStage:
    """The simulation in this process; a new one after `clear`."""

    def __init__(self):
        self.simulation = Simulation.of(FLOOR)

    def spawn(self, text, pose):
        model = read_spawned(text, "a model")
        name = f"{model.name}_{len(self.simulation.models)}"
        self.simulation.add(model, name, pose * model.pose)
        return name

    def clear(self):
        self.simulation.close()
        self.simulation = Simulation.of(FLOOR)

    def state(self, name):
        instance = self.simulation.models[name]
        return FrameState(instance.pose(), *instance.frame().velocity())

    def put(self, name, state):
        self.simulation.models[name].move(state.pose, state.linear, state.angular)

    def command(self, name, vx, vy, wz):
        self.simulation.models[name].command("cmd_vel", PlanarCommand(vx, vy, wz))

    def push(self, body, push):
        if push.frame:
            raise NotImplementedError("frames belong to the service; play it through ROS")
        link = find_link(self.simulation.models, body)
        given_in = FrameState(Pose(link.frame.pose().position))
        wrench = (given_in, link, push.force, push.torque, push.point)
        self.simulation.forces.add(Wrench.at_point(*wrench, self._period(push.seconds)))

    def exert(self, name, joint, effort, seconds):
        found = find_joint(self.simulation.models, f"{name}::{joint}")
        self.simulation.forces.add(Effort(*found, effort, self._period(seconds)))

    def _period(self, seconds):
        return Period.after(self.simulation.step, 0.0, seconds)

    def joint(self, name, joint):
        state = self.simulation.models[name].body_of_joint(joint).joint_state(joint)
        return state.position, state.velocity

    def turn_joint(self, name, joint, position):
        self.simulation.models[name].configure({joint: position})

    def run(self, seconds):
        self.simulation.run_for(seconds)
