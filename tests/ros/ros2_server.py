"""An arm's controller in ROS 2, simulated; run by a Python that has rclpy. Not a line of it is comove's.

Usage: ros2_server.py '{"arm": "left", "position": {JOINT: rad}, "action": NAME, "fault": null | "stuck" | "abort" |
"slow" | "refuse" | "endless" | "skewed" | "silent" |
"frozen" | "late" | "jammed", "states": true, "gripper": null | TYPE}'. It refuses what a
joint_trajectory_controller refuses, as its documentation and source say. Prints one JSON object a line: what happened
and when, by the system's monotonic clock.
"""

import json
import sys
import threading
import time

import rclpy
from control_msgs import action as actions
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.time import Time
from sensor_msgs.msg import JointState

RATE = 100.0  # Hz
FEEDBACK = 0.05  # s
STUCK_AT = 0.3  # s after the start
SILENT_AT = 0.6  # s after the start, when a silent arm tells its joints no more
STOPPED = 1.2e-7  # rad/s, largest velocity of a last point
LATE = 0.6  # s, until a late arm looks at a goal
SLOW = 0.6  # of the speed, of a slow arm
SKEW = 3.0  # s, that the clock of a skewed robot is late


LOCK = threading.Lock()


def log(event, **content):
    with LOCK:
        print(json.dumps(dict(content, event=event, at=time.monotonic())), flush=True)


def seconds(message):
    return message.sec + 1e-9 * message.nanosec


class Arm:
    """Joints that go where the goal says, unless they have a fault."""

    def __init__(self, node, arm, position, action, fault, states, gripper):
        self.node, self.position, self.fault = node, dict(position), fault
        self.silent = self.moves = False
        self.result = FollowJointTrajectory.Result
        self.group = ReentrantCallbackGroup()
        self.server = ActionServer(
            node,
            FollowJointTrajectory,
            action,
            self.follow,
            callback_group=self.group,
            goal_callback=self.on_goal,
            cancel_callback=self.on_cancel,
        )
        if gripper is not None:
            name = {"gripper_command": "GripperCommand", "parallel_gripper_command": "ParallelGripperCommand"}
            kind = getattr(actions, name.get(gripper, "FollowJointTrajectory"))
            self.gripper = ActionServer(
                node, kind, f"/{arm}_gripper/grip", self.grip, callback_group=self.group
            )
            self.kind = kind
        self.topic = node.create_publisher(JointState, "/joint_states", 10)
        if states:
            threading.Thread(target=self.tell_states, daemon=True).start()

    def tell_states(self):
        while rclpy.ok() and not self.silent:
            message = JointState(name=list(self.position), position=list(self.position.values()))
            now = self.node.get_clock().now().nanoseconds - (int(SKEW * 1e9) if self.fault == "skewed" else 0)
            message.header.stamp = Time(nanoseconds=now).to_msg()
            if self.fault == "frozen" and self.moves:
                message = self.last
            self.last = message
            self.topic.publish(message)
            time.sleep(1.0 / RATE)

    def wrong(self, path):
        """Return what a controller refuses in a trajectory; empty if nothing."""
        times = [seconds(point.time_from_start) for point in path.points]
        now = self.node.get_clock().now().nanoseconds * 1e-9
        if self.fault == "refuse":
            return "not activated"
        if set(path.joint_names) != set(self.position):
            return "joints"
        if not times or any(b <= a for a, b in zip(times[:-1], times[1:], strict=True)):
            return "times"
        if seconds(path.header.stamp) and seconds(path.header.stamp) + times[-1] < now:
            return "past"
        if any(abs(velocity) > STOPPED for velocity in path.points[-1].velocities):
            return "velocity"
        return ""

    def on_goal(self, request):
        if self.fault == "late":
            time.sleep(LATE)
        wrong = self.wrong(request.trajectory)
        path, tolerances = request.trajectory, request.path_tolerance
        stamp = path.header.stamp.sec * 10**9 + path.header.stamp.nanosec
        log("goal", stamp=stamp, wrong=wrong, path=[tolerance.position for tolerance in tolerances])
        return GoalResponse.REJECT if wrong else GoalResponse.ACCEPT

    def grip(self, goal):
        """Move the fingers, until they stall on the load where they close."""
        asked = (
            goal.request.command if hasattr(goal.request, "command") else goal.request.trajectory.points[0]
        )
        wanted = getattr(asked, "position", None) or getattr(asked, "positions", None) or 0.0
        wanted = float(wanted if isinstance(wanted, float) else wanted[0])
        time.sleep(0.2)
        result = self.kind.Result()
        if hasattr(result, "stalled"):
            result.stalled = wanted == 0.0 or self.fault == "jammed"
            result.reached_goal = not result.stalled
        goal.succeed()
        log("gripped", position=wanted)
        return result

    def on_cancel(self, goal):
        log("cancel")
        return CancelResponse.ACCEPT

    def follow(self, goal):
        path = goal.request.trajectory
        times = [seconds(point.time_from_start) for point in path.points]
        start = seconds(path.header.stamp) or self.node.get_clock().now().nanoseconds * 1e-9
        row, told = 0, -1.0
        while rclpy.ok():
            now = self.node.get_clock().now().nanoseconds * 1e-9 - start
            now *= SLOW if self.fault == "slow" else 1.0
            self.silent = self.fault == "silent" and now > SILENT_AT
            self.moves = now > STUCK_AT
            if goal.is_cancel_requested:
                goal.canceled()
                log("stopped", time=now)
                return self.result()
            if self.fault == "abort" and now > STUCK_AT:
                goal.abort()
                log("aborted", time=now)
                return self.result(error_code=self.result.PATH_TOLERANCE_VIOLATED)
            while row + 2 < len(times) and times[row + 1] < now:
                row += 1
            share = min(max((now - times[row]) / (times[row + 1] - times[row]), 0.0), 1.0)
            first, second = path.points[row].positions, path.points[row + 1].positions
            for i, name in enumerate(path.joint_names):
                if now >= 0.0 and (self.fault != "stuck" or now <= STUCK_AT):
                    self.position[name] = first[i] + share * (second[i] - first[i])
            if now - told > FEEDBACK:
                told = now
                goal.publish_feedback(FollowJointTrajectory.Feedback(joint_names=path.joint_names))
            if now >= times[-1] and self.fault != "endless":
                goal.succeed()
                log("done", time=now)
                return self.result()
            time.sleep(1.0 / RATE)
        return self.result()


def main():
    settings = json.loads(sys.argv[1])
    rclpy.init()
    node = rclpy.create_node("arm_" + settings["arm"])
    Arm(node, **settings)
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    log("ready")
    executor.spin()


if __name__ == "__main__":
    main()
