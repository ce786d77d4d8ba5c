# ruff: noqa: UP004, UP010, UP024, UP030, UP032, B904, B905
"""Bridge to ROS 1: a program of its own, because ROS brings its own Python (2.7 or 3).

It speaks as `comove.ros.bridges` says. When its input ends for any reason, all goals are cancelled: an arm must not
go on alone.
"""

from __future__ import print_function

import json
import os
import socket
import sys
import threading
import time
import traceback

HEARTBEAT = 1.0  # s; action servers tell their status five times a second
FLUSH = 0.3  # s, that a last cancel has to reach the servers
ACTIVE = (0, 1, 6, 7)  # of actionlib_msgs/GoalStatus: pending, active, preempting, recalling

TOLERANCE = "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"
GOAL = """trajectory_msgs/JointTrajectory trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointTolerance[] goal_tolerance
duration goal_time_tolerance
"""
RESULT = """int32 error_code
int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
string error_string
"""
FEEDBACK = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
ACTION = """control_msgs/FollowJointTrajectoryActionGoal action_goal
control_msgs/FollowJointTrajectoryActionResult action_result
control_msgs/FollowJointTrajectoryActionFeedback action_feedback
"""
ACTION_GOAL = """std_msgs/Header header
actionlib_msgs/GoalID goal_id
control_msgs/FollowJointTrajectoryGoal goal
"""
ACTION_ANSWER = """std_msgs/Header header
actionlib_msgs/GoalStatus status
control_msgs/FollowJointTrajectory{0} {1}
"""
CODES = {
    -1: "the goal is invalid",
    -2: "the joints are not its own",
    -3: "the goal came too late",
    -4: "it left the path by more than its tolerance",
    -5: "it did not reach the goal within its tolerance",
}
SEPARATOR = "\n" + "=" * 80 + "\n"


def message_types():
    """Generate the message classes of FollowJointTrajectory, by name. Not every distribution has control_msgs."""
    from actionlib_msgs.msg import GoalStatus
    from genpy.dynamic import generate_dynamic
    from trajectory_msgs.msg import JointTrajectory

    texts = {
        "JointTolerance": TOLERANCE,
        "FollowJointTrajectoryGoal": GOAL,
        "FollowJointTrajectoryResult": RESULT,
        "FollowJointTrajectoryFeedback": FEEDBACK,
        "FollowJointTrajectoryActionGoal": ACTION_GOAL,
        "FollowJointTrajectoryActionResult": ACTION_ANSWER.format("Result", "result"),
        "FollowJointTrajectoryActionFeedback": ACTION_ANSWER.format("Feedback", "feedback"),
    }
    parts = [ACTION] + ["MSG: control_msgs/" + name + "\n" + text for name, text in texts.items()]
    for known in (JointTrajectory, GoalStatus):  # with what they consist of
        first, _, rest = known._full_text.partition(SEPARATOR)
        parts.append("MSG: " + known._type + "\n" + first)
        parts += [part for part in rest.split(SEPARATOR) if part]
    return generate_dynamic("control_msgs/FollowJointTrajectoryAction", SEPARATOR.join(parts))


class Refused(Exception):
    """Error that keeps a motion from being sent. Its arguments are a reason and its subject."""


class Teller(object):
    """Writer of events to the original output. Prints of ROS go to the error stream and cannot mix with them."""

    def __init__(self):
        self.lock = threading.Lock()
        self.file = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)

    def __call__(self, event, **content):
        line = json.dumps(dict(content, event=event)) + "\n"
        with self.lock:
            try:
                self.file.write(line)
                self.file.flush()
            except (IOError, OSError):  # nobody listens any more; the input ends as well
                pass


class RosBridge(object):
    """Node that sends goals to action servers and listens to joints."""

    def __init__(self, tell):
        self.tell = tell
        self.clients, self.goals, self.heard, self.busy = {}, {}, {}, {}
        self.start = None
        self.closed = set()
        self.guarded = False

    def connect(self, servers, joint_states, joints, timeout, sim_time, grippers):
        """Wait for all servers, then listen to the joints. The parameter use_sim_time says whose time it is."""
        import actionlib
        import rospy
        from actionlib_msgs.msg import GoalStatusArray
        from sensor_msgs.msg import JointState

        for reason, wanted in (("grippers", grippers), ("sim_time", sim_time)):
            if wanted:
                raise Refused(reason, "")
        require_master()
        rospy.init_node("comove", anonymous=True, disable_signals=True)
        until = time.time() + timeout
        while rospy.Time.now().is_zero():  # simulated time
            if time.time() > until:
                raise Refused("clock", "/clock")
            time.sleep(0.01)
        self.types = message_types()
        action = self.types["control_msgs/FollowJointTrajectoryAction"]
        self.clients = {server: actionlib.ActionClient(server, action) for server in servers}
        for server, client in self.clients.items():
            while not client.wait_for_server(rospy.Duration(0.05)):
                if time.time() > until:
                    raise Refused("server", client.ns)
            rospy.Subscriber(client.ns + "/status", GoalStatusArray, self.on_status, server)
            self.watch(server, client.last_status_msg._connection_header["callerid"])
        self.joints = set(joints)
        rospy.Subscriber(joint_states, JointState, self.on_joints, tcp_nodelay=True)
        self.tell("connected")

    def send(self, goals, delay):
        """Send every server its goal, all with one start stamp."""
        import rospy

        messages = {server: self.goal_message(goal) for server, goal in goals.items()}
        self.start = rospy.Time.now() + rospy.Duration(delay)
        for server, message in messages.items():
            message.trajectory.header.stamp = self.start
            self.goals[server] = self.clients[server].send_goal(message, self.on_change(server))
        self.tell("sent")

    def goal_message(self, goal):
        import rospy

        message = self.types["control_msgs/FollowJointTrajectoryGoal"]()
        message.trajectory.joint_names = goal["joints"]
        rows = zip(goal["time"], goal["position"], goal["velocity"], goal["acceleration"])
        for nanoseconds, position, velocity, acceleration in rows:
            point = self.types["trajectory_msgs/JointTrajectoryPoint"]()
            point.time_from_start = rospy.Duration(nanoseconds // 10**9, nanoseconds % 10**9)
            point.positions, point.velocities, point.accelerations = position, velocity, acceleration
            message.trajectory.points.append(point)
        for tolerances, values in (
            (message.path_tolerance, goal["path"]),
            (message.goal_tolerance, goal["end"]),
        ):
            for joint, value in zip(goal["joints"], values):
                if value:
                    tolerances.append(self.types["control_msgs/JointTolerance"](name=joint, position=value))
        message.goal_time_tolerance = rospy.Duration(goal["late"])
        return message

    def guard(self, ids):
        """Be ready to cancel the goals of another bridge. All goals of the servers are, from any sender."""
        self.guarded = bool(ids)

    def beat(self):
        """Do nothing."""

    def cancel(self):
        """Cancel these goals by their ids. Goal handles count a goal as lost that is cancelled before it arrives."""
        from actionlib_msgs.msg import GoalID

        for server, goal in self.goals.items():
            self.clients[server].pub_cancel.publish(GoalID(id=number_of(goal)))
        for client in self.clients.values() if self.guarded else ():
            client.cancel_all_goals()
        self.tell("cancelled")

    def since_start(self, stamp=None):
        """Return the ROS time since the common start [s], or None."""
        import rospy

        if self.start is None:
            return None
        return ((stamp or rospy.Time.now()) - self.start).to_sec()

    def on_change(self, server):
        """Return the callback for changes of a goal's state."""
        from actionlib import CommState, GoalStatus

        names = {
            value: key for key, value in vars(GoalStatus).items() if isinstance(value, int) and key.isupper()
        }

        def tell(goal):
            done = goal.get_comm_state() == CommState.DONE
            status = names[goal.get_terminal_state() if done else goal.get_goal_status()]
            text = goal.get_goal_status_text() or ""
            result = goal.get_result() if done else None
            if result is not None and result.error_code:
                text = result.error_string or CODES.get(result.error_code, text)
                if status == "SUCCEEDED":
                    status = "ABORTED"
            if done or status in ("PENDING", "ACTIVE"):
                self.tell("goal", server=server, status=status, text=text, time=self.since_start())
            if done:
                self.closed.add(server)

        return tell

    def on_joints(self, message):
        import rospy

        position = {n: p for n, p in zip(message.name, message.position) if n in self.joints}
        if position:
            now = rospy.Time.now()
            stamp = message.header.stamp or now
            age = (now - stamp).to_sec()
            self.tell("joints", time=self.since_start(stamp), age=age, position=position)

    def on_status(self, message, server):
        self.heard[server] = time.time()
        if self.start is not None and server not in self.goals:
            return  # a goal is being sent, and its id is not known yet
        own = [number_of(goal) for goal in self.goals.values()]
        busy = any(s.status in ACTIVE and s.goal_id.id not in own for s in message.status_list)
        if busy != self.busy.get(server, False):
            self.busy[server] = busy
            self.tell("busy", server=server, busy=busy)

    def watch(self, server, node):
        """Watch a server's process and report its end. ROS does not report it; a closed connection or silence shows
        it."""
        import rosgraph

        uri = rosgraph.Master("/comove").lookupNode(node)
        address = rosgraph.network.parse_http_host_and_port(uri)

        def wait():
            while connection_ends(address):
                pass  # it only dropped this connection
            self.lose(server, "its node {0} ended".format(node))

        def listen():
            self.heard[server] = time.time()
            while time.time() < self.heard[server] + HEARTBEAT:
                time.sleep(0.05)
            self.lose(server, "its node {0} has said nothing for {1:g} s".format(node, HEARTBEAT))

        for target in (wait, listen):
            thread = threading.Thread(target=target)
            thread.daemon = True
            thread.start()

    def lose(self, server, text):
        if server not in self.closed:
            self.closed.add(server)
            self.tell("goal", server=server, status="LOST", text=text, time=self.since_start())


def number_of(goal):
    """Return the id of a goal."""
    return goal.comm_state_machine.action_goal.goal_id.id


def connection_ends(address):
    """Hold a connection until the other side ends it. Return whether there was a connection."""
    try:
        connection = socket.create_connection(address, 2.0)
    except (IOError, OSError):
        return False
    began = time.time()
    try:
        connection.settimeout(None)
        connection.recv(1)
    except (IOError, OSError):
        pass
    finally:
        connection.close()
    if time.time() - began < 0.01:  # not again and again at once
        time.sleep(0.01)
    return True


def require_master():
    import rosgraph

    uri = rosgraph.get_master_uri()
    try:
        socket.create_connection(rosgraph.network.parse_http_host_and_port(uri), 2.0).close()
    except (IOError, OSError, ValueError):
        raise Refused("master", uri)


def main():
    tell = Teller()
    try:
        import actionlib  # noqa: F401
        import rospy  # noqa: F401
        import sensor_msgs.msg  # noqa: F401
        import trajectory_msgs.msg  # noqa: F401
    except ImportError as error:
        tell("refused", reason="ros", what=str(error))
        return
    bridge = RosBridge(tell)
    try:
        for line in iter(sys.stdin.readline, ""):
            command = json.loads(line)
            getattr(bridge, command.pop("do"))(**command)
    except Refused as refusal:
        reason, what = refusal.args
        tell("refused", reason=reason, what=what)
    except Exception:  # its last line is told
        traceback.print_exc()
    finally:
        bridge.cancel()
        if set(bridge.goals) - bridge.closed or bridge.guarded:
            time.sleep(FLUSH)
        sys.stderr.flush()
        os._exit(0)  # threads of ROS would wait for each other


if __name__ == "__main__":
    main()
