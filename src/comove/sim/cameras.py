"""Fixed and end-effector cameras of an execution, for policies.

A camera has a fixed pose, or views the whole workspace from the direction of a view. Both draw without shadows, at
twice the requested size, and every pixel is the mean of four: on a processor that takes half the time of MuJoCo's
own antialiasing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.geometry.rotations import facing, matrices, quaternion_of_rotation
from comove.sim.engine import engine, no_pictures, require_pictures
from comove.sim.execution import Execution
from comove.sim.pictures import View, front_of, furnish, in_sight, sight, stage

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class CameraPose:
    """Position and target of a camera.

    Attributes
    ----------
    position, target : position, and a point on the line of sight, in the scene's frame or that of the end effector's
        grasp [m]
    hand : name of the end effector that carries the camera; None for a fixed camera
    field : vertical field of view [deg]
    """

    position: tuple[float, ...]
    target: tuple[float, ...]
    hand: str | None
    field: float


def require_cameras() -> None:
    """Check that pictures can be drawn, by drawing one."""
    require_pictures()
    try:
        model = engine().MjModel.from_xml_string("<mujoco/>")
        with engine().Renderer(model, 16, 16) as renderer:
            renderer.update_scene(engine().MjData(model))
            renderer.render()
    except Exception as error:  # what drivers raise is theirs
        raise no_pictures(" ".join(str(error).split()) or type(error).__name__) from error


def pictures_of(
    execution: Execution, cameras: Sequence[CameraPose | View], size: tuple[int, int], time: Array
) -> Iterator[list[Picture]]:
    """Yield the pictures of several cameras at given times of an execution.

    Pictures are arrays of shape (height, width, 3), one a camera. Each shows the sample of the execution that is
    nearest to its time.

    Parameters
    ----------
    size : width and height of a picture [pixels]
    time : array, shape (n_steps,), times [s]

    Raises
    ------
    OptionError
        If pictures cannot be drawn here.
    """
    finer = 2  # times as many pixels are drawn as are kept, in both directions
    width, height = size
    stands = [_stand(execution, camera, width / height) for camera in cameras]
    middles = (execution.time[1:] + execution.time[:-1]) / 2
    with stage(execution, finer * width, finer * height, partial(_furnish, stands=stands)) as (_, _, draw):
        for step in np.searchsorted(middles, time):
            drawn = [draw(step, _name(number)) for number in range(len(stands))]
            yield [_reduced(picture, finer) for picture in drawn]


def _stand(execution: Execution, camera: CameraPose | View, aspect: float) -> CameraPose:
    """Return the pose of a camera. One that views the whole workspace depends on nothing else of the scene."""
    if isinstance(camera, CameraPose):
        return camera
    bounds = np.stack([execution.scene.lower, execution.scene.upper])
    corners = np.array(list(product(*bounds.T)))
    azimuth = front_of(execution.robot, bounds[:, :2].mean(axis=0)) + camera.aside
    target, distance = in_sight(corners, aspect, azimuth, camera.elevation, camera.field)
    forward, _, _ = sight(azimuth, camera.elevation)
    return CameraPose(tuple(target - distance * forward), tuple(target), None, camera.field)


def _name(number: int) -> str:
    return f"camera {number}"  # with a blank, as nothing of a robot is called


def _furnish(spec: Any, stands: Sequence[CameraPose]) -> None:
    """Add lights and cameras to a world."""
    furnish(spec, shadows=False)
    spec.visual.quality.offsamples = 0
    for number, stand in enumerate(stands):
        position, turn = np.array(stand.position), _turn(stand)
        body = spec.worldbody
        if stand.hand is not None:
            site = spec.site(f"hand {stand.hand}")
            body, grasp = site.parent, matrices(site.quat)
            position, turn = site.pos + grasp @ position, grasp @ turn
        body.add_camera(name=_name(number), pos=position, quat=quaternion_of_rotation(turn), fovy=stand.field)


def _turn(stand: CameraPose) -> Array:
    """Return a camera's axes right, up and backwards; shape (3, 3). The third axis of its frame is up in the
    picture, or the first where the line of sight is along the third."""
    back = np.subtract(stand.position, stand.target)
    return np.roll(facing(back / np.linalg.norm(back)), -1, axis=1)


def _reduced(picture: Picture, finer: int) -> Picture:
    """Average squares of `finer` x `finer` pixels of a picture."""
    height, width = picture.shape[0] // finer, picture.shape[1] // finer
    squares = picture.reshape(height, finer, width, finer, 3).astype(np.uint16)
    return ((squares.sum(axis=(1, 3)) + finer * finer // 2) // (finer * finer)).astype(np.uint8)
