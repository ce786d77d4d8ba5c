"""What a person points at on a page: something that is selected, a drag, or a tool to draw with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.view.workbench.edits import Grip, place_of


@dataclass
class Hold:
    """A drag that goes on: the grip, the contents before, the place before, and where it was taken."""

    grip: Grip
    contents: dict[str, Any]
    place: Array
    taken: Array
    quaternion: Array

    def pointed(self, event: Any, camera: Array, planar: bool) -> Array | None:
        """Return where the pointer leads what is held; None where it points nowhere.

        Parameters
        ----------
        camera : place of the camera, array of shape (3,) [m]
        planar : whether it stays in the plane
        """
        pointer = np.array(event.end_position, dtype=float)
        through = on_plane(camera, pointer, self.taken[2]) if planar else pointer
        if through is None or not np.isfinite(through).all():
            return None
        to = self.place + through - self.taken
        if planar:
            to[2] = 0.0
        return to


@dataclass
class Pointer:
    """What is selected, dragged, and drawn with.

    Attributes
    ----------
    selected, gizmo : what was clicked, and the viewer's arrows and rings at it
    held : the drag that goes on
    tool : the viewer's handle of what a movement is shown with
    """

    selected: Grip | None = None
    gizmo: Any = None
    held: Hold | None = None
    tool: Any = None

    def let_go(self) -> None:
        """Select nothing."""
        if self.gizmo is not None:
            self.gizmo.remove()
        self.gizmo, self.selected = None, None

    def put_down(self) -> None:
        """Take the tool away."""
        if self.tool is not None:
            self.tool.remove()
            self.tool = None

    def forget(self) -> Grip | None:
        """Forget what the viewer has removed; return what was selected."""
        selected, self.selected, self.gizmo, self.tool = self.selected, None, None, None
        return selected

    def hold(
        self,
        event: Any,
        grip: Grip,
        contents: dict[str, Any],
        taken: Array,
        quaternion: Array,
        drawn: Array | None = None,
    ) -> Hold:
        """Return the drag that an event belongs to; one that begins does where the pointer is now.

        Parameters
        ----------
        contents : contents of the draft
        taken, quaternion : place of the pointer [m], and how what it turns is turned
        drawn : place where the grip is drawn, if that is not its place in the draft [m]
        """
        if event.phase == "start" or self.held is None or self.held.grip != grip:
            place = place_of(contents, grip) if drawn is None else drawn
            self.held = Hold(grip, contents, place, taken, quaternion)
        return self.held


def on_plane(camera: Array, through: Array, height: float) -> Array | None:
    """Intersect the line of sight through a point with a horizontal plane.

    It is None where they do not meet.
    """
    way = through - camera
    if abs(way[2]) < 1e-9:
        return None
    share = (height - camera[2]) / way[2]
    return camera + share * way if share > 0 else None
