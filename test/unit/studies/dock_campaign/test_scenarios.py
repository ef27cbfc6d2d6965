from alike import lines_of

from bullet_lab.studies.dock_campaign.stress import STRESSES, Stress, stress_columns, world_under
from bullet_lab.studies.dock_campaign.trial import (
    MARKER_POSE,
    TURNING_RADIUS,
    UNKNOWN_CLEARANCE,
    WORLDS,
    DrawSettings,
    dock_of,
    draw_scenario,
    obstacles,
)
from bullet_lab.studies.worlds import read_world

NARROW = DrawSettings(worlds=("docking_decoy",), lights=("dark",), odometry=("odom",))


def drawn(settings, count):
    return [draw_scenario(settings, index) for index in range(count)]


def told():
    """Scenarios, what stands in their worlds, and what is drawn and stands there under stress."""
    yield from lines_of(draw_scenario(NARROW, 4), "narrow")
    for scenario in drawn(DrawSettings(seed=3), 16):
        assert scenario.stress == Stress()
        yield from lines_of({**vars(scenario), "stress": ""}, "drawn")
    for world in WORLDS:
        yield from lines_of(obstacles(world), world)
    for index, name in enumerate((*STRESSES, *8 * ["all"])):
        scenario = draw_scenario(DrawSettings(seed=5, stress=(name,)), index)
        yield from lines_of(stress_columns(scenario.stress), name)
        world = read_world("docking_decoy")
        world = world_under(scenario.stress, world, MARKER_POSE, dock_of(scenario))
        for model in world.models:
            yield from lines_of(model if model.name == "cover" else model.pose, model.name)


def test_scenarios_are_drawn_as_before(as_before):
    as_before(told(), "scenarios.txt")


def test_starts_leave_room_to_turn():
    """Index 616 of seed 2026 stood between the dock and a panel beside it, and touched that."""
    starts = set()
    for scenario in drawn(DrawSettings(seed=2026), 620):
        starts.add(scenario.start)
        for wall in obstacles(scenario.world):
            room = UNKNOWN_CLEARANCE if wall.name == "decoy" else TURNING_RADIUS
            assert wall.distance(scenario.start[:2]) > room
    assert len(starts) == 620
