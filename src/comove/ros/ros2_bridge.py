"""Bridge to ROS 2: a program of its own, because every distribution has its own Python (Humble's is 3.10).

It speaks as `comove.ros.bridges` says. It needs rclpy, and the user's own control_msgs. Where it ends, or its input
does, it cancels what it has sent: an arm must not go on alone.
"""

import os
import sys
import time

from ros2_node import STALE, Ros2Node, require_names
from ros2_program import Refused, run

LOOK = 0.1  # s, between looks at the servers
FLUSH = 5.0  # s, for which goals are asked to end that no server has confirmed
BEAT = 1.0  # s without a sign of comove, after which all goals are cancelled
AGAIN = 0.1  # s, after which a cancel without an answer is sent again
KNOWN = (0, 3)  # of action_msgs/srv/CancelGoal: it is cancelled, it has ended
CODES = {
    -1: "the goal is invalid",
    -2: "the joints are not its own",
    -3: "the goal came too late",
    -4: "it left the path by more than its tolerance",
    -5: "it did not reach the goal within its tolerance",
}
ENDS = {4: "SUCCEEDED", 5: "PREEMPTED", 6: "ABORTED"}  # of action_msgs/msg/GoalStatus
ACTIVE = (1, 2, 3)  # accepted, executing, cancelling
FOLLOW = "control_msgs/action/FollowJointTrajectory"


class FollowedServer:
    """An action server of FollowJointTrajectory, and the goal that it has."""

    def __init__(self, bridge, name):
        from action_msgs.msg import GoalStatusArray
        from action_msgs.srv import CancelGoal
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient
        from rclpy.qos import qos_profile_action_status_default

        self.bridge, self.name, self.kind = bridge, name, FollowJointTrajectory
        self.goal = self.heard = self.busy = None
        self.closed, self.guarded, self.status = True, False, ""
        self.client = ActionClient(bridge.node, FollowJointTrajectory, name)
        self.stop = bridge.node.create_client(CancelGoal, name + "/_action/cancel_goal")
        bridge.node.create_subscription(
            GoalStatusArray, name + "/_action/status", self.on_status, qos_profile_action_status_default
        )

    @property
    def ended(self):
        """Return whether the goal is known to have come to its end. A server that is lost may go on with it."""
        return self.closed and self.status != "LOST" and not self.guarded

    @property
    def is_there(self):
        """Return whether the server is in the graph."""
        return self.client.server_is_ready() and self.stop.service_is_ready()

    def cancel(self, number):
        """Ask for the end of a goal by its number; return the future answer."""
        from action_msgs.srv import CancelGoal

        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(bytes.fromhex(number))
        return self.stop.call_async(request)

    def send(self, number, message):
        """Send a goal."""
        from unique_identifier_msgs.msg import UUID

        self.goal, self.closed, self.heard = number, False, None
        self.client.send_goal_async(
            message, feedback_callback=self.on_feedback, goal_uuid=UUID(uuid=list(bytes.fromhex(number)))
        ).add_done_callback(self.on_answer)

    def on_answer(self, future):
        """Tell whether the goal is taken, and wait for its result."""
        handle = future.result()
        if not handle.accepted:
            self.tell("REJECTED", "its log says why", ends=True)
            return
        if self.bridge.stopping:
            self.cancel(self.goal)
        self.tell("ACTIVE")
        handle.get_result_async().add_done_callback(self.on_result)

    def on_result(self, future):
        """Tell the result of the goal."""
        answer = future.result()
        status, text = ENDS.get(answer.status, "LOST"), ""
        if answer.result.error_code:
            text = answer.result.error_string or CODES.get(answer.result.error_code, "")
            status = "ABORTED" if status == "SUCCEEDED" else status
        self.tell(status, text, ends=True)

    def on_feedback(self, _):
        self.heard = time.monotonic()

    def on_status(self, message):
        """Tell whether another client has a goal, when that changes."""
        numbers = [bytes(s.goal_info.goal_id.uuid).hex() for s in message.status_list if s.status in ACTIVE]
        busy = any(number not in self.bridge.numbers for number in numbers)
        if busy != self.busy:
            self.busy = busy
            self.bridge.tell("busy", server=self.name, busy=busy)

    def look(self):
        """Tell that the server is lost, if it is."""
        if self.closed:
            return
        if not self.is_there:
            self.tell("LOST", "it left the graph of ROS", ends=True)
        elif self.heard is not None and time.monotonic() - self.heard > STALE:
            self.tell("LOST", f"its feedback has stopped for {STALE:g} s", ends=True)

    def tell(self, status, text="", ends=False):
        """Tell the status of the goal, unless its end was told. If it is a bad one, all other arms are stopped."""
        if not self.closed:
            self.closed, self.status = ends, status
            if ends and status != "SUCCEEDED":
                self.bridge.stop_all()
            self.bridge.tell(
                "goal", server=self.name, status=status, text=text, time=self.bridge.since_start()
            )


class GripperClient:
    """An action server of a gripper. The newest goal counts."""

    def __init__(self, bridge, arm, kind, action, joint):
        from control_msgs import action as actions
        from rclpy.action import ActionClient

        self.bridge, self.arm, self.kind, self.joint, self.name = bridge, arm, kind, joint, action
        self.number = 0
        names = {"gripper_command": "GripperCommand", "parallel_gripper_command": "ParallelGripperCommand"}
        name = names.get(kind, "FollowJointTrajectory")
        if not hasattr(actions, name):
            raise Refused("control_msgs", f"it has no {name}, which newer distributions have", [])
        self.action = getattr(actions, name)
        self.client = ActionClient(bridge.node, self.action, action)

    @property
    def is_there(self):
        """Return whether the server is in the graph."""
        return self.client.server_is_ready()

    def goal(self, position, effort, seconds):
        """Return a goal as a message."""
        from builtin_interfaces.msg import Duration
        from trajectory_msgs.msg import JointTrajectoryPoint

        message = self.action.Goal()
        if self.kind == "gripper_command":
            message.command.position, message.command.max_effort = position, effort
        elif self.kind == "parallel_gripper_command":
            message.command.name, message.command.position = [self.joint], [position]
            message.command.effort = [effort] if effort else []
        else:
            time = Duration(sec=int(seconds), nanosec=int(seconds % 1.0 * 1e9))
            message.trajectory.joint_names = [self.joint]
            message.trajectory.points = [JointTrajectoryPoint(positions=[position], time_from_start=time)]
        return message

    def send(self, position, effort, seconds, closed):
        """Send a goal."""
        self.number, self.closes = self.number + 1, closed
        number = self.number
        sent = self.client.send_goal_async(self.goal(position, effort, seconds))
        sent.add_done_callback(lambda future: self.on_answer(future, number))

    def on_answer(self, future, number):
        handle = future.result()
        if not handle.accepted:
            self.tell("REJECTED", "its log says why", number)
            return
        self.tell("ACTIVE", "", number)
        handle.get_result_async().add_done_callback(lambda done: self.on_result(done, number))

    def on_result(self, future, number):
        """Tell the result. Fingers that stall while they close have closed on something."""
        answer = future.result()
        status, text = ENDS.get(answer.status, "LOST"), getattr(answer.result, "error_string", "")
        if status in ("ABORTED", "SUCCEEDED") and hasattr(answer.result, "stalled"):
            if self.closes and answer.result.stalled:
                status = "SUCCEEDED"
            elif not self.closes and not answer.result.reached_goal:
                status, text = "ABORTED", text or "it stalled before it was open"
        self.tell(status, text, number)

    def tell(self, status, text, number):
        if number == self.number:
            self.bridge.tell(
                "gripper", arm=self.arm, status=status, text=text, time=self.bridge.since_start()
            )


class Ros2Bridge(Ros2Node):
    """Node that sends goals to action servers and listens to joints."""

    def __init__(self, tell):
        super().__init__(tell)
        self.servers, self.grippers = {}, {}
        self.numbers, self.seen = set(), []
        self.start = None
        self.stopping, self.beaten = False, time.monotonic()

    def open(self, sim_time=False):
        """Join the graph of ROS, and watch the servers."""
        from rclpy.clock import Clock, ClockType

        super().open(sim_time)
        self.node.create_timer(LOOK, self.look_at_servers, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def connect(self, servers, joint_states, joints, timeout, sim_time, grippers):
        """Wait for an answer of each server, and listen to the joints."""
        require_names([*servers, joint_states, *(gripper["action"] for gripper in grippers.values())])
        until = time.monotonic() + timeout
        self.open(sim_time)
        self.listen(joint_states, joints)
        # A client that is made on another thread may be looked at before it is whole.
        self.servers = self.on_thread(lambda: {name: FollowedServer(self, name) for name in servers})
        self.grippers = self.on_thread(
            lambda: {arm: GripperClient(self, arm, **gripper) for arm, gripper in grippers.items()}
        )
        for server in [*self.servers.values(), *self.grippers.values()]:
            while not server.is_there:
                self.wait(until, "server", server.name)
        # A server is found before what it answers finds the way back: only an answer shows that there is one.
        for name, answer in self.asked().items():
            while not answer.done():
                self.wait(until, "answer", name)
        while sim_time and not self.now:
            self.wait(until, "clock", "/clock")
        self.tell("connected")

    def asked(self):
        """Return a future answer of each server: to the question to end a goal that nobody has."""
        return self.on_thread(
            lambda: {name: s.cancel(os.urandom(16).hex()) for name, s in self.servers.items()}
        )

    def look(self, joint_states, timeout):
        """Tell which servers there are, and how soon they answer."""
        import rclpy
        from rclpy.action import get_action_names_and_types

        require_names([joint_states])
        self.open(sim_time=False)
        self.listen(joint_states, None)
        time.sleep(timeout)
        found = sorted(name for name, kinds in get_action_names_and_types(self.node) if FOLLOW in kinds)
        self.servers = self.on_thread(lambda: {name: FollowedServer(self, name) for name in found})
        begun = time.monotonic()
        while not all(s.is_there for s in self.servers.values()) and time.monotonic() - begun < timeout:
            time.sleep(0.002)
        begun = time.monotonic()
        answers, took = self.asked(), {}
        while len(took) < len(answers) and time.monotonic() - begun < timeout:
            took.update(
                {n: time.monotonic() - begun for n, a in answers.items() if a.done() and n not in took}
            )
            time.sleep(0.0005)
        time.sleep(0.2)  # for the status of goals
        seen = list(self.seen)
        lasted = seen[-1][0] - seen[0][0] if seen else 0.0
        servers = [
            {"action": name, "answer": took.get(name), "busy": bool(s.busy)}
            for name, s in self.servers.items()
        ]
        self.tell(
            "seen",
            distribution=os.environ.get("ROS_DISTRO", ""),
            rmw=rclpy.get_rmw_implementation_identifier(),
            domain=os.environ.get("ROS_DOMAIN_ID", "0"),
            python=".".join(map(str, sys.version_info[:3])),
            servers=servers,
            nodes=self.nodes(),
            joints=sorted({name for _, _, names in seen for name in names}),
            rate=(len(seen) - 1) / lasted if lasted > 0.0 else 0.0,
            age=[age for _, age, _ in seen],
        )

    def wait(self, until, reason, subject):
        """Wait a moment; refuse to go on when it is too late."""
        if time.monotonic() > until:
            from rclpy.action import get_action_names_and_types

            found = [name for name, kinds in get_action_names_and_types(self.node) if FOLLOW in kinds]
            own = [server.name for server in self.servers.values() if not server.is_there]
            raise Refused(reason, subject, sorted(set(found) - set(own)))
        time.sleep(0.005)

    def send(self, goals, delay):
        """Send every server its goal, all with one start stamp."""
        from rclpy.duration import Duration

        messages = {name: self.goal_message(name, goal) for name, goal in goals.items()}
        self.numbers.update(goal["id"] for goal in goals.values())
        self.stopping, self.beaten = False, time.monotonic()
        self.start = self.node.get_clock().now() + Duration(seconds=delay)
        for message in messages.values():
            message.trajectory.header.stamp = self.start.to_msg()
        self.on_thread(
            lambda: [self.servers[name].send(goals[name]["id"], m) for name, m in messages.items()]
        )
        self.tell("sent")

    def beat(self):
        """Note that comove goes on."""
        self.beaten = time.monotonic()

    def stop_all(self):
        """Cancel all goals once, on the executor's thread."""
        self.stopping = True
        for server in self.servers.values():
            if server.goal is not None and not server.ended:
                server.cancel(server.goal)

    def grip(self, goals):
        """Send grippers goals, by arm."""
        self.on_thread(lambda: [self.grippers[arm].send(**goal) for arm, goal in goals.items()])

    def goal_message(self, name, goal):
        """Return a goal as a message."""
        from builtin_interfaces.msg import Duration
        from control_msgs.msg import JointTolerance
        from trajectory_msgs.msg import JointTrajectoryPoint

        message = self.servers[name].kind.Goal()
        message.trajectory.joint_names = goal["joints"]
        rows = zip(goal["time"], goal["position"], goal["velocity"], goal["acceleration"], strict=True)
        for nanoseconds, position, velocity, acceleration in rows:
            sec, nanosec = divmod(nanoseconds, 10**9)
            message.trajectory.points.append(
                JointTrajectoryPoint(
                    positions=position,
                    velocities=velocity,
                    accelerations=acceleration,
                    time_from_start=Duration(sec=sec, nanosec=nanosec),
                )
            )
        for field, values in (("path_tolerance", goal["path"]), ("goal_tolerance", goal["end"])):
            by_joint = zip(goal["joints"], values, strict=True)
            setattr(message, field, [JointTolerance(name=name, position=v) for name, v in by_joint if v])
        sec, nanosec = divmod(round(goal["late"] * 1e9), 10**9)
        message.goal_time_tolerance = Duration(sec=sec, nanosec=nanosec)
        return message

    def guard(self, ids):
        """Be ready to cancel these goals, by server, which another bridge sends."""
        for server in self.servers.values():
            server.goal = ids.get(server.name)
            server.guarded = server.goal is not None
        self.numbers.update(ids.values())

    def cancel(self):
        """Cancel these goals by their numbers, answered or not.

        A server may get the question before the goal, which it does not know then and executes: it is asked again.
        """
        self.stopping = True
        sent = [server for server in self.servers.values() if server.goal is not None and not server.ended]
        until, is_told = time.monotonic() + FLUSH, False
        while True:
            answers = self.on_thread(lambda sent=sent: [server.cancel(server.goal) for server in sent])
            if not is_told:
                self.tell("cancelled")
                is_told = True
            asked = min(time.monotonic() + AGAIN, until)
            while not all(answer.done() for answer in answers) and time.monotonic() < asked:
                time.sleep(0.001)
            sent = [s for s, a in zip(sent, answers, strict=True) if not s.ended and not is_known(a)]
            if not sent:
                return
            if time.monotonic() > until:
                self.tell("unstopped", servers=[server.name for server in sent])
                return
            time.sleep(0.02)

    def since_start(self, stamp=None):
        """Return the ROS time since the common start [s], or None."""
        if self.start is None:
            return None
        now = self.now if stamp is None else stamp
        return (now - self.start.nanoseconds) * 1e-9

    def hear(self, position, stamp, now):
        """Tell positions of joints; note them while it only looks."""
        age = (now - stamp) * 1e-9
        if self.joints is None:
            self.seen.append((now * 1e-9, age, list(position)))
        else:
            self.tell("joints", time=self.since_start(stamp), age=age, position=position)

    def look_at_servers(self):
        moves = any(not server.closed for server in self.servers.values())
        if moves and not self.stopping and time.monotonic() - self.beaten > BEAT:
            self.stop_all()
        for server in list(self.servers.values()):
            server.look()

    def close(self):
        """Cancel what still moves, and leave the graph of ROS."""
        if self.executor is not None:
            self.cancel()
            self.leave()


def is_known(answer):
    """Return whether a server answered that the goal ends, or has ended."""
    return answer.done() and answer.result() is not None and answer.result().return_code in KNOWN


if __name__ == "__main__":
    run(Ros2Bridge)
