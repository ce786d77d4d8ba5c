"""Moving obstacles by their names, out of point clouds in ROS 2.

`ros2_clouds.py` runs under ROS's own Python and fits known shapes to the clouds, in a process of its own: nothing
that commands arms waits for it. Commands to it:

    {"do": "watch", "topic": TOPIC, "noise": m, "moving": {NAME: {SHAPE, "center": [m], "spin": [rad/s]}},
        "still": [{SHAPE, "center": [m]}]}
    {"do": "begin", "time": s}                            from when on obstacles turn

A SHAPE has the entries "reach": m and "solids": [{"kind": KIND, "size": [m], "axes": [[...]], "planes": [[...]]}], as
`comove.ros.cloud_fits` has them. Events, with instants by the system's monotonic clock:

    {"event": "watching"}
    {"event": "obstacles", "time": s, "frame": NAME, "centers": {NAME: [m]}}
    {"event": "unseen", "time": s, "frame": NAME, "why": {NAME: TEXT}}
    {"event": "refused", ...}                             as in `comove.ros.bridges`
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import SendError
from comove.geometry import distances as sd
from comove.model.scene import Scene
from comove.ros.bridges import Event
from comove.ros.clients import started

PROGRAM = Path(__file__).with_name("ros2_clouds.py")
CLOUD = "sensor_msgs/msg/PointCloud2"
STARTING = 20.0  # s, for a Python to load ROS
KINDS = {
    sd.BOX: "box",
    sd.SPHERE: "sphere",
    sd.CAPSULE: "capsule",
    sd.CYLINDER: "cylinder",
    sd.POLYTOPE: "polytope",
}


class ObstacleClouds:
    """Program that fits obstacles to clouds.

    Parameters
    ----------
    topic : topic of the clouds
    scene : scene of the obstacles
    names : names of those that are looked for, by their numbers in the scene
    noise : standard deviation of a coordinate of the points [m]
    python : path of a Python with ROS 2; searched for unless given

    Attributes
    ----------
    unseen : in words why obstacles were not told last, by name
    ended : why the program has ended, in words; empty while it runs

    Raises
    ------
    SendError
        If the shape of an obstacle is not fitted, or the program does not begin.
    """

    def __init__(
        self, topic: str, scene: Scene, names: Mapping[int, str], noise: float, python: str | None = None
    ):
        self.unseen, self.ended = dict.fromkeys(names.values(), "no cloud has come"), ""
        command = {"do": "watch", "topic": topic, "noise": noise, **watched(scene, names, noise)}
        self._program, answer, _ = started(PROGRAM, command, "watching", STARTING, python)
        if answer["event"] != "watching":
            self._program.close()
            raise SendError(
                f"the clouds on '{topic}' are not read: {answer.get('what')}",
                key="ros",
                way_out="look whether ROS works in its Python",
            )

    def begin(self, time: float) -> None:
        """Let obstacles turn from an instant by the monotonic clock on [s]."""
        self._program.tell({"do": "begin", "time": time})

    def news(self) -> list[Event]:
        """Return the events of obstacles seen or unseen since the last call."""
        found = list[Event]()
        for event in self._program.news(0.0):
            if event["event"] in ("obstacles", "unseen"):
                found.append(event)
                seen = event.get("centers", ())
                self.unseen = {name: why for name, why in self.unseen.items() if name not in seen}
                self.unseen |= event.get("why", {})
            elif event["event"] in ("ended", "refused"):
                why = event.get("what") or self._program.last_words()
                self.ended = self.ended or f"the program that reads the clouds ended: {why}"
                self.unseen |= dict.fromkeys(self.unseen, self.ended)
        return found

    def end_input(self) -> None:
        """Let the process end."""
        self._program.end_input()

    def close(self) -> None:
        """End the process."""
        self._program.close()


def watched(scene: Scene, names: Mapping[int, str], noise: float) -> dict[str, Any]:
    """Return moving and static obstacles as commands have them.

    Raises
    ------
    SendError
        If the shape of one that is looked for is not fitted.
    """
    if scene.n_dims != 3:
        raise SendError(
            "clouds do not tell where the obstacles of a planar scene are",
            key="obstacles",
            way_out="publish their centres, as a PoseArray",
        )
    moving = {}
    for number, name in names.items():
        ellipsoid = scene.obstacles[scene.first_rows[number], sd.KIND] == sd.ELLIPSOID
        if ellipsoid or scene.excess.get(number, 0.0) > noise:
            over = f"a mesh whose convex pieces reach up to {1e3 * scene.excess.get(number, 0.0):.0f} mm beyond it"
            raise SendError(
                f"'{name}' is {'an ellipsoid' if ellipsoid else over}, which is not fitted to clouds",
                key="obstacles",
                way_out="publish its centre (PoseArray, MarkerArray), or make it a sphere, box, capsule or cylinder",
            )
        moving[name] = {**_shape(scene, number), "spin": scene.spins[number].tolist()}
    still = [_shape(scene, int(number)) for number in np.flatnonzero(~scene.moving)]
    return {"moving": moving, "still": [shape for shape in still if shape["solids"]]}


def _shape(scene: Scene, number: int) -> dict[str, Any]:
    """Return an obstacle at 0 s; an ellipsoid has no solids."""
    rows = scene.obstacles[scene.owners == number]
    return {
        "center": scene.centers[number].tolist(),
        "reach": float(scene.reaches[number]),
        "solids": [_solid(row) for row in rows if row[sd.KIND] in KINDS],
    }


def _solid(row: Array) -> dict[str, Any]:
    found = {
        "kind": KINDS[int(row[sd.KIND])],
        "size": row[sd.SIZE : sd.SIZE + 3].tolist(),
        "axes": row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3).tolist(),
    }
    if found["kind"] == "polytope":
        end = sd.PLANES + 4 * int(row[sd.N_PLANES])
        found["planes"] = row[sd.PLANES : end].reshape(-1, 4).tolist()
    return found
