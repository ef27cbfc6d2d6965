#!/usr/bin/env python3
"""What colours and lights look like: through a camera that flies."""

import rospy
from gazebo_msgs.srv import DeleteModel, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import Image

CAMERA = """<sdf version="1.6"><model name="drone"><static>true</static><link name="body">
<sensor name="eye" type="camera"><update_rate>10</update_rate><camera>
<horizontal_fov>0.8</horizontal_fov><image><width>80</width><height>60</height>
<format>R8G8B8</format></image><clip><near>0.1</near><far>20</far></clip></camera>
<plugin name="eye" filename="libgazebo_ros_camera.so"><cameraName>%s</cameraName>
<frameName>body</frameName></plugin></sensor></link></model></sdf>"""
PANEL = """<robot name="panel"><link name="panel"><inertial><mass value="5"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
<visual><geometry><box size="0.2 2 2"/></geometry></visual></link>
<gazebo reference="panel"><material>Gazebo/%s</material></gazebo></robot>"""
BOARD = '<sdf version="1.6"><include><uri>model://board</uri></include></sdf>'
PLATE = """<sdf version="1.6"><model name="plate"><static>true</static><link name="l">
<visual name="v"><geometry><box><size>0.1 1 1</size></box></geometry>
<material><ambient>1 1 1 1</ambient><diffuse>1 1 1 1</diffuse></material></visual></link></model>
</sdf>"""

rospy.init_node("materials_and_lights")
rospy.wait_for_service("/gazebo/spawn_sdf_model")
spawn_sdf = rospy.ServiceProxy("/gazebo/spawn_sdf_model", SpawnModel)
spawn_urdf = rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)
delete = rospy.ServiceProxy("/gazebo/delete_model", DeleteModel)


def at(x, y, z):
    return Pose(Point(x, y, z), Quaternion(0, 0, 0, 1))


def picture(name, x, y):
    """Colours to the left and to the right of the middle, seen from (x, y), 0.5 m high."""
    spawn_sdf("drone", CAMERA % name, "", at(x, y, 0.5), "")
    image = rospy.wait_for_message(name + "/image_raw", Image, timeout=20)
    delete("drone")
    row = 30 * image.step
    return [tuple(image.data[row + 3 * column : row + 3 * column + 3]) for column in (30, 50)]


for colour in ("Green", "Purple"):
    spawn_urdf("panel", PANEL % colour, "", at(-28, 40, 0.5), "")
    print("%s: %d %d %d" % ((colour,) + picture("paint_" + colour.lower(), -30, 40)[0]))
    delete("panel")

spawn_sdf("board", BOARD, "", at(-28, 45, 0), "")
left, right = picture("picture", -30, 45)
print("left: %d %d %d" % left)
print("right: %d %d %d" % right)
delete("board")

for name, x in (("near", 22), ("far", 40)):
    spawn_sdf("plate", PLATE, "", at(x, 0, 0.5), "")
    print("%s the lamp: %d" % (name, picture("plate_" + name, x - 1.5, 0)[0][0]))
    delete("plate")
