"""Cameras of a study, and their videos of simulated episodes. The place of a camera depends on the study and on the
scene's workspace alone: pictures reveal nothing of the motion to be learned."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from comove.data.videos import encoded
from comove.io.keys import Number, Part, Wrong, as_tuple, show
from comove.io.videos import require_videos

if TYPE_CHECKING:
    from comove.sim import Execution, View
    from comove.sim.cameras import CameraPose

MOST_VIEWS = 16
LARGEST = (960, 540)
"""Width and height of the largest picture."""
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
"""Names that datasets and ROS allow."""


def _point(value: tuple[float, ...] | None) -> tuple[float, ...] | None:
    if value is not None and len(value) != 3:
        raise Wrong(f"{show(list(value))} is no point in space", "write three numbers [m]")
    return value


def _size(size: tuple[int, ...]) -> tuple[int, ...]:
    if len(size) != 2:
        raise Wrong(f"{show(list(size))} is no size", "write width and height in pixels: [256, 256]")
    for pixels, most in zip(size, LARGEST, strict=True):
        if not 16 <= pixels <= most or pixels % 2:
            raise Wrong(
                f"a picture of {size[0]} x {size[1]} pixels is not possible",
                f"write two even numbers from 16 to {LARGEST[0]} and {LARGEST[1]}",
            )
    return size


Point = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_point)]


class ViewPart(Part):
    """Pose of a camera. It views the whole workspace from a direction, or is fixed at a position or to an end
    effector."""

    aside_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Angle from the robot's front to the camera, about the vertical; 24 unless given."""
    elevation_deg: Annotated[float, Field(ge=-89, le=89)] | None = None
    """Elevation of the line of sight, negative where the camera looks down; -30 unless given."""
    position: Point | None = None
    """Where it stands, in the scene's frame, or in that of the hand's grasp [m]."""
    target: Point | None = None
    """A point that it looks at, in the same frame [m]."""
    hand: str | None = None
    """Name of the manipulator in whose hand it is mounted."""
    field_deg: Annotated[float, Field(ge=5, le=150)] | None = None
    """What it sees from top to bottom; 40 unless given, 60 in a hand."""

    @model_validator(mode="after")
    def _one_place(self) -> ViewPart:
        turned = self.aside_deg is not None or self.elevation_deg is not None
        if (self.position is None) != (self.target is None):
            missing = "target" if self.target is None else "position"
            raise Wrong(
                f"the {missing} is missing", "write both: where the camera stands, and what it looks at"
            )
        if turned and (self.position is not None or self.hand is not None):
            raise Wrong(
                "a direction is given besides a place",
                "leave aside_deg and elevation_deg out, or position, target and hand",
            )
        apart = 1.0 if not self.position or not self.target else math.dist(self.position, self.target)
        if apart < 1e-3:
            raise Wrong("the camera stands where it looks", "write a target at least 1 mm from the position")
        return self

    @property
    def camera(self) -> CameraPose | View:
        """Return the camera of the simulator."""
        from comove.sim import View
        from comove.sim.cameras import CameraPose

        field = self.field_deg or (40.0 if self.hand is None else 60.0)
        if self.hand is not None or self.position is not None:
            position, target = self.position or (0.1, 0.0, -0.15), self.target or (0.0, 0.0, 0.1)
            return CameraPose(position, target, self.hand, field)
        aside = 24.0 if self.aside_deg is None else self.aside_deg
        return View(aside, -30.0 if self.elevation_deg is None else self.elevation_deg, field)


def _views(views: dict[str, ViewPart]) -> dict[str, ViewPart]:
    if not 1 <= len(views) <= MOST_VIEWS:
        raise Wrong(f"there are {len(views)} views", f"name 1 to {MOST_VIEWS} of them, such as front: {{}}")
    for name in views:
        if not NAME.fullmatch(name):
            raise Wrong(
                f"{show(name)} cannot name a view", "begin with a letter; letters, digits and _ may follow"
            )
    return views


class CamerasPart(Part):
    """Cameras of robot episodes that are delivered in simulation."""

    rate: Annotated[int, Field(ge=1, le=100)] = 20
    """Pictures a second, which are also the samples a second of the datasets [Hz]."""
    size: Annotated[tuple[int, ...], BeforeValidator(as_tuple), AfterValidator(_size)] = (256, 256)
    """Width and height of a picture [pixels]."""
    views: Annotated[dict[str, ViewPart], AfterValidator(_views)] = Field(
        default_factory=lambda: {"front": ViewPart()}
    )
    """The cameras, by name."""


def require_cameras() -> None:
    """Check that pictures can be rendered and videos encoded here."""
    from comove.sim.cameras import require_cameras

    require_videos()
    require_cameras()


def videos_of(execution: Execution, cameras: CamerasPart, time: Any) -> tuple[tuple[str, bytes], ...]:
    """Return camera videos of an execution: names, and file contents.

    Parameters
    ----------
    time : array, shape (n_steps,), times of the pictures, at the cameras' rate [s]
    """
    from comove.sim.cameras import pictures_of

    views = [view.camera for view in cameras.views.values()]
    drawn = pictures_of(execution, views, (cameras.size[0], cameras.size[1]), time)
    return tuple(zip(cameras.views, encoded(drawn, len(views), cameras.rate), strict=True))
