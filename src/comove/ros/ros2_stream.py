"""Bridge that streams joint commands to ROS 2.

It listens to joints and obstacles, and speaks as `comove.ros.streams` says.

A thread of its own plays the commands, one a period. It brakes all arms where the next one is late, where the joints
have been silent, and where its input ends.
"""

import os
import signal
import threading
import time
import traceback
from contextlib import suppress
from importlib import import_module

from command_player import CommandPlayer
from priority import PLAYING, prioritise_all
from ros2_node import Ros2Node, names_of, nanoseconds, require_names
from ros2_program import Refused, run

POSITIONS, TRAJECTORY = "std_msgs/msg/Float64MultiArray", "trajectory_msgs/msg/JointTrajectory"
CLOUD = "sensor_msgs/msg/PointCloud2"
HORIZON = 0.02  # s, between short trajectories
LOOK = 0.5  # s, between looks at who else commands
ASKED = 3.0  # s, for a controller to tell its joints
UNKNOWN = "NODE_NAME_UNKNOWN"  # in the names of nodes that the graph does not know yet
LATE = 3.0  # periods, by which commands may be played too late
TOLD = 0.1  # s, between reports of what was played
LEAVING = 5.0  # s, in which arms come to rest when the input has ended


class Stream:
    """Commands of some joints on a topic.

    Parameters
    ----------
    node : node of rclpy
    topic, kind : name and type of the topic
    joints : names of the joints
    columns : places of the joints among all
    period : time between commands [s]
    """

    def __init__(self, node, topic, kind, joints, columns, period):
        self.kind, self.joints, self.columns, self.period = kind, joints, columns, period
        self.message = message_type(kind)
        self.publisher = node.create_publisher(self.message, topic, 1)
        self.every = 1 if kind == POSITIONS else max(1, round(HORIZON / period))

    def publish(self, position, horizon):
        """Publish all joints, lists; `horizon` is a function that returns those of the next periods."""
        if self.kind == POSITIONS:
            self.publisher.publish(self.message(data=[position[c] for c in self.columns]))
        else:
            self.publisher.publish(self.trajectory(position, horizon()))

    def trajectory(self, position, coming):
        """Return a trajectory through the next positions, which ends at rest."""
        from trajectory_msgs.msg import JointTrajectoryPoint

        rows = [[row[c] for c in self.columns] for row in (position, *coming)]
        last = len(rows) - 1
        message = self.message(joint_names=self.joints)
        for k in range(1, last + 1):
            after = rows[min(k + 1, last)]
            rates = [0.5 * (z - x) / self.period for x, z in zip(rows[k - 1], after, strict=True)]
            point = JointTrajectoryPoint(
                positions=rows[k], velocities=[0.0] * len(rates) if k == last else rates
            )
            since = round(k * self.period * 1e9)
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(since, 10**9)
            message.points.append(point)
        return message


class MeasuredJoints:
    """Joints as measured last, and when, in the order of commands."""

    def __init__(self, order):
        self.order, self.at, self.position = order, {}, {}

    def take(self, position):
        """Note positions by name."""
        self.at.update(dict.fromkeys(position, time.monotonic()))
        self.position.update(position)

    def silence(self):
        """Return the time since the joint heard least recently was measured [s]."""
        return time.monotonic() - min(self.at.values())

    def missing(self):
        """Return the names of joints that were never measured."""
        return sorted(set(self.order) - set(self.position))

    def row(self):
        """Return all positions."""
        return [self.position[name] for name in self.order]


class Ros2Stream(Ros2Node):
    """Node that plays commands."""

    def __init__(self, tell):
        super().__init__(tell)
        self.streams, self.player, self.measured = [], None, MeasuredJoints([])
        self.lock, self.over = threading.Lock(), threading.Event()
        self.period = self.silence = 0.0
        self.playing = None

    def connect(self, topics, joint_states, joints, period, silence, obstacles, timeout):
        """Find who listens to each topic, and listen to joints and obstacles.

        Parameters
        ----------
        topics : joints by topic
        joints : all joints, in the order of commands
        silence : time without joints after which the arms brake [s]
        obstacles : topic of the obstacles, or None
        """
        require_names([*topics, joint_states, *([] if obstacles is None else [obstacles])])
        begun = time.monotonic()
        until = begun + timeout
        self.period, self.silence, self.measured = period, silence, MeasuredJoints(joints)
        self.open()
        self.listen(joint_states, joints)
        for topic, moved in topics.items():
            kind = self.found(topic, self.node.get_subscriptions_info_by_topic, "stream", until)
            if kind not in (POSITIONS, TRAJECTORY):
                raise Refused("kind", topic, [kind])
            columns = [joints.index(name) for name in moved]
            self.streams.append(Stream(self.node, topic, kind, moved, columns, period))
        for stream in self.streams:
            while not stream.publisher.get_subscription_count():
                wait(until, "stream", stream.publisher.topic_name)
        tells = None
        if obstacles is not None:
            tells = self.found(obstacles, self.node.get_publishers_info_by_topic, "obstacles", until)
            if tells not in (*CENTERS, CLOUD):
                raise Refused("obstacle_kind", obstacles, [tells])
            if tells != CLOUD:  # which takes too long to read here
                self.watch(obstacles, tells)
        while missing := self.measured.missing():
            wait(until, "joints", missing[0], sorted(self.measured.position))
        for stream in self.streams:
            order = self.order_of(stream.publisher.topic_name) if stream.kind == POSITIONS else []
            if order and sorted(order) != sorted(stream.joints):
                raise Refused("order", stream.publisher.topic_name, order)
            stream.columns = [joints.index(name) for name in order or stream.joints]
        while time.monotonic() - begun < LOOK:  # others are found as late
            time.sleep(0.01)
        for topic, nodes in self.others():
            raise Refused("commanded", topic, nodes)
        self.node.create_timer(LOOK, self.look)
        self.tell("connected", kinds=sorted({stream.kind for stream in self.streams}), obstacles=tells)

    def found(self, topic, ends, reason, until):
        """Return the type of a topic, when it has another end."""
        while not (infos := ends(topic)):
            kinds = self.node.get_topic_names_and_types()
            wait(
                until,
                reason,
                topic,
                sorted(n for n, types in kinds if {POSITIONS, TRAJECTORY, CLOUD, *CENTERS} & {*types}),
            )
        return infos[0].topic_type

    def order_of(self, topic):
        """Return the joints that a topic's controller moves, in its order; empty where it does not tell."""
        from rcl_interfaces.srv import GetParameters

        until, nodes = time.monotonic() + ASKED, [UNKNOWN]
        while UNKNOWN in nodes[0] and time.monotonic() < until:  # ends are known before their nodes
            nodes = names_of(self.node.get_subscriptions_info_by_topic(topic)) or [UNKNOWN]
            time.sleep(0.01)
        service = f"{nodes[0]}/get_parameters"
        client = self.on_thread(lambda: self.node.create_client(GetParameters, service))
        while not client.service_is_ready():
            if time.monotonic() > until:
                return []
            time.sleep(0.01)
        answer = self.on_thread(lambda: client.call_async(GetParameters.Request(names=["joints"])))
        while not answer.done() and time.monotonic() < until:
            time.sleep(0.01)
        told = answer.result().values if answer.done() and answer.result() is not None else []
        return list(told[0].string_array_value) if told else []

    def others(self):
        """Return topics that other nodes command, with the nodes."""
        for stream in self.streams:
            topic = stream.publisher.topic_name
            nodes = names_of(self.node.get_publishers_info_by_topic(topic))
            nodes.remove(self.node.get_fully_qualified_name())
            if nodes:
                yield topic, nodes

    def look(self):
        """Brake if another node commands the arms."""
        for topic, nodes in self.others():
            self.brake(f"{nodes[0]} commands '{topic}' as well")
            self.tell("commanded", topic=topic, nodes=nodes)

    def watch(self, topic, kind):
        """Listen to obstacles."""
        from rclpy.qos import qos_profile_sensor_data

        centers = CENTERS[kind]()

        def on_message(message):
            stamp, frame, found = centers(message)
            if found:  # changes of a planning scene may concern others
                counted = kind == "geometry_msgs/msg/PoseArray"
                self.tell("obstacles", time=self.instant(stamp), frame=frame, centers=found, counted=counted)

        self.node.create_subscription(message_type(kind), topic, on_message, qos_profile_sensor_data)

    def hear(self, position, stamp, now):
        """Note the joints, and tell them."""
        with self.lock:
            self.measured.take(position)
        age = (now - stamp) * 1e-9
        self.tell("joints", time=time.monotonic() - age, age=age, position=position)

    def begin(self, position, velocity, acceleration):
        """Begin to play at joints where the robot rests."""
        self.player = CommandPlayer(position, self.period, velocity, acceleration)
        self.playing = threading.Thread(target=self.play, daemon=True)
        self.playing.start()
        prioritise_all(PLAYING)

    def follow(self, run, number, position):
        """Take the next command."""
        with self.lock:
            self.player.put(run, number, position)

    def brake(self, why):
        """Come to rest."""
        with self.lock:
            if self.player is not None:
                self.player.brake(why)

    def play(self):
        """Play commands until the end. Where that fails, the process ends: nobody would know otherwise."""
        try:
            self.play_all()
        except Exception:
            traceback.print_exc()
            os.kill(os.getpid(), signal.SIGTERM)

    def play_all(self):
        """Play commands until the end."""
        log = PlayedLog(self.tell, max(1, round(TOLD / self.period)))
        player, due, last, k = self.player, time.monotonic(), 0.0, 0
        told, every = player.run - 1, [stream.every for stream in self.streams]
        while not self.over.is_set():
            # What is late is caught up at twice the speed, not at once.
            due = max(due + self.period, last + 0.5 * self.period)
            time.sleep(max(0.0, due - time.monotonic()))
            last = time.monotonic()
            if last - due > LATE * self.period:
                due = last
                self.brake("the bridge was late")
            if self.measured.silence() > self.silence:
                self.brake("the joints are silent")
            with self.lock:
                position, number = player.tick()
                horizon = player.horizon() if max(every) > 1 and k % max(every) == 0 else None
                measured, run = self.measured.row(), player.run
                braked = player.why if player.has_braked else ""
            for stream in self.streams:
                if stream.every == 1 or k % stream.every == 0:
                    stream.publish(position, lambda horizon=horizon: horizon)
            log.add(time.monotonic(), number, run, position, measured)
            if braked and told != run:
                told = run
                log.tell_all()
                self.tell("braked", run=run, why=braked, position=position)
            k += 1
        log.tell_all()
        self.tell("played_all")

    def close(self):
        """Play what has come, brake, and leave the graph of ROS."""
        if self.executor is None:
            return
        if self.playing is not None and self.playing.is_alive():
            until = time.monotonic() + LEAVING
            while not self.player.is_resting and time.monotonic() < until:  # no command comes: it brakes
                time.sleep(self.period)
            time.sleep(2.0 * max(HORIZON, self.period))  # the last command is played
            self.over.set()
            self.playing.join(1.0)
        self.leave()


class PlayedLog:
    """Report of what was played, told `size` periods at a time."""

    def __init__(self, tell, size):
        self.tell, self.size, self.rows = tell, size, []

    def add(self, *row):
        """Add a period."""
        self.rows.append(row)
        if len(self.rows) >= self.size:
            self.tell_all()

    def tell_all(self):
        """Tell what has not been told."""
        rows, self.rows = self.rows, []
        if rows:
            names = ("time", "number", "run", "commanded", "measured")
            self.tell("played", **dict(zip(names, zip(*rows, strict=True), strict=True)))


def message_type(kind):
    """Return the class of a message by the name of its type."""
    package, _, name = kind.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), name)


def wait(until, reason, subject, found=()):
    """Wait a moment; refuse to go on when it is too late."""
    if time.monotonic() > until:
        raise Refused(reason, subject, list(found))
    time.sleep(0.01)


def place_of(pose):
    """Return the position of a pose as a list [m]."""
    return [pose.position.x, pose.position.y, pose.position.z]


def centers_of_poses(message):
    """Return stamp [ns], frame, and centres by number."""
    places = {str(i): place_of(pose) for i, pose in enumerate(message.poses)}
    return nanoseconds(message.header.stamp), message.header.frame_id, places


def oldest(items):
    """Return the oldest stamp of some [ns], 0 if none has one."""
    stamps = [nanoseconds(item.header.stamp) for item in items]
    return min((stamp for stamp in stamps if stamp), default=0)


def centers_of_markers(message):
    """Return the oldest stamp [ns], frame, and centres. Names are namespaces, or numbers without one.

    Markers that share a namespace are called by it and their numbers.
    """
    there = [marker for marker in message.markers if marker.action == marker.ADD]
    stamp = oldest(there)
    frames = sorted({marker.header.frame_id for marker in there})
    spaces = [m.ns for m in there]
    names = [(f"{m.ns}/{m.id}" if spaces.count(m.ns) > 1 else m.ns) if m.ns else str(m.id) for m in there]
    return stamp, ", ".join(frames), dict(zip(names, (place_of(m.pose) for m in there), strict=True))


class ObjectCenters:
    """Centres of collision objects: those of their first shapes.

    An object that only moves tells no shapes; it keeps those that it told last.
    """

    def __init__(self):
        self.inner = {}

    def of_scene(self, message):
        """Return oldest stamp [ns], frame, and centres of a planning scene."""
        return self.of(message.world.collision_objects)

    def of_one(self, message):
        """Return these of a collision object."""
        return self.of([message])

    def of(self, objects):
        there = [item for item in objects if item.operation != item.REMOVE]
        frames = sorted({item.header.frame_id for item in there})
        return oldest(there), ", ".join(frames), {item.id: self.center(item) for item in there}

    def center(self, item):
        """Return the centre of an object."""
        for name in ("primitive_poses", "mesh_poses"):
            if shapes := getattr(item, name):
                self.inner[item.id] = place_of(shapes[0])
                break
        return turned(item.pose, self.inner.get(item.id, [0.0, 0.0, 0.0]))


def turned(pose, p):
    """Return a point of a frame at a pose.

    p + 2 w (u x p) + 2 u x (u x p), Rodrigues for a unit quaternion.
    """
    q, at = pose.orientation, place_of(pose)
    size = (q.x**2 + q.y**2 + q.z**2 + q.w**2) or 1.0
    w, u = (q.w if (q.x or q.y or q.z or q.w) else 1.0), (q.x, q.y, q.z)
    c = cross(u, p)
    return [a + x + 2.0 * (w * y + z) / size for a, x, y, z in zip(at, p, c, cross(u, c), strict=True)]


def cross(u, v):
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


CENTERS = {
    "geometry_msgs/msg/PoseArray": lambda: centers_of_poses,
    "visualization_msgs/msg/MarkerArray": lambda: centers_of_markers,
    "moveit_msgs/msg/PlanningScene": lambda: ObjectCenters().of_scene,
    "moveit_msgs/msg/CollisionObject": lambda: ObjectCenters().of_one,
}
"""Functions that return a reader of messages, by their type."""


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        run(Ros2Stream, ("std_msgs.msg", "geometry_msgs.msg"))
