"""A client of a robot in ROS 2 that is not comove's: it sends goals and listens, as it is told.

Usage: ros2_client.py '{"listen": s, "goals": [GOAL], "stream": {"topic": TOPIC, "positions": [[rad]]},
"sim_time": bool}', run by a Python with rclpy. A GOAL has "action", "joints", "times" [s], "positions" [[rad]], and
if wanted "velocities", "stamp" [s from now], "path" and "end" {JOINT: [rad, rad/s, rad/s^2]}, "late" [s],
"after" [s], when it is sent, and "cancel" [s after it is accepted]. A gripper's goal has "kind", "action" and
"position". Prints one JSON object a line: answers, feedbacks, results, and at last all joint states.
"""

import json
import sys
import threading
import time

import rclpy
from builtin_interfaces.msg import Duration
from control_msgs import action as actions
from control_msgs.msg import JointTolerance
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectoryPoint

FIND = 10.0  # s, to find servers


def log(event, **content):
    print(json.dumps(dict(content, event=event)), flush=True)


def duration(seconds):
    sec, nanosec = divmod(round(seconds * 1e9), 10**9)
    return Duration(sec=sec, nanosec=nanosec)


def seconds(stamp):
    return stamp.sec + 1e-9 * stamp.nanosec


class Client:
    """Node that sends goals on its executor's thread."""

    def __init__(self, sim_time):
        override = [Parameter("use_sim_time", Parameter.Type.BOOL, True)] if sim_time else []
        self.node = rclpy.create_node("a_client", parameter_overrides=override)
        self.states, self.left = [], set()
        self.node.create_subscription(JointState, "/joint_states", self.on_states, qos_profile_sensor_data)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def now(self):
        return self.node.get_clock().now().nanoseconds * 1e-9

    def on_states(self, message):
        self.names = list(message.name)
        row = seconds(message.header.stamp), self.now(), time.monotonic()
        self.states.append([*row, *message.position, *message.velocity, *message.effort])

    def on_thread(self, work):
        done = self.executor.create_task(work)
        while not done.done():
            time.sleep(0.001)
        return done.result()

    def message(self, kind, goal):
        """A goal as a message."""
        message = kind.Goal()
        if goal.get("kind") == "GripperCommand":
            message.command.position = goal["position"]
            return message
        if goal.get("kind") == "ParallelGripperCommand":
            message.command.position = [goal["position"]]
            return message
        path = message.trajectory
        path.joint_names = goal["joints"]
        for i, (at, position) in enumerate(zip(goal["times"], goal["positions"], strict=True)):
            point = JointTrajectoryPoint(positions=position, time_from_start=duration(at))
            if "velocities" in goal:
                point.velocities = goal["velocities"][i]
            path.points.append(point)
        if "stamp" in goal:
            path.header.stamp = Time(nanoseconds=round((self.now() + goal["stamp"]) * 1e9)).to_msg()
        for field, given in (("path_tolerance", goal.get("path")), ("goal_tolerance", goal.get("end"))):
            for name, (position, velocity, acceleration) in (given or {}).items():
                tolerance = JointTolerance(
                    name=name, position=position, velocity=velocity, acceleration=acceleration
                )
                getattr(message, field).append(tolerance)
        message.goal_time_tolerance = duration(goal.get("late", 0.0))
        return message

    def send(self, number, goal):
        """Send a goal, and tell what becomes of it."""
        kind = getattr(actions, goal.get("kind", "FollowJointTrajectory"))
        client = ActionClient(self.node, kind, goal["action"])
        if not client.wait_for_server(FIND):
            log("missing", goal=number)
            return
        self.left.add(number)
        time.sleep(max(0.0, goal.get("after", 0.0) - (time.monotonic() - self.begun)))

        def on_feedback(message):
            log("feedback", goal=number, at=time.monotonic(), **told(message.feedback))

        def on_answer(future):
            handle = future.result()
            log("answer", goal=number, accepted=handle.accepted, at=time.monotonic())
            if not handle.accepted:
                self.left.discard(number)
                return
            handle.get_result_async().add_done_callback(on_result)
            if "cancel" in goal:
                timer = threading.Timer(goal["cancel"], lambda: self.on_thread(handle.cancel_goal_async))
                timer.start()

        def on_result(future):
            answer, at = future.result(), self.now()
            log("result", goal=number, status=answer.status, now=at, **told(answer.result))
            self.left.discard(number)

        message = self.message(kind, goal)
        self.on_thread(
            lambda: client.send_goal_async(message, on_feedback).add_done_callback(on_answer) and None
        )

    def stream(self, topic, positions):
        """Publish positions, 100 times a second."""
        publisher = self.node.create_publisher(Float64MultiArray, topic, 10)
        until = time.monotonic() + FIND
        while not publisher.get_subscription_count() and time.monotonic() < until:
            time.sleep(0.01)
        for position in positions:
            publisher.publish(Float64MultiArray(data=position))
            time.sleep(0.01)


def told(message):
    """The fields of a feedback or result that tests look at."""
    found = {}
    for name in ("error_code", "error_string", "stalled", "reached_goal", "position"):
        if hasattr(message, name):
            found[name] = getattr(message, name)
    if hasattr(message, "state"):
        found["position"] = list(message.state.position)
    for name in ("desired", "actual", "error"):
        if hasattr(message, name):
            point = getattr(message, name)
            found[name] = [list(point.positions), list(point.velocities)]
    if hasattr(message, "joint_names"):
        found["joints"] = list(message.joint_names)
    return found


def main():
    settings = json.loads(sys.argv[1])
    rclpy.init()
    client = Client(settings.get("sim_time", False))
    until = time.monotonic() + FIND
    while not client.states and time.monotonic() < until:
        time.sleep(0.01)
    client.begun = time.monotonic()
    for number, goal in enumerate(settings.get("goals", ())):
        client.send(number, goal)
    if "stream" in settings:
        client.stream(**settings["stream"])
    while client.left and time.monotonic() - client.begun < 30.0:
        time.sleep(0.005)
    time.sleep(settings.get("listen", 0.0))
    log("states", names=client.names, rows=client.states)
    client.executor.shutdown(1.0)
    client.node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
