"""Bridge that streams joint commands to ROS 2.

It listens to joints and obstacles, and speaks as `comove.ros.streams` says.

A thread of its own plays the commands, one a period. It brakes all arms where the next one is late, where the joints
have been silent, and where its input ends.
"""

import threading
import time
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
    """Joints as measured last, in the order of commands, and when."""

    def __init__(self, order):
        self.order, self.at, self.position = order, 0.0, {}

    def take(self, position):
        """Note positions by name."""
        self.at = time.monotonic()
        self.position.update(position)

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

        centers = CENTERS[kind]

        def on_message(message):
            stamp, frame, found = centers(message)
            self.tell("obstacles", time=self.instant(stamp), frame=frame, centers=found)

        self.node.create_subscription(message_type(kind), topic, on_message, qos_profile_sensor_data)

    def hear(self, position, stamp, now):
        """Note the joints, and tell them."""
        with self.lock:
            self.measured.take(position)
        age = (now - stamp) * 1e-9
        self.tell("joints", time=self.measured.at - age, age=age, position=position)

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
        """Play commands until the end."""
        log = PlayedLog(self.tell, max(1, round(TOLD / self.period)))
        player, due, k = self.player, time.monotonic(), 0
        told, every = player.run - 1, [stream.every for stream in self.streams]
        while not self.over.is_set():
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
            if time.monotonic() - self.measured.at > self.silence:
                self.brake("the joints are silent")
            with self.lock:
                position, number = player.tick()
                horizon = player.horizon() if max(every) > 1 and k % max(every) == 0 else None
                measured = self.measured.row()
            for stream in self.streams:
                if stream.every == 1 or k % stream.every == 0:
                    stream.publish(position, lambda horizon=horizon: horizon)
            log.add(time.monotonic(), number, player.run, position, measured)
            if player.has_braked and told != player.run:
                told = player.run
                log.tell_all()
                self.tell("braked", run=player.run, why=player.why, position=player.position)
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


def centers_of_markers(message):
    """Return the newest stamp [ns], frame, and centres. Names are namespaces, or numbers without one."""
    there = [marker for marker in message.markers if marker.action == marker.ADD]
    stamp = max((nanoseconds(marker.header.stamp) for marker in there), default=0)
    frames = sorted({marker.header.frame_id for marker in there})
    return stamp, ", ".join(frames), {m.ns or str(m.id): place_of(m.pose) for m in there}


def centers_of_objects(objects):
    """Return the newest stamp [ns], frame, and centres of collision objects."""
    there = [item for item in objects if item.operation != item.REMOVE]
    stamp = max((nanoseconds(item.header.stamp) for item in there), default=0)
    frames = sorted({item.header.frame_id for item in there})
    return stamp, ", ".join(frames), {item.id: center_of_object(item) for item in there}


def center_of_object(item):
    """Return the centre of a collision object: that of its first shape."""
    for name in ("primitive_poses", "mesh_poses"):
        shapes = getattr(item, name)
        if shapes:
            q, p, at = item.pose.orientation, place_of(shapes[0]), place_of(item.pose)
            size = (q.x**2 + q.y**2 + q.z**2 + q.w**2) or 1.0
            w = q.w if (q.x or q.y or q.z or q.w) else 1.0
            # p + 2 w (u x p) + 2 u x (u x p), Rodrigues for a unit quaternion
            u = (q.x, q.y, q.z)
            c = cross(u, p)
            cc = cross(u, c)
            return [a + x + 2.0 * (w * y + z) / size for a, x, y, z in zip(at, p, c, cc, strict=True)]
    return place_of(item.pose)


def cross(u, v):
    return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])


CENTERS = {
    "geometry_msgs/msg/PoseArray": centers_of_poses,
    "visualization_msgs/msg/MarkerArray": centers_of_markers,
    "moveit_msgs/msg/PlanningScene": lambda message: centers_of_objects(message.world.collision_objects),
    "moveit_msgs/msg/CollisionObject": lambda message: centers_of_objects([message]),
}


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        run(Ros2Stream, ("std_msgs.msg", "geometry_msgs.msg"))
