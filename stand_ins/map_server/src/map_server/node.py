"""The nodes map_server and map_saver, by their names and command lines.

:ROS Parameters: ~frame_id (map)
:ROS Publishers: map (nav_msgs/OccupancyGrid), map_metadata (nav_msgs/MapMetaData), both latched
:ROS Services: static_map (nav_msgs/GetMap)

map_server FILE.yaml serves a map; map_saver [-f NAME] [map:=TOPIC] writes one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import rospy
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap, GetMapResponse
from std_msgs.msg import Header

from bullet_lab.core.files import file_errors, make_folder
from bullet_lab.core.parameters import ArgumentParser
from bullet_lab.navigation.occupancy import read_map
from bullet_lab.ros.node.lock_step import Publisher
from bullet_lab.ros.node.node import NodeError, run_node
from bullet_lab.ros.nodes.map_floor import grid_message, read_grid


def _serve() -> None:
    words = [word for word in rospy.myargv(sys.argv)[1:] if word]
    if len(words) != 1:
        raise NodeError(f"usage: map_server FILE.yaml; not '{' '.join(words)}'")
    made = read_map(Path(words[0]))
    now = rospy.Time.now()
    message = grid_message(made, Header(stamp=now, frame_id=rospy.get_param("~frame_id", "map")))
    message.info.map_load_time = now
    rospy.Service("static_map", GetMap, lambda _: GetMapResponse(message))
    for topic, kind, content in (
        ("map_metadata", MapMetaData, message.info), ("map", OccupancyGrid, message),
    ):
        Publisher(topic, kind, queue_size=1, latch=True).publish(content)
    rows, columns = made.cells.shape
    rospy.loginfo("%d x %d cells of %g m from %s", columns, rows, made.resolution, words[0])
    rospy.spin()


def _save() -> None:
    parser = ArgumentParser(prog="map_saver", add_help=False)
    parser.add_argument("-f", default="map")
    parser.add_argument("--occ", type=int, default=65)
    parser.add_argument("--free", type=int, default=25)
    name = Path(parser.parse_args(rospy.myargv(sys.argv)[1:]).f)
    made = read_grid(rospy.wait_for_message("map", OccupancyGrid))
    make_folder(name.parent)
    with file_errors(f"cannot write {name}"):
        name.with_name(f"{name.name}.pgm").write_bytes(made.pgm())
        name.with_name(f"{name.name}.yaml").write_text(made.yaml(f"{name.name}.pgm"))
    rospy.loginfo("the map is in %s.yaml", name)


def main() -> None:
    """Run map_server."""
    run_node("map_server", _serve)


def save() -> None:
    """Run map_saver."""
    run_node("map_saver", _save)
