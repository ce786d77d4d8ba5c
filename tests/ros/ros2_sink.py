"""A robot in ROS 2 that is where its streamed commands say, with obstacles around it.

Usage: ros2_sink.py '{"topics": {TOPIC: [JOINT]}, "position": {JOINT: rad}, "obstacles": {"topic": TOPIC,
"kind": TYPE, "frame": NAME, "names": [NAME], "centers": [[m]], "radius": m}}', run by a Python with rclpy; clouds
show one side of spheres. Reads one JSON object a line: {"silent": "joints" or "obstacles", "for": s}, {"joints":
[NAME]}, which its controllers then say they move, and {"tell": true}. Prints "ready", and at each "tell" the commands
so far, with instants by the system's monotonic clock.
"""

import json
import sys
import threading
import time
from array import array
from importlib import import_module

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

RATE = 100.0  # Hz, of joint states and obstacles
POINTS = 0.003  # m, standard deviation of the points of clouds


def log(event, **content):
    print(json.dumps(dict(content, event=event)), flush=True)


class Sink:
    def __init__(self, topics, position, obstacles=None):
        self.node = rclpy.create_node("sink")
        self.controllers = []
        self.position, self.rows, self.silent = dict(position), [], {}
        self.states = self.node.create_publisher(JointState, "/joint_states", 10)
        for k, (topic, joints) in enumerate(topics.items()):
            controller = rclpy.create_node(f"controller{k}")
            controller.declare_parameter("joints", joints)
            self.controllers.append(controller)
            controller.create_subscription(
                Float64MultiArray, topic, lambda m, joints=joints: self.take(joints, m.data), 10
            )
        self.obstacles, self.rng = obstacles, np.random.default_rng(0)
        if obstacles is not None:
            package, _, name = obstacles["kind"].partition("/msg/")
            self.message = getattr(import_module(package + ".msg"), name)
            self.seen = self.node.create_publisher(self.message, obstacles["topic"], qos_profile_sensor_data)
        self.node.create_timer(1.0 / RATE, self.publish)

    def take(self, joints, values):
        self.position.update(zip(joints, values, strict=True))
        self.rows.append([time.monotonic(), joints[0], *values])

    def speaks(self, what):
        return time.monotonic() > self.silent.get(what, 0.0)

    def publish(self):
        now = self.node.get_clock().now().to_msg()
        if self.speaks("joints"):
            message = JointState(name=list(self.position), position=list(self.position.values()))
            message.header.stamp = now
            self.states.publish(message)
        if self.obstacles is not None and self.speaks("obstacles"):
            self.seen.publish(self.around(now))

    def around(self, now):
        """The obstacles as a message."""
        from geometry_msgs.msg import Pose

        told, message = self.obstacles, self.message()
        if hasattr(message, "point_step"):
            return self.cloud(message, now)
        poses = [Pose() for _ in told["centers"]]
        for pose, center in zip(poses, told["centers"], strict=True):
            pose.position.x, pose.position.y, pose.position.z = center
        if hasattr(message, "markers"):
            marker = import_module("visualization_msgs.msg").Marker
            for name, pose in zip(told["names"], poses, strict=True):
                message.markers.append(marker(ns=name, pose=pose))
                message.markers[-1].header.stamp, message.markers[-1].header.frame_id = now, told["frame"]
            return message
        message.header.stamp, message.header.frame_id, message.poses = now, told["frame"], poses
        return message

    def cloud(self, message, now):
        """Points on the sides of spheres that a camera above sees, as an image with a row a sphere."""
        from sensor_msgs.msg import PointField

        told, normals = self.obstacles, self.rng.normal(size=(600, 3))
        normals[:, 2] = np.abs(normals[:, 2])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        points = np.array(told["centers"])[:, None] + told["radius"] * normals
        points += POINTS * self.rng.normal(size=points.shape)
        points[:, ::50] = np.nan  # the camera sees nothing there
        message.header.stamp, message.header.frame_id = now, told["frame"]
        message.height, message.width = points.shape[:2]
        message.fields = [
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
            for k, name in enumerate("xyz")
        ]
        message.point_step, message.row_step = 12, 12 * points.shape[1]
        message.data = array("B", points.astype("f4").tobytes())
        return message


def main():
    rclpy.init()
    sink = Sink(**json.loads(sys.argv[1]))
    executor = SingleThreadedExecutor()
    nodes = [sink.node, *sink.controllers]
    for node in nodes:
        executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    log("ready")
    for line in sys.stdin:
        order = json.loads(line)
        if "silent" in order:
            sink.silent[order["silent"]] = time.monotonic() + order["for"]
        if "joints" in order:
            for controller in sink.controllers:
                controller.set_parameters([Parameter("joints", value=order["joints"])])
            log("set")
        if "tell" in order:
            log("rows", rows=list(sink.rows))
    executor.shutdown(1.0)
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
