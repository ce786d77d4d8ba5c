"""Pictures of an execution: a sheet of instants and a film, drawn by MuJoCo without a screen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from comove.errors import OptionError, ResultError
from comove.geometry.rotations import matrices, quaternion_of_rotation
from comove.io.files import whole_file
from comove.simulators.bodies import lower_floor
from comove.simulators.building import build_world
from comove.simulators.engine import engine, no_pictures, require_pictures, without_log
from comove.simulators.execution import Execution
from comove.simulators.film import encoder, write_film
from comove.simulators.lighting import FRONT, LARGEST, View, camera_for, furnish
from comove.simulators.world import World

Array = NDArray[np.float64]

DRAWN_GROUPS = (1, 2)  # visual meshes; obstacles, floor and load
LARGE = 2.0  # m, of a box that need not be seen to its ends
GAP = 6  # pixels between the pictures of a sheet
INK, PAPER = (40, 44, 52), (255, 255, 255)


def draw_sheet(
    execution: Execution,
    path: str | Path,
    *,
    count: int = 6,
    columns: int = 3,
    width: int = 640,
    views: Sequence[View] = (FRONT,),
) -> None:
    """Write a sheet of pictures of an execution as PNG.

    Parameters
    ----------
    count, columns : number of instants, and of pictures in a row
    width : width of one picture [pixels]; its height is three quarters of that
    views : directions of the camera; the rows of instants are repeated for each

    Raises
    ------
    OptionError
        If pictures cannot be drawn here.
    ResultError
        If the file cannot be written.
    """
    height, rows = round(width * 3 / 4), -(-count // columns)
    size = columns * (width + GAP) - GAP, len(views) * rows * (height + GAP) - GAP
    sheet = Image.new("RGB", size, PAPER)
    for k, view in enumerate(views):
        with camera(execution, width, height, view=view) as shot:
            for i, step in enumerate(_steps(execution, count)):
                row = k * rows + i // columns
                sheet.paste(shot(step), ((i % columns) * (width + GAP), row * (height + GAP)))
    with whole_file(path, ResultError) as file:
        sheet.save(file, format="PNG", optimize=True)


def draw_film(execution: Execution, path: str | Path, *, rate: float = 20.0, width: int = 640) -> Path:
    """Write a film of an execution at its own pace.

    Parameters
    ----------
    path : path of the file; its suffix becomes .mp4, or .gif where there is no encoder
    rate : pictures per second
    width : width of the film [pixels]; its height is three quarters of that

    Returns
    -------
    Path of the file that was written

    Raises
    ------
    OptionError, ResultError
        As `draw_sheet`.
    """
    ffmpeg = encoder()
    path = Path(path).with_suffix(".gif" if ffmpeg is None else ".mp4")
    width, height = width // 2 * 2, round(width * 3 / 8) * 2  # encoders want even numbers
    times = np.arange(0.0, max(execution.time[-1], 1 / rate), 1 / rate)  # one at least
    steps = np.searchsorted(execution.time, times - 1e-9).clip(max=len(execution.time) - 1)
    with camera(execution, width, height, shadows=False) as shot:
        write_film((shot(step) for step in steps), path, rate, ffmpeg)
    return path


def _steps(execution: Execution, count: int) -> list[int]:
    """Choose samples so that the same progress lies between neighbours: half of it is time, half travel of the
    hands.
    """
    last = min(
        int(np.searchsorted(execution.time, execution.motion.duration - 1e-9)), len(execution.time) - 1
    )
    hands = execution.hands_planned[: last + 1, :, :3, 3]
    travel = np.linalg.norm(np.diff(hands, axis=0), axis=-1).sum(axis=-1)
    progress = np.linspace(0.0, 1.0, last + 1)
    if travel.sum() > 0:
        progress = 0.5 * (progress + np.append(0.0, np.cumsum(travel)) / travel.sum())
    return np.searchsorted(progress, np.linspace(0.0, 1.0, count) - 1e-9).clip(max=last).tolist()


@contextmanager
def camera(
    execution: Execution, width: int, height: int, *, shadows: bool = True, view: View = FRONT
) -> Iterator[Callable[[int], Image.Image]]:
    """Lend a function that draws one sample of an execution, of the size given in pixels.

    Raises
    ------
    OptionError
        If pictures, or pictures of that size, cannot be drawn here, or there is nothing to be seen.
    """
    if not (0 < height <= LARGEST[0] and 0 < width <= LARGEST[1]):
        raise OptionError(
            f"a picture of {width} x {height} pixels cannot be drawn",
            key="width",
            way_out=f"use at most {LARGEST[1]} x {LARGEST[0]}",
        )
    if not np.isfinite(execution.hands).all():
        raise OptionError(
            "pictures cannot be drawn: the simulation broke down before the motion began",
            key="execution",
            way_out="look at the robot's masses and at the stiffness of its servos",
        )
    require_pictures()
    mj, finish = engine(), partial(furnish, shadows=shadows)
    with without_log():
        world = build_world(
            execution.robot,
            execution.scene,
            execution.load,
            execution.grasp,
            execution.perturbation,
            finish=finish,
        )
        data, options = mj.MjData(world.model), mj.MjvOption()
        options.geomgroup[:] = [group in DRAWN_GROUPS for group in range(len(options.geomgroup))]
        place(execution, world, data, 0)
        lower_floor(world.model, data)
        stand = camera_for(execution, _seen(execution, world, data), width / height, view)
        with _renderer(world.model, height, width) as renderer:

            def shot(step: int) -> Image.Image:
                place(execution, world, data, step)
                renderer.update_scene(data, stand, options)
                picture = Image.fromarray(renderer.render())
                size = max(12, width // 30)
                words = f"{execution.time[step]:.1f} s"
                ImageDraw.Draw(picture).text((size // 2,) * 2, words, INK, ImageFont.load_default(size))
                return picture

            yield shot


def _renderer(model: Any, height: int, width: int) -> Any:
    try:
        return engine().Renderer(model, height, width)
    except Exception as error:  # what drivers raise is theirs
        raise no_pictures(str(error).strip().splitlines()[0]) from error


def place(execution: Execution, world: World, data: Any, step: int) -> None:
    """Put a world into the state of one sample."""
    mj, model = engine(), world.model
    data.qpos[world.qpos] = execution.joints[step]
    fingers = [model.joint(f).qposadr[0] for hand in world.fingers for f in hand]
    data.qpos[fingers] = execution.fingers[step]
    if world.load is not None:
        pose, first = execution.load_pose[step], world.load_qpos
        data.qpos[first : first + 3] = pose[:3, 3]
        data.qpos[first + 3 : first + 7] = quaternion_of_rotation(pose[:3, :3])
    mj.mj_kinematics(model, data)
    mj.mj_comPos(model, data)
    mj.mj_camlight(model, data)


def _seen(execution: Execution, world: World, data: Any) -> Array:
    """Return the points that a picture must show: all hands and loads, obstacles, and the robot as it stands at
    the start.
    """
    model = world.model
    moving = [g for g in range(model.ngeom) if model.geom_group[g] in DRAWN_GROUPS and model.geom_bodyid[g]]
    hands = execution.hands[..., :3, 3].reshape(-1, 3)
    load = execution.load_pose[: 0 if execution.load is None else None, :3, 3]
    corners = [_corners(obstacle) for obstacle in execution.scene.file.obstacles]
    return np.concatenate([hands, load, data.geom_xpos[moving], *corners])


def _corners(obstacle: Any) -> Array:
    """Return the corners of a box, the middle of any other obstacle; array, shape (n_points, 3)."""
    middle, size = np.array(obstacle.center), getattr(obstacle, "size", None)
    if size is None:
        return middle[None]
    half = np.minimum(size, LARGE) / 2
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    return middle + (signs * half) @ matrices(np.array(obstacle.quaternion_wxyz)).T
