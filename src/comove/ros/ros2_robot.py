"""Interfaces of a simulated robot in ROS 2: a program of its own, run by a Python that has rclpy.

It has the servers and topics, and nothing of the robot: comove decides about goals and moves the joints. It reads
commands and writes events, one JSON object a line.

Commands:

    {"do": "serve", "servers": {ACTION: TYPE}, "streams": {TOPIC: "positions" or "trajectory"},
        "joint_states": TOPIC, "joints": [NAME], "obstacles": TOPIC or null, "sim_time": bool}
    {"do": "answer", "goal": NUMBER, "accepted": bool, "reason": TEXT}
    {"do": "feedback", "goal": NUMBER, "stamp": ns, "joints": [NAME], "states": {"desired": {...}, ...}}
    {"do": "progress", "goal": NUMBER, "position": m, "effort": N, "stalled": bool, "reached": bool}   of a gripper
    {"do": "end", "goal": NUMBER, "status": STATUS, "code": NUMBER, "text": TEXT, ...}   and what a progress has
    {"do": "states", "stamp": ns, "position": [rad], "velocity": [rad/s], "effort": [N m]}
    {"do": "clock", "stamp": ns}
    {"do": "obstacles", "stamp": ns, "centers": [[m]]}      of those that move

Events:

    {"event": "refused", "reason": REASON, "what": TEXT}
    {"event": "serving", "distribution": NAME, "rmw": NAME, "domain": ID}
    {"event": "goal", "server": ACTION, "goal": NUMBER, "joints": [NAME], "stamp": ns, "points": [...],
        "path": [[NAME, rad, rad/s, rad/s^2]], "end": ..., "late": s}    to be answered
    {"event": "grip", "server": ACTION, "goal": NUMBER, "position": [m], "effort": N}     to be answered
    {"event": "begin", "goal": NUMBER}                      an accepted goal is to be executed
    {"event": "cancel", "goal": NUMBER}
    {"event": "stream", "topic": TOPIC, "position": [rad]}, or "joints", "stamp" and "points" as of a goal

When its input ends, all goals are aborted.
"""

import os
import queue
import threading
import time
from contextlib import suppress
from functools import partial

from priority import SIMULATING, prioritise_all
from ros2_program import run

KINDS = {"gripper_command": "GripperCommand", "parallel_gripper_command": "ParallelGripperCommand"}
ANSWER = 5.0  # s, within which a goal is answered, else it is refused
OVER = {"do": "end", "status": "ABORTED", "code": -1, "text": "the simulation has ended"}
TURN = 0.001  # s, between looks at a goal that is to be cancelled


def nanoseconds(message):
    """Return a time or duration [ns]."""
    return message.sec * 10**9 + message.nanosec


class ServedAction:
    """An action server whose goals another process decides about and ends."""

    def __init__(self, robot, name, kind):
        from control_msgs import action as actions
        from rclpy.action import ActionServer
        from rclpy.callback_groups import ReentrantCallbackGroup

        self.robot, self.name = robot, name
        self.is_gripper = kind in KINDS
        self.action = getattr(actions, KINDS.get(kind, "FollowJointTrajectory"))
        self.server = ActionServer(
            robot.node,
            self.action,
            name,
            self.follow,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=self.on_goal,
            cancel_callback=self.on_cancel,
        )

    def on_goal(self, request):
        """Ask whether a goal is accepted. A goal is known by the request that it comes with."""
        from rclpy.action import GoalResponse

        number = os.urandom(8).hex()
        orders = self.robot.goals[number] = queue.Queue()
        self.robot.numbers[id(request)] = number
        if self.is_gripper:
            self.robot.tell("grip", server=self.name, goal=number, **grip_of(request.command))
        else:
            self.robot.tell("goal", server=self.name, goal=number, **trajectory_of(request))
        try:
            answer = orders.get(timeout=ANSWER)
        except queue.Empty:
            answer = {"accepted": False, "reason": "the simulation does not answer"}
        if answer.get("accepted"):
            return GoalResponse.ACCEPT
        self.robot.node.get_logger().error(f"{self.name}: {answer.get('reason') or answer.get('text')}")
        del self.robot.goals[number], self.robot.numbers[id(request)]
        return GoalResponse.REJECT

    def on_cancel(self, handle):
        """Tell that a goal is to be cancelled."""
        from rclpy.action import CancelResponse

        number = self.robot.numbers.get(id(handle.request))
        if number is not None:
            self.robot.tell("cancel", goal=number)
        return CancelResponse.ACCEPT

    def follow(self, handle):
        """Publish the progress of a goal until it ends; return the result."""
        number = self.robot.numbers[id(handle.request)]
        orders = self.robot.goals[number]
        self.robot.tell("begin", goal=number)
        try:
            while True:
                order = orders.get()
                if order["do"] == "end":
                    return self.end(handle, order)
                handle.publish_feedback(self.progress(order))
        finally:
            del self.robot.goals[number], self.robot.numbers[id(handle.request)]

    def end(self, handle, order):
        """End a goal; return its result."""
        result = self.action.Result()
        if self.is_gripper:
            fill_gripper(result, order)
        else:
            result.error_code, result.error_string = order["code"], order["text"]
        if order["status"] == "CANCELED":
            until = time.monotonic() + ANSWER
            while not handle.is_cancel_requested and time.monotonic() < until:
                time.sleep(TURN)  # the server notes the request after it was told of it
            handle.canceled()
        elif order["status"] == "SUCCEEDED":
            handle.succeed()
        else:
            handle.abort()
        return result

    def progress(self, order):
        """Return feedback as a message."""
        from trajectory_msgs.msg import JointTrajectoryPoint

        message = self.action.Feedback()
        if self.is_gripper:
            fill_gripper(message, order)
            return message
        set_time(message.header.stamp, order["stamp"])
        message.joint_names = order["joints"]
        for name, state in order["states"].items():
            since = state.pop("time_from_start")
            point = JointTrajectoryPoint(**state)
            set_time(point.time_from_start, since)
            setattr(message, name, point)
        return message


def set_time(message, value):
    message.sec, message.nanosec = divmod(value, 10**9)


def grip_of(command):
    """Return what a gripper is told to do: its position, as a list, and its largest effort, 0 if none is given."""
    if hasattr(command, "max_effort"):
        return {"position": [command.position], "effort": command.max_effort}
    return {"position": list(command.position), "effort": max(command.effort, default=0.0)}


def fill_gripper(message, order):
    """Write the state of a gripper into a feedback or result."""
    position, effort = order.get("position", 0.0), order.get("effort", 0.0)
    if hasattr(message, "state"):
        message.state.position, message.state.effort = [position], [effort]
    else:
        message.position, message.effort = position, effort
    message.stalled, message.reached_goal = order.get("stalled", False), order.get("reached", False)


def trajectory_of(request):
    """Return the goal of a trajectory as text can hold it."""
    tolerances = {
        kind: [[t.name, t.position, t.velocity, t.acceleration] for t in given]
        for kind, given in (("path", request.path_tolerance), ("end", request.goal_tolerance))
    }
    late = nanoseconds(request.goal_time_tolerance) * 1e-9
    return {**points_of(request.trajectory), "late": late, **tolerances}


def points_of(path):
    """Return a trajectory as text can hold it."""
    fields = ("positions", "velocities", "accelerations", "effort")
    points = [
        {"time": nanoseconds(point.time_from_start), **{name: list(getattr(point, name)) for name in fields}}
        for point in path.points
    ]
    return {"joints": list(path.joint_names), "stamp": nanoseconds(path.header.stamp), "points": points}


class RobotNode:
    """Node with the interfaces of a robot."""

    def __init__(self, tell):
        self.tell = tell
        self.goals, self.numbers = {}, {}
        self.node = self.streamed = None
        self.spun = []
        self.states = self.clock = self.message = self.obstacles = None
        self.servers = []

    def serve(self, servers, streams, joint_states, joints, sim_time, obstacles):
        """Join the graph of ROS with all interfaces."""
        import rclpy
        from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
        from rclpy.parameter import Parameter
        from sensor_msgs.msg import JointState

        rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
        simulated = [Parameter("use_sim_time", Parameter.Type.BOOL, True)] if sim_time else []
        self.node = rclpy.create_node("comove_simulated_robot", parameter_overrides=simulated)
        self.states = self.node.create_publisher(JointState, joint_states, 10)
        self.message = JointState(name=joints)
        if sim_time:
            self.serve_clock()
        self.servers = [ServedAction(self, name, kind) for name, kind in servers.items()]
        self.streamed = rclpy.create_node("comove_simulated_streams")
        self.listen(streams)
        if obstacles is not None:
            self.serve_obstacles(obstacles)
        # A goal keeps a thread until it ends, one that is replaced until its end is told.
        # Hundreds of commands a second have one of their own, which takes a tenth of the time.
        executors = MultiThreadedExecutor(4 + 3 * len(servers)), SingleThreadedExecutor()
        for executor, node in zip(executors, (self.node, self.streamed), strict=True):
            executor.add_node(node)
            thread = threading.Thread(target=self.spin, args=(executor,), daemon=True)
            thread.start()
            self.spun.append((executor, thread))
        if not sim_time:  # which waits
            prioritise_all(SIMULATING)
        self.tell(
            "serving",
            distribution=os.environ.get("ROS_DISTRO", ""),
            rmw=rclpy.get_rmw_implementation_identifier(),
            domain=os.environ.get("ROS_DOMAIN_ID", "0"),
        )

    def serve_clock(self):
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rosgraph_msgs.msg import Clock

        quick = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.clock, self.clock_message = self.node.create_publisher(Clock, "/clock", quick), Clock()

    def listen(self, streams):
        """Listen to streams of positions and of short trajectories."""
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        def on_positions(message, topic):
            self.tell("stream", topic=topic, position=list(message.data))

        def on_trajectory(message, topic):
            self.tell("stream", topic=topic, **points_of(message))

        kinds = {
            "positions": (Float64MultiArray, on_positions),
            "trajectory": (JointTrajectory, on_trajectory),
        }
        for topic, kind in streams.items():
            message, take = kinds[kind]
            self.streamed.create_subscription(message, topic, partial(take, topic=topic), 1)  # the newest

    def serve_obstacles(self, topic):
        from geometry_msgs.msg import Pose, PoseArray
        from rclpy.qos import qos_profile_sensor_data

        self.obstacles = self.node.create_publisher(PoseArray, topic, qos_profile_sensor_data)
        self.poses, self.pose = PoseArray(), Pose
        self.poses.header.frame_id = "world"

    def publish_obstacles(self, stamp, centers):
        """Publish the centres of the moving obstacles."""
        set_time(self.poses.header.stamp, stamp)
        self.poses.poses = []
        for center in centers:
            pose = self.pose()
            pose.position.x, pose.position.y, pose.position.z = center
            self.poses.poses.append(pose)
        self.obstacles.publish(self.poses)

    def spin(self, executor):
        from rclpy.executors import ExternalShutdownException

        with suppress(ExternalShutdownException):
            executor.spin()

    def order(self, do, goal, **content):
        """Hand an order to the thread of its goal."""
        orders = self.goals.get(goal)
        if orders is not None:
            orders.put(dict(content, do=do))

    def publish_states(self, stamp, position, velocity, effort):
        """Publish the joint states."""
        message = self.message
        set_time(message.header.stamp, stamp)
        message.position, message.velocity, message.effort = position, velocity, effort
        self.states.publish(message)

    def publish_clock(self, stamp):
        """Publish the simulated time."""
        set_time(self.clock_message.clock, stamp)
        self.clock.publish(self.clock_message)

    def obey(self, do, **content):
        """Execute a command."""
        if do == "serve":
            self.serve(**content)
        elif do == "states":
            self.publish_states(**content)
        elif do == "clock":
            self.publish_clock(**content)
        elif do == "obstacles":
            self.publish_obstacles(**content)
        else:
            self.order(do, **content)

    def close(self):
        """Abort all goals, tell their clients, and leave the graph of ROS."""
        import rclpy

        if not self.spun:
            return
        until = time.monotonic() + 1.0
        for orders in list(self.goals.values()):
            orders.put(dict(OVER))
        while self.goals and time.monotonic() < until:
            time.sleep(0.002)
        time.sleep(0.1)  # for results on their way
        for executor, _ in self.spun:
            executor.shutdown(1.0)
        for server in self.servers:
            server.server.destroy()
        self.node.destroy_node()
        self.streamed.destroy_node()
        rclpy.shutdown()
        for _, thread in self.spun:
            thread.join(1.0)


if __name__ == "__main__":
    run(RobotNode, ("rosgraph_msgs.msg", "std_msgs.msg", "geometry_msgs.msg"))
