"""Interfaces of MoveIt 2: a program of its own, run by a Python that has rclpy and moveit_msgs.

It listens to planning scenes, and serves the action of `move_group`, and knows nothing of planning: comove answers
the requests. It reads commands and writes events, one JSON object a line. Messages that comove decodes itself are in
CDR, as base64.

Commands:

    {"do": "watch", "topic": TOPIC, "service": NAME}      listen to planning scenes, and ask for the present one
    {"do": "serve", "action": NAME}
    {"do": "begin", "goal": NUMBER}                       a request is planned for now
    {"do": "end", "goal": NUMBER, "status": STATUS, "code": NUMBER, "text": TEXT, "seconds": s,
        "start": {JOINT: rad}, "joints": [NAME], "points": [[ns, [rad], [rad/s], [rad/s^2]]]}

Events:

    {"event": "refused", "reason": REASON, "what": TEXT}
    {"event": "watching"}, {"event": "serving", "distribution": NAME, "rmw": NAME, "domain": ID}
    {"event": "scene", "data": MESSAGE, "whole": bool, "moved": bool}    moved: it tells nothing but joints
    {"event": "missing", "topic": TOPIC, "topics": [NAME]}               nobody publishes there
    {"event": "goal", "goal": NUMBER, "request": {...}, "only_plan": bool, "more": [MESSAGE]}
    {"event": "cancel", "goal": NUMBER}

The request has the fields of `moveit_msgs/MotionPlanRequest`, without its start and trajectories. What it changes of
the planning scene follows as messages of planning scenes, `more`. When the input ends, all requests are aborted.
"""

import base64
import os
import queue
import threading
import time
from contextlib import suppress

from ros2_node import Ros2Node, require_names
from ros2_program import run

SCENE = "moveit_msgs/msg/PlanningScene"
KEPT = ("start_state", "reference_trajectories")  # fields that comove does not get as they are
ANSWER = 2.0  # s, in which the service tells the planning scene
FIND = 0.2  # s, between looks for who publishes
TURN = 0.001  # s, between looks at a request that is to be cancelled
OVER = {"status": "ABORTED", "code": -1, "text": "comove has ended", "seconds": 0.0}


class MoveItNode(Ros2Node):
    """Node that listens to planning scenes and serves requests for motions."""

    def __init__(self, tell):
        super().__init__(tell)
        self.goals, self.waiting = {}, {}
        self.server = self.client = self.subscription = None
        self.watched = ""

    def watch(self, topic, service):
        """Listen to planning scenes. The present one is asked for."""
        from moveit_msgs.srv import GetPlanningScene
        from rclpy.callback_groups import ReentrantCallbackGroup

        require_names([topic, service])
        self.open(n_threads=4)
        self.watched = topic
        self.client = self.node.create_client(
            GetPlanningScene, service, callback_group=ReentrantCallbackGroup()
        )
        self.listen_to(kept=False)
        threading.Thread(target=self.find, daemon=True).start()
        self.tell("watching")

    def listen_to(self, kept):
        """Listen to planning scenes; to those of before as well, if whoever publishes has `kept` them."""
        from moveit_msgs.msg import PlanningScene
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=100, durability=durability)
        self.subscription = self.node.create_subscription(PlanningScene, self.watched, self.on_scene, quality)
        self.executor.wake()

    def find(self):
        """Wait for publishers or the service; ask, and listen as they publish."""
        from rclpy.qos import DurabilityPolicy

        with suppress(Exception):  # the node has left
            while not (infos := self.node.get_publishers_info_by_topic(self.watched)):
                if self.client.service_is_ready():
                    break
                time.sleep(FIND)
            if infos and all(
                info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for info in infos
            ):
                former = self.subscription
                self.listen_to(kept=True)
                self.node.destroy_subscription(former)
            self.ask()

    def topics(self):
        """Tell which topics of planning scenes there are."""
        found = [name for name, kinds in self.node.get_topic_names_and_types() if SCENE in kinds]
        others = [name for name in found if self.node.count_publishers(name)]
        self.tell("missing", topic=self.watched, topics=sorted(others))

    def on_scene(self, message):
        """Tell a planning scene."""
        self.tell("scene", data=encoded(message), whole=not message.is_diff, moved=is_moved(message))

    def ask(self):
        """Ask the service for the present planning scene, and tell it; where nobody answers, do nothing."""
        from moveit_msgs.srv import GetPlanningScene

        if self.client is None or not self.client.wait_for_service(timeout_sec=FIND):
            return
        request, answered = GetPlanningScene.Request(), threading.Event()
        request.components.components = 2**10 - 1  # all that there is
        future = self.client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if answered.wait(ANSWER) and future.result() is not None:
            message = future.result().scene
            message.is_diff = False
            self.on_scene(message)

    def serve(self, action):
        """Serve requests for motions."""
        import rclpy
        from moveit_msgs.action import MoveGroup
        from rclpy.action import ActionServer, CancelResponse, GoalResponse
        from rclpy.callback_groups import ReentrantCallbackGroup

        require_names([action])
        self.action = MoveGroup
        self.server = ActionServer(
            self.node,
            MoveGroup,
            action,
            self.follow,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=lambda _: GoalResponse.ACCEPT,
            handle_accepted_callback=self.on_goal,
            cancel_callback=lambda handle: self.on_cancel(handle, CancelResponse.ACCEPT),
        )
        self.executor.wake()
        self.tell(
            "serving",
            distribution=os.environ.get("ROS_DISTRO", ""),
            rmw=rclpy.get_rmw_implementation_identifier(),
            domain=os.environ.get("ROS_DOMAIN_ID", "0"),
        )

    def on_goal(self, handle):
        """Tell a request, after what the planning scene is now."""
        number = bytes(handle.goal_id.uuid).hex()
        self.waiting[number], self.goals[number] = handle, queue.Queue()
        threading.Thread(target=self.tell_goal, args=(number, handle.request), daemon=True).start()

    def tell_goal(self, number, goal):
        request, change = goal.request, goal.planning_options.planning_scene_diff
        with suppress(Exception):  # without an answer, what was heard before stands
            self.ask()
        given = {name: fields(getattr(request, name)) for name in names_in(request) if name not in KEPT}
        more = [] if is_empty(change) else [change]
        if not is_empty_state(request.start_state):
            start = type(change)(is_diff=True, robot_state=request.start_state)
            more.append(start)
        self.tell(
            "goal",
            goal=number,
            request=given,
            only_plan=bool(goal.planning_options.plan_only),
            more=[encoded(message) for message in more],
        )

    def on_cancel(self, handle, answer):
        """Tell that a request is to be cancelled."""
        self.tell("cancel", goal=bytes(handle.goal_id.uuid).hex())
        return answer

    def follow(self, handle):
        """Wait until a request is answered; return the result."""
        number = bytes(handle.goal_id.uuid).hex()
        self.show(handle, "PLANNING")
        try:
            order = self.goals[number].get()
            return self.ended(handle, **order)
        finally:
            self.goals.pop(number, None)

    def show(self, handle, state):
        feedback = self.action.Feedback()
        feedback.state = state
        handle.publish_feedback(feedback)

    def ended(self, handle, status, code, text, seconds, start=None, joints=(), points=()):
        """End a request; return its result."""
        result = self.action.Result()
        result.error_code.val, result.planning_time = code, seconds
        if hasattr(result.error_code, "message"):  # moveit_msgs 2.5 and later
            result.error_code.message, result.error_code.source = text, "comove"
        if status != "SUCCEEDED":
            self.node.get_logger().error(text)
        fill_state(result.trajectory_start, start or {})
        fill_trajectory(result.planned_trajectory.joint_trajectory, joints, points)
        self.show(handle, "IDLE")
        if status == "CANCELED":
            until = time.monotonic() + ANSWER
            while not handle.is_cancel_requested and time.monotonic() < until:
                time.sleep(TURN)  # the server notes the request after it was told of it
            handle.canceled()
        elif status == "SUCCEEDED":
            handle.succeed()
        else:
            handle.abort()
        return result

    def begin(self, goal):
        """Begin to execute a request that was accepted."""
        handle = self.waiting.pop(goal, None)
        if handle is not None:
            handle.execute()

    def end(self, goal, **order):
        """Answer a request, one that has not begun as well."""
        if goal in self.goals:
            self.goals[goal].put(order)
            self.begin(goal)

    def close(self):
        """Abort all requests, tell their clients, and leave the graph of ROS."""
        if self.node is None:
            return
        for goal in list(self.goals):
            self.end(goal, **OVER)
        until = time.monotonic() + 1.0
        while self.goals and time.monotonic() < until:
            time.sleep(0.002)
        time.sleep(0.1)  # for results on their way
        self.executor.shutdown(1.0)
        if self.server is not None:
            self.server.destroy()
        self.leave()


def names_in(message):
    """Return the names of a message's fields."""
    return list(message.get_fields_and_field_types())


def fields(value):
    """Return a message as text can hold it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: fields(getattr(value, name)) for name in names_in(value)}
    if isinstance(value, bytes):  # a field of type byte
        return int.from_bytes(value, "little")
    if isinstance(value, (str, bool, int, float)):
        return value
    return [fields(one) for one in (value.tolist() if hasattr(value, "tolist") else value)]


def encoded(message):
    """Return a message in CDR, as base64."""
    from rclpy.serialization import serialize_message

    return base64.b64encode(serialize_message(message)).decode()


def is_empty_state(state):
    """Return whether a state says nothing, as `moveit::core::isEmpty` does."""
    joints = state.joint_state.name, state.multi_dof_joint_state.joint_names
    return not any((*joints, state.attached_collision_objects))


def is_moved(scene):
    """Return whether a planning scene tells nothing but joints."""
    told = (
        scene.world.collision_objects,
        scene.robot_state.attached_collision_objects,
        scene.fixed_frame_transforms,
        scene.allowed_collision_matrix.entry_names,
        scene.link_padding,
        scene.link_scale,
        scene.world.octomap.octomap.id,
    )
    return scene.is_diff and not any(map(len, told))


def is_empty(scene):
    """Return whether a planning scene, whole or not, says nothing."""
    was, scene.is_diff = scene.is_diff, True
    empty = is_moved(scene) and is_empty_state(scene.robot_state)
    scene.is_diff = was
    return empty


def fill_state(state, joints):
    """Write joints, by name, into a state."""
    state.joint_state.name, state.joint_state.position = list(joints), list(joints.values())
    state.is_diff = True  # what is attached stays


def fill_trajectory(message, joints, points):
    """Write joints by time into a trajectory."""
    from builtin_interfaces.msg import Duration
    from trajectory_msgs.msg import JointTrajectoryPoint

    message.joint_names = list(joints)
    for at, position, velocity, acceleration in points:
        sec, nanosec = divmod(at, 10**9)
        message.points.append(
            JointTrajectoryPoint(
                positions=position,
                velocities=velocity,
                accelerations=acceleration,
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )


if __name__ == "__main__":
    run(MoveItNode, ("shape_msgs.msg",), "moveit_msgs")
