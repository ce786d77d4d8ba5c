"""Another client of an arm's controller in ROS 2; run by a Python that has rclpy.

Usage: ros2_other.py ACTION JOINT...: sends a goal that holds the joints at 0 for 5 s as soon as a line comes in.
Prints a JSON object when it can, and one when it has sent it.
"""

import json
import sys
import time

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from trajectory_msgs.msg import JointTrajectoryPoint

action, *joints = sys.argv[1:]
rclpy.init()
node = rclpy.create_node("other")
client = ActionClient(node, FollowJointTrajectory, action)
client.wait_for_server()
print(json.dumps({"event": "ready"}), flush=True)
sys.stdin.readline()
still = [0.0] * len(joints)
goal = FollowJointTrajectory.Goal()
goal.trajectory.joint_names = joints
goal.trajectory.points = [
    JointTrajectoryPoint(positions=still, velocities=still, time_from_start=Duration(sec=second))
    for second in (1, 5)
]
sent = client.send_goal_async(goal)
print(json.dumps({"event": "sent", "at": time.monotonic()}), flush=True)
rclpy.spin_until_future_complete(node, sent)
rclpy.spin(node)
