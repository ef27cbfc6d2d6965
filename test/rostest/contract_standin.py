"""A simulator that only talks, and breaks its word where the parameter /broken says so."""

import random
import threading
import time

import rospy
from gazebo_msgs.srv import DeleteModel, GetPhysicsProperties, GetWorldProperties, SpawnModel
from geometry_msgs.msg import TransformStamped, Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_srvs.srv import Empty, SetBool
from tf2_msgs.msg import TFMessage

# Simulated seconds per wall second, and of a step.
SPEED = 4.0
STEP = 0.01


class OtherOdometry(Odometry):
    """Has the type's name, and not its md5 sum."""

    _md5sum = "0" * 32


def broken(what):
    return rospy.get_param("/broken", "") == what


class Talker:
    """What the probe's plugin says and takes, as broken as it is told to be when it is made."""

    def __init__(self, space):
        self._ends = []
        self._speed, self._x = 0.0, 0.0
        self.broken = rospy.get_param("/broken", "")
        kind = OtherOdometry if self.broken == "md5" else Odometry
        if self.broken == "type":
            kind = Imu
        self._odometry = self.publisher(f"{space}/odom", kind, latch=self.broken == "latched")
        self._imu = self.publisher(f"{space}/imu", Imu)
        self._tf = self.publisher("/tf", TFMessage)
        if self.broken == "absent":
            self.publisher(f"{space}/secret", Imu)
        if self.broken != "takes":
            self._ends.append(rospy.Subscriber(f"{space}/cmd_vel", Twist, self.take))
        service = SetBool if self.broken == "offers" else Empty
        self._ends.append(rospy.Service(f"{space}/calibrate", service, lambda _: {}))

    def publisher(self, name, kind, **options):
        made = rospy.Publisher(name, kind, queue_size=100, tcp_nodelay=True, **options)
        self._ends.append(made)
        return made

    def take(self, message):
        self._speed = message.linear.x

    def step(self, number):
        self._x += 0.0 if self.broken == "change" else self._speed * STEP
        if number % (4 if self.broken == "rate" else 2):
            return
        stamp = rospy.Time.from_sec(number * STEP)
        message = self._odometry.data_class()
        message.header.stamp = stamp
        message.header.frame_id = "world" if self.broken == "fields" else "odom"
        if self.broken != "type":
            message.pose.pose.position.x = self._x
            noise = 0.0 if self.broken == "spread" else random.gauss(0.0, 0.1)
            message.twist.twist.linear.y = noise
        self._odometry.publish(message)
        late = 0.005 if self.broken == "stamped" else 0.0
        self._imu.publish(Imu(header=message.header.__class__(stamp=stamp + rospy.Duration(late))))
        children = ["hull" if self.broken == "tf" else "base"]
        children += ["wheel"] if self.broken == "no_tf" else []
        self._tf.publish(TFMessage([self.transform(stamp, child) for child in children]))

    def transform(self, stamp, child):
        sent = TransformStamped(child_frame_id=child)
        sent.header.stamp, sent.header.frame_id = stamp, "odom"
        return sent

    def end(self):
        for entry in self._ends:
            (entry.shutdown if isinstance(entry, rospy.Service) else entry.unregister)()


class StandIn:
    """The services of /gazebo that the contract cannot do without, and /clock."""

    def __init__(self):
        self.lock = threading.Lock()
        self.paused, self.stands, self.number, self.models = False, False, 0, {}
        self.clock = rospy.Publisher("/clock", Clock, queue_size=100)
        for name, kind, answer in (
            ("pause_physics", Empty, lambda _: self.pause(True)),
            ("unpause_physics", Empty, lambda _: self.pause(False)),
            ("get_physics_properties", GetPhysicsProperties, self.physics),
            ("get_world_properties", GetWorldProperties, self.world),
            ("spawn_sdf_model", SpawnModel, self.spawn),
            ("spawn_urdf_model", SpawnModel, self.refuse),
            ("delete_model", DeleteModel, self.delete),
        ):
            rospy.Service(f"/gazebo/{name}", kind, answer)

    def pause(self, paused):
        rospy.set_param("/contract_standin_time", not broken("parameter"))
        with self.lock:
            self.paused = paused
            self.stands = paused and not broken("silent")
        return {}

    def physics(self, _):
        return {"pause": self.paused, "success": True}

    def world(self, _):
        return {
            "sim_time": self.number * STEP,
            "model_names": list(self.models),
            "success": True,
            "status_message": "all is lost" if broken("answers") else "all is well",
        }

    def spawn(self, request):
        with self.lock:
            talks = "plugin" in request.model_xml
            talker = Talker(f"/{request.robot_namespace}") if talks else None
            self.models[request.model_name] = talker
        return True, ""

    def refuse(self, _):
        if broken("fails"):
            return True, ""
        raise rospy.ServiceException("no")

    def delete(self, request):
        with self.lock:
            talker = self.models.pop(request.model_name, None)
        if talker is not None:
            talker.end()
        return True, ""

    def spin(self):
        while not rospy.is_shutdown():
            time.sleep(STEP / SPEED)
            with self.lock:
                if self.stands:
                    continue
                self.number += 1
                self.clock.publish(Clock(rospy.Time.from_sec(self.number * STEP)))
                for talker in filter(None, self.models.values()):
                    talker.step(self.number)


if __name__ == "__main__":
    rospy.init_node("contract_standin")
    StandIn().spin()
