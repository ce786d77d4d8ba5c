"""A client of MoveIt's action that is not comove's, and a stand-in for what move_group tells of the planning scene.

Usage: ros2_planning_client.py FILE, run by a Python with rclpy and moveit_msgs. FILE is JSON: {"action": NAME,
"goals": [{"goal": FIELDS, "after": s, "cancel": s}], "scenes": {TOPIC: [FIELDS]}, "service": FIELDS or null,
"stay": bool}. Scenes are published and kept for late subscribers, the service answers as /get_planning_scene. Prints
one JSON object a line: answers, feedbacks and results; "ready" at once if it stays.
"""

import json
import sys
import threading
import time
from importlib import import_module
from pathlib import Path

import rclpy
from moveit_msgs.action import MoveGroup
from moveit_msgs.msg import PlanningScene
from moveit_msgs.srv import GetPlanningScene
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile

FIND = 15.0  # s, to find the server


def log(event, **content):
    print(json.dumps(dict(content, event=event)), flush=True)


def filled(message, given):
    """Write nested fields into a message."""
    kinds = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True))
    for name, value in given.items():
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            kind = kinds[name].value_type
            made = getattr(import_module(".".join(kind.namespaces)), kind.name)
            setattr(message, name, [filled(made(), one) for one in value])
        else:
            setattr(message, name, value)
    return message


def told(result):
    """The fields of a result that tests look at."""
    path, start = result.planned_trajectory.joint_trajectory, result.trajectory_start.joint_state
    return {
        "code": result.error_code.val,
        "text": result.error_code.message,
        "seconds": result.planning_time,
        "start": dict(zip(start.name, start.position, strict=True)),
        "joints": list(path.joint_names),
        "time": [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in path.points],
        "position": [list(point.positions) for point in path.points],
        "velocity": [list(point.velocities) for point in path.points],
        "acceleration": [list(point.accelerations) for point in path.points],
    }


class Client:
    """Node that sends goals on the main thread."""

    def __init__(self, action):
        self.node = rclpy.create_node("a_planning_client")
        self.client, self.left = ActionClient(self.node, MoveGroup, action), set()
        self.timers = []

    def publish(self, scenes):
        kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, messages in scenes.items():
            publisher = self.node.create_publisher(PlanningScene, topic, kept)
            for message in messages:
                publisher.publish(filled(PlanningScene(), message))

    def answer(self, scene):
        def answered(request, response):
            log("asked", components=request.components.components)
            response.scene = filled(PlanningScene(), scene)
            return response

        self.node.create_service(GetPlanningScene, "/get_planning_scene", answered)

    def send(self, number, goal):
        """Send a goal, and tell what becomes of it."""

        def on_answer(future):
            handle = future.result()
            log("answer", goal=number, accepted=handle.accepted)
            handle.get_result_async().add_done_callback(on_result)
            if "cancel" in goal:
                self.once(goal["cancel"], handle.cancel_goal_async)

        def on_result(future):
            answer = future.result()
            log("result", goal=number, status=answer.status, at=time.monotonic(), **told(answer.result))
            self.left.discard(number)

        def on_feedback(message):
            log("feedback", goal=number, state=message.feedback.state)

        message = filled(MoveGroup.Goal(), goal["goal"])
        self.client.send_goal_async(message, on_feedback).add_done_callback(on_answer)

    def once(self, seconds, work):
        """Do something on the executor's thread after some time."""

        def due():
            timer.cancel()
            work()

        timer = self.node.create_timer(max(seconds, 1e-3), due)
        self.timers.append(timer)


def main():
    scenario = json.loads(Path(sys.argv[1]).read_text())
    rclpy.init()
    client = Client(scenario.get("action", "/comove/move_action"))
    client.publish(scenario.get("scenes", {}))
    if scenario.get("service"):
        client.answer(scenario["service"])
    if scenario.get("stay"):
        log("ready")
        rclpy.spin(client.node)
        return
    if not client.client.wait_for_server(FIND):
        log("missing")
        return
    for number, goal in enumerate(scenario["goals"]):
        client.left.add(number)
        client.once(goal.get("after", 0.0), lambda number=number, goal=goal: client.send(number, goal))
    threading.Timer(scenario.get("patience", 80.0), rclpy.shutdown).start()
    while client.left and rclpy.ok():
        rclpy.spin_once(client.node, timeout_sec=0.1)
    sys.stdout.flush()
    import os

    os._exit(0)  # without waiting for the timer


if __name__ == "__main__":
    main()
