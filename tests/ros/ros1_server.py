"""An arm's action server in ROS 1, simulated; run by a Python that has rospy. Not a line of it is comove's.

Usage: ros1_server.py '{"arm": "left", "position": {JOINT: rad}, "action": NAME, "fault": null | "stuck" | "abort" |
"slow" | "refuse" | "endless" | "skewed" | "silent", "states": true, "gripper": null}'. Prints one JSON object a line:
what happened and when, by the system's monotonic clock.
"""

import json
import sys
import threading
import time

import actionlib
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from genpy.dynamic import generate_dynamic
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

RATE = 100.0  # Hz
STUCK_AT = 0.3  # s after the start
SILENT_AT = 0.6  # s after the start, when a silent arm tells its joints no more
SLOW = 0.6  # of the speed, of a slow arm
SKEW = 3.0  # s, that the clock of a skewed robot is late
LOCK = threading.Lock()
LINE = "\n" + 80 * "=" + "\n"
CONTROL = {
    "FollowJointTrajectoryAction": "FollowJointTrajectoryActionGoal action_goal\n"
    "FollowJointTrajectoryActionResult action_result\nFollowJointTrajectoryActionFeedback action_feedback",
    "FollowJointTrajectoryActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\nFollowJointTrajectoryGoal goal",
    "FollowJointTrajectoryActionResult": "Header header\nactionlib_msgs/GoalStatus status\n"
    "FollowJointTrajectoryResult result",
    "FollowJointTrajectoryActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\n"
    "FollowJointTrajectoryFeedback feedback",
    "FollowJointTrajectoryGoal": "trajectory_msgs/JointTrajectory trajectory\nJointTolerance[] path_tolerance\n"
    "JointTolerance[] goal_tolerance\nduration goal_time_tolerance",
    "FollowJointTrajectoryResult": "int32 error_code\nint32 SUCCESSFUL = 0\nint32 INVALID_GOAL = -1\n"
    "int32 INVALID_JOINTS = -2\nint32 OLD_HEADER_TIMESTAMP = -3\nint32 PATH_TOLERANCE_VIOLATED = -4\n"
    "int32 GOAL_TOLERANCE_VIOLATED = -5\nstring error_string",
    "FollowJointTrajectoryFeedback": "Header header\nstring[] joint_names\n"
    "trajectory_msgs/JointTrajectoryPoint desired\ntrajectory_msgs/JointTrajectoryPoint actual\n"
    "trajectory_msgs/JointTrajectoryPoint error",
    "JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration",
}


def action_types():
    texts = ["MSG: control_msgs/" + name + "\n" + text + "\n" for name, text in CONTROL.items()]
    known = {}
    for message in (JointTrajectory, GoalStatus, GoalID):
        known.update({part.split("\n")[0]: part for part in message._full_text.split(LINE)[1:]})
        known["MSG: " + message._type] = "MSG: " + message._type + "\n" + message._full_text.split(LINE)[0]
    action = texts[0].split("\n", 1)[1]
    return generate_dynamic(
        "control_msgs/FollowJointTrajectoryAction", LINE.join([action, *texts[1:], *known.values()])
    )


class Arm:
    """Joints that go where the goal says, unless they have a fault."""

    def __init__(self, arm, position, action, fault, states, gripper):
        self.position, self.fault, self.silent = dict(position), fault, False
        self.types = action_types()
        self.goal, self.stop = None, threading.Event()
        kind = self.types["control_msgs/FollowJointTrajectoryAction"]
        self.server = actionlib.ActionServer(action, kind, self.on_goal, self.on_cancel, auto_start=False)
        self.states = rospy.Publisher("/robot/joint_states", JointState, queue_size=10, tcp_nodelay=True)
        self.server.start()
        if states:
            threading.Thread(target=self.tell_states, daemon=True).start()
        self.log("ready")

    @staticmethod
    def log(event, **content):
        with LOCK:
            print(json.dumps(dict(content, event=event, at=time.monotonic())), flush=True)

    def tell_states(self):
        rate = rospy.Rate(RATE)
        while not rospy.is_shutdown() and not self.silent:
            message = JointState(name=list(self.position), position=list(self.position.values()))
            late = SKEW if self.fault == "skewed" else 0.0
            message.header.stamp = rospy.Time.now() - rospy.Duration(late)
            self.states.publish(message)
            rate.sleep()

    def on_goal(self, goal):
        self.log("goal", stamp=goal.get_goal().trajectory.header.stamp.to_nsec())
        if self.fault == "refuse":
            goal.set_rejected(text="the arm is not enabled")
            return
        goal.set_accepted()
        self.stop.clear()
        threading.Thread(target=self.follow, args=(goal,), daemon=True).start()

    def on_cancel(self, goal):
        self.log("cancel")
        self.stop.set()

    def follow(self, goal):
        trajectory = goal.get_goal().trajectory
        times = [point.time_from_start.to_sec() for point in trajectory.points]
        result = self.types["control_msgs/FollowJointTrajectoryResult"]()
        rate, row = rospy.Rate(RATE), 0
        while not rospy.is_shutdown():
            now = (rospy.Time.now() - trajectory.header.stamp).to_sec()
            now *= SLOW if self.fault == "slow" else 1.0
            self.silent = self.fault == "silent" and now > SILENT_AT
            if self.stop.is_set():
                goal.set_canceled(result)
                self.log("stopped", time=now)
                return
            if self.fault == "abort" and now > STUCK_AT:
                result.error_code = result.PATH_TOLERANCE_VIOLATED
                goal.set_aborted(result, "")
                self.log("aborted", time=now)
                return
            while row + 2 < len(times) and times[row + 1] < now:
                row += 1
            share = min(max((now - times[row]) / (times[row + 1] - times[row]), 0.0), 1.0)
            first, second = trajectory.points[row].positions, trajectory.points[row + 1].positions
            for i, name in enumerate(trajectory.joint_names):
                if self.fault != "stuck" or now <= STUCK_AT:
                    self.position[name] = first[i] + share * (second[i] - first[i])
            if now >= times[-1] and self.fault != "endless":
                goal.set_succeeded(result)
                self.log("done", time=now)
                return
            rate.sleep()


if __name__ == "__main__":
    settings = json.loads(sys.argv[1])
    rospy.init_node("arm_" + settings["arm"], disable_signals=True)
    Arm(**settings)
    while True:
        time.sleep(1.0)
