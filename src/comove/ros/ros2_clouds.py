"""Program that fits moving obstacles to point clouds in ROS 2.

It speaks as `comove.ros.clouds` says. A cloud takes longer than a command's period, so the process that plays
commands must not read it.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of numpy, whose threads would wait for each other

from contextlib import suppress

from ros2_node import Ros2Node, nanoseconds
from ros2_program import run


class Ros2Clouds(Ros2Node):
    """Node that listens to clouds."""

    def __init__(self, tell):
        super().__init__(tell)
        self.tracks = None

    def watch(self, topic, noise, moving, still):
        """Listen to clouds.

        Parameters
        ----------
        noise : standard deviation of points and centres [m]
        moving : obstacles that are looked for, by name
        still : static obstacles, whose points are left out
        """
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from ros2_tracks import CloudTracks
        from sensor_msgs.msg import PointCloud2

        self.tracks = CloudTracks(moving, still, noise)
        self.open()
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.node.create_subscription(PointCloud2, topic, self.on_cloud, newest)
        self.tell("watching")

    def begin(self, time):
        """Let obstacles turn from an instant by the monotonic clock [s]."""
        self.tracks.zero = time

    def on_cloud(self, message):
        """Tell where those obstacles are that a cloud shows."""
        at, frame = self.instant(nanoseconds(message.header.stamp)), message.header.frame_id
        centers, unseen = self.tracks.update(message, at)
        if centers:
            self.tell("obstacles", time=at, frame=frame, centers=centers)
        if unseen:
            self.tell("unseen", time=at, frame=frame, why=unseen)

    def close(self):
        """Leave the graph of ROS."""
        if self.executor is not None:
            self.leave()


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        run(Ros2Clouds, ("numpy",))
