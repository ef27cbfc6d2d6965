"""The service /bullet_lab/describe_models: what of the models acts, and what was said of them."""

from __future__ import annotations

import logging
from typing import Any, List

import rospy
from geometry_msgs.msg import Point

from bullet_lab.errors import LabError
from bullet_lab.msg import ModelDescription, PluginDescription
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.simulation.models import (
    ModelInstance,
    PluginSurvey,
    bounds,
    find_model,
    survey,
)
from bullet_lab.srv import DescribeModels, DescribeModelsResponse

MOST_LINES = 1000
# z of the normal of the steepest ground that a robot stands on (60°): a wall is steeper.
STEEPEST = 0.5


class Warnings(logging.Handler):
    """Keeps what the library warns of from now on in `lines`, each once."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.lines: List[str] = []
        logging.getLogger("bullet_lab").addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Take note of a line."""
        line = record.getMessage()
        if line not in self.lines and len(self.lines) < MOST_LINES:
            self.lines.append(line)


class ModelDescriptions:
    """Offers the service."""

    def __init__(self, world: RunningWorld, warnings: Warnings):
        self._world, self._warnings = world, warnings
        self._service = rospy.Service("/bullet_lab/describe_models", DescribeModels, self._answer)

    def _answer(self, request: Any) -> DescribeModelsResponse:
        try:
            models = self._world.do(lambda: self._describe(request.model_name))
        except LabError as error:
            return DescribeModelsResponse(success=False, status_message=str(error))
        return DescribeModelsResponse(success=True, models=models, said=self._warnings.lines)

    def _describe(self, name: str) -> List[ModelDescription]:
        models = self._world.models
        chosen = [find_model(models, name)] if name else models.values()
        return [self._described(instance) for instance in chosen]

    def _described(self, instance: ModelInstance) -> ModelDescription:
        model = instance.model
        least, greatest = bounds(instance)
        touches = list(self._world.simulation.touches(model.name))
        of_world_file = {one.name for one in self._world.simulation.world.models}
        return ModelDescription(
            name=model.name,
            is_static=model.static,
            of_world_file=model.name in of_world_file,
            links=[link.name for link in model.own_links()],
            joints=[joint.name for joint in model.joints],
            plugins=[_described_plugin(one) for one in survey(instance)],
            least=Point(*least),
            greatest=Point(*greatest),
            stands_on=sorted({own for own, _, up in touches if up > STEEPEST}),
            touches=sorted({other for _, other, up in touches if up <= STEEPEST}),
        )


def _described_plugin(plugin: PluginSurvey) -> PluginDescription:
    return PluginDescription(
        name=plugin.tag.name,
        filename=plugin.tag.filename,
        link=plugin.tag.link,
        acts=plugin.acts,
        rate=plugin.rate,
        inputs=[rospy.resolve_name(topic) for topic in plugin.inputs],
        outputs=[rospy.resolve_name(topic) for topic in plugin.outputs],
        tags_not_simulated=plugin.unread,
        refused=plugin.refused,
    )
