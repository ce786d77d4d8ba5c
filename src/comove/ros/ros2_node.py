"""What bridges to ROS 2 share: a node of their own, and the joints to which it listens."""

import os
import signal
import threading
import time
import traceback

from ros2_program import Refused

STALE = 1.0  # s, after which feedback is missing, and another sender of a joint counts no more


class Ros2Node:
    """Node that listens to joints, spun by a thread of its own.

    Parameters
    ----------
    tell : Teller
    """

    def __init__(self, tell):
        self.tell = tell
        self.joints, self.tellers, self.topic = set(), {}, ""
        self.node = self.executor = self.thread = None

    def obey(self, do, **content):
        """Execute a command."""
        getattr(self, do)(**content)

    def open(self, sim_time=False, n_threads=1):
        """Join the graph of ROS. More than one thread may call back at once."""
        import rclpy
        from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
        from rclpy.parameter import Parameter

        rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
        simulated = [Parameter("use_sim_time", Parameter.Type.BOOL, True)] if sim_time else []
        self.node = rclpy.create_node(f"comove_{os.getpid()}", parameter_overrides=simulated)
        self.executor = SingleThreadedExecutor() if n_threads == 1 else MultiThreadedExecutor(n_threads)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.spin, daemon=True)
        self.thread.start()

    def spin(self):
        from rclpy.executors import ExternalShutdownException

        try:
            self.executor.spin()
        except ExternalShutdownException:
            return
        except Exception:  # nothing would be heard any more
            traceback.print_exc()
            os.kill(os.getpid(), signal.SIGTERM)

    def on_thread(self, work):
        """Return what `work` does on the executor's thread. An answer may be lost that comes while another thread has
        sent a request and not yet noted its number."""
        done = self.executor.create_task(work)
        while not done.done():
            if not self.thread.is_alive():
                return work()
            time.sleep(0.0005)
        return done.result()

    @property
    def now(self):
        """Return the time of ROS [ns]."""
        return self.node.get_clock().now().nanoseconds

    def instant(self, stamp):
        """Return the instant of a stamp [ns] by the monotonic clock [s]; of a stamp of 0, the present one."""
        now = self.now
        return time.monotonic() - (now - (stamp or now)) * 1e-9

    def listen(self, joint_states, joints):
        """Listen to joints; to all if `joints` is None."""
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.joints, self.topic = None if joints is None else set(joints), joint_states
        self.node.create_subscription(
            JointState, joint_states, self.joints_callback(), qos_profile_sensor_data
        )

    def joints_callback(self):
        """Return the callback for joint states. It knows their senders where rclpy tells them."""
        from rclpy.subscription import Subscription

        if hasattr(Subscription, "CallbackType"):
            return lambda message, info: self.on_joints(message, info)
        return lambda message: self.on_joints(message, {})

    def on_joints(self, message, info):
        told = zip(message.name, message.position, strict=False)
        position = {n: p for n, p in told if self.joints is None or n in self.joints}
        if not position:
            return
        sender = info.get("publisher_gid") if isinstance(info, dict) else None
        if sender is not None:
            self.compare(position, bytes(sender["data"]))
        now = self.now
        self.hear(position, nanoseconds(message.header.stamp) or now, now)

    def hear(self, position, stamp, now):
        """Take in joints. `position` is by name [rad], `stamp` and `now` are times [ns]."""
        raise NotImplementedError

    def compare(self, position, sender):
        """Tell a joint that has two senders."""
        now = time.monotonic()
        for joint in position:
            before, heard = self.tellers.get(joint, (sender, now))
            if before != sender and now - heard < STALE and None not in self.tellers:
                self.tellers[None] = sender, now  # it is told once
                self.tell("conflict", joint=joint, nodes=self.nodes())
            self.tellers[joint] = sender, now

    def nodes(self):
        """Return the nodes that tell joint states."""
        return names_of(self.node.get_publishers_info_by_topic(self.topic))

    def leave(self):
        """Leave the graph of ROS: a node that is killed delays the next one."""
        import rclpy

        self.node.destroy_node()
        rclpy.shutdown()
        if self.thread is not None:
            self.thread.join(2.0)


def nanoseconds(message):
    """Return a time or duration [ns]."""
    return message.sec * 10**9 + message.nanosec


def names_of(infos):
    """Return the names of nodes with some ends of a topic."""
    return sorted({info.node_namespace.rstrip("/") + "/" + info.node_name for info in infos})


def require_names(names):
    """Refuse names that ROS does not take."""
    from rclpy.exceptions import InvalidTopicNameException
    from rclpy.validate_topic_name import validate_topic_name

    for name in names:
        try:
            validate_topic_name(name)
        except InvalidTopicNameException as error:
            raise Refused("name", name, [str(error).splitlines()[0]]) from None
