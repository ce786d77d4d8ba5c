"""Pictures and films of an execution, drawn offscreen by MuJoCo. Films are MP4 by PyAV, where it is installed, else
GIF by Pillow."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from comove.arrays import Array
from comove.errors import ExtraError, OptionError, ResultError
from comove.geometry.rotations import matrices
from comove.io.files import whole_file, whole_path
from comove.io.videos import encode, require_videos
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.sim.building import build_world
from comove.sim.engine import engine, no_pictures, require_pictures, without_log
from comove.sim.execution import Conditions, Execution, obstacle_time
from comove.sim.grasps import GraspModel, Weld
from comove.sim.live_record import OnlineRecord
from comove.sim.loads import Load, hand_poses, load_of
from comove.sim.settings import PLAN, Perturbation
from comove.sim.world import SimulatedWorld, lower_floor, move_obstacles

DRAWN_GROUPS = (1, 2)  # visual meshes; obstacles, floor and load
LARGEST = (1080, 1920)  # pixels of a picture, height and width
OF_FILMS = {"encoder": {"crf": "23"}, "container": {"movflags": "+faststart"}}  # they play while they load
INK, PAPER = (40, 44, 52), (255, 255, 255)


@dataclass(frozen=True, eq=False)
class FilmedRun:
    """Online run for drawing. Robot and payload are as measured, obstacles where the scene moves them, and fingers
    as in the model, since the record has none."""

    robot: Robot
    scene: Scene
    motion: JointMotion
    conditions: Conditions
    load: Load | None
    time: Array
    joints: Array
    hands: Array
    hands_planned: Array
    load_pose: Array
    fingers: None = None

    @classmethod
    def of(
        cls, record: OnlineRecord, grasp: GraspModel | None = None, perturbation: Perturbation = PLAN
    ) -> FilmedRun:
        """Return the drawing data of a record. Grasp and perturbation must be those of `run_live`."""
        robot, scene, grasp = record.robot, record.scene, grasp or Weld()
        commanded, measured = np.array(record.commanded), np.array(record.measured)
        planned = hand_poses(robot, scene, commanded)
        load = load_of(scene, planned[0], grasp.section)
        pose = np.array(record.load)
        hands = hand_poses(robot, scene, measured)
        time, motion = np.array(record.time), record.motion
        conditions = Conditions("mujoco", grasp, perturbation=perturbation)
        return cls(robot, scene, motion, conditions, load, time, measured, hands, planned, pose)


Filmed = Execution | FilmedRun


@dataclass(frozen=True)
class View:
    """Direction of a camera that is far enough to see all.

    Attributes
    ----------
    aside : angle from the robot's front to the camera, about the vertical axis [deg]
    elevation : elevation of the line of sight, negative where the camera points down [deg]
    field : vertical field of view [deg]
    """

    aside: float
    elevation: float
    field: float = 40.0


FRONT, ABOVE = View(aside=24.0, elevation=-30.0), View(aside=0.0, elevation=-89.0)


def draw_sheet(
    execution: Filmed,
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
    gap = 6  # pixels between the pictures
    height, rows = round(width * 3 / 4), -(-count // columns)
    size = columns * (width + gap) - gap, len(views) * rows * (height + gap) - gap
    sheet = Image.new("RGB", size, PAPER)
    for k, view in enumerate(views):
        with camera(execution, width, height, view=view) as shot:
            for i, step in enumerate(_steps(execution, count)):
                row = k * rows + i // columns
                sheet.paste(shot(step), ((i % columns) * (width + gap), row * (height + gap)))
    with whole_file(path, ResultError) as file:
        sheet.save(file, format="PNG", optimize=True)


def draw_film(execution: Filmed, path: str | Path, *, rate: float = 20.0, width: int = 640) -> Path:
    """Write a film of an execution at real-time speed.

    Parameters
    ----------
    path : path of the file; its suffix becomes .mp4, or .gif where there is no encoder
    rate : pictures per second
    width : width of the film [pixels]; its height is three quarters of that

    Returns
    -------
    Path of the file that was written
    """
    path = Path(path).with_suffix(".mp4" if encodes() else ".gif")
    width, height = width // 2 * 2, round(width * 3 / 8) * 2  # encoders want even numbers
    times = np.arange(0.0, max(execution.time[-1], 1 / rate), 1 / rate)  # one at least
    steps = np.searchsorted(execution.time, times - 1e-9).clip(max=len(execution.time) - 1)
    with camera(execution, width, height, shadows=False) as shot:
        pictures = (shot(step) for step in steps)
        with whole_path(path, ResultError) as draft:
            if path.suffix == ".gif":
                _write_gif(pictures, draft, rate)
            else:
                encode(((np.asarray(picture),) for picture in pictures), [str(draft)], rate, **OF_FILMS)
    return path


def encodes() -> bool:
    """Return whether films can be encoded as videos."""
    try:
        require_videos()
    except ExtraError:
        return False
    return True


def _steps(execution: Filmed, count: int) -> list[int]:
    """Choose samples at equal progress. Progress is half time, half travel of the end effectors."""
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
    execution: Filmed, width: int, height: int, *, shadows: bool = True, view: View = FRONT
) -> Iterator[Callable[[int], Image.Image]]:
    """Yield a function that draws one sample with its time.

    Raises
    ------
    OptionError
        If pictures, or pictures of that size [pixels], cannot be drawn here, or there is nothing to be seen.
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

    def finish(spec: Any) -> None:
        furnish(spec, shadows=shadows)
        spec.visual.global_.fovy = view.field

    with stage(execution, width, height, finish) as (world, data, draw):
        stand = engine().MjvCamera()
        front = front_of(execution.robot, execution.hands[:, :, :2, 3].mean(axis=(0, 1)))
        stand.azimuth, stand.elevation = front + view.aside, view.elevation
        seen = _seen(execution, world, data)
        looks = stand.azimuth, stand.elevation, view.field
        stand.lookat[:], stand.distance = in_sight(seen, width / height, *looks)

        def shot(step: int) -> Image.Image:
            picture = Image.fromarray(draw(step, stand))
            size = max(12, width // 30)
            words = f"{execution.time[step]:.1f} s"
            ImageDraw.Draw(picture).text((size // 2,) * 2, words, INK, ImageFont.load_default(size))
            return picture

        yield shot


@contextmanager
def stage(
    execution: Filmed, width: int, height: int, finish: Callable[[Any], None]
) -> Iterator[tuple[SimulatedWorld, Any, Callable[[int, Any], NDArray[np.uint8]]]]:
    """Yield an execution's world, MuJoCo data, and sample renderer.

    Parameters
    ----------
    finish : function that adds lights and cameras to the world's specification
    """
    require_pictures()
    with without_log():
        world = build_world(
            execution.robot,
            execution.scene,
            execution.load,
            execution.conditions.grasp,
            execution.conditions.perturbation,
            finish=finish,
        )
        data, options = engine().MjData(world.model), engine().MjvOption()
        options.geomgroup[:] = [group in DRAWN_GROUPS for group in range(len(options.geomgroup))]
        place(execution, world, data, 0)
        lower_floor(world, data, execution.motion.position)
        with _renderer(world.model, height, width) as renderer:

            def draw(step: int, camera: Any) -> NDArray[np.uint8]:
                place(execution, world, data, step)
                renderer.update_scene(data, camera, options)
                return renderer.render()

            yield world, data, draw


def _renderer(model: Any, height: int, width: int) -> Any:
    try:
        return engine().Renderer(model, height, width)
    except Exception as error:  # what drivers raise is theirs
        raise no_pictures(str(error).strip().splitlines()[0]) from error


def place(execution: Filmed, world: SimulatedWorld, data: Any, step: int) -> None:
    """Set a world to the state of one sample."""
    mj, model = engine(), world.model
    data.qpos[world.qpos] = execution.joints[step]
    if execution.fingers is not None:
        data.qpos[world.finger_qpos] = execution.fingers[step]
    move_obstacles(
        data, execution.scene, float(obstacle_time(execution.time[step], execution.motion.duration))
    )
    if world.load is not None:
        world.put_load(data, execution.load_pose[step])
    mj.mj_kinematics(model, data)
    mj.mj_comPos(model, data)
    mj.mj_camlight(model, data)


def _seen(execution: Filmed, world: SimulatedWorld, data: Any) -> Array:
    """Return the points that a picture must show."""
    model = world.model
    moving = [g for g in range(model.ngeom) if model.geom_group[g] in DRAWN_GROUPS and model.geom_bodyid[g]]
    hands = execution.hands[..., :3, 3].reshape(-1, 3)
    load = execution.load_pose[: 0 if execution.load is None else None, :3, 3]
    corners = [_corners(obstacle) for obstacle in execution.scene.file.obstacles]
    return np.concatenate([hands, load, data.geom_xpos[moving], *corners])


def _corners(obstacle: Any) -> Array:
    """Return the corners of a box, else an obstacle's centre. Array, shape (n_points, 3)."""
    large = 2.0  # m, of a box that need not be seen to its ends
    middle, size = np.array(obstacle.center), getattr(obstacle, "size", None)
    if size is None:
        return middle[None]
    half = np.minimum(size, large) / 2
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    return middle + (signs * half) @ matrices(np.array(obstacle.quaternion_wxyz)).T


def furnish(spec: Any, *, shadows: bool = True) -> None:
    """Add light, sky and a floor pattern to a world. Without shadows pictures are drawn four times as fast."""
    mj = engine()
    spec.visual.global_.offheight, spec.visual.global_.offwidth = LARGEST
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 8192, 8 if shadows else 4
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.38,) * 3, (0.34,) * 3
    spec.visual.headlight.specular = (0.05,) * 3
    spec.visual.map.znear, spec.visual.map.zfar, spec.visual.map.shadowclip = 0.01, 30.0, 3.0
    spec.stat.extent = 2.0
    spec.add_texture(
        name="sky",
        type=mj.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mj.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.97, 0.98, 0.99),
        rgb2=(0.80, 0.85, 0.90),
        width=256,
        height=256,
    )
    tiles = spec.add_texture(name="tiles", type=mj.mjtTexture.mjTEXTURE_2D, width=256, height=256)
    tiles.builtin, tiles.rgb1, tiles.rgb2 = (
        mj.mjtBuiltin.mjBUILTIN_CHECKER,
        (0.72, 0.73, 0.75),
        (0.68, 0.69, 0.71),
    )
    floor = spec.add_material(name="floor", texrepeat=(2, 2), texuniform=True)
    floor.textures[mj.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    spec.geom("the floor").material = "floor"
    for position, strength in (((1.2, -1.4, 3.0), 0.50), ((1.6, 1.8, 2.4), 0.22)):
        light = spec.worldbody.add_light(
            pos=position, dir=[-x for x in position], castshadow=shadows and strength > 0.4
        )
        light.type = mj.mjtLightType.mjLIGHT_DIRECTIONAL
        light.diffuse, light.specular = (strength,) * 3, (0.12,) * 3


def in_sight(
    seen: Array, aspect: float, azimuth: float, elevation: float, field: float
) -> tuple[Array, float]:
    """Return a camera's target and distance at which points are visible [m].

    Parameters
    ----------
    seen : array, shape (n_points, 3), the points [m]
    aspect : ratio of width to height of the picture
    azimuth, elevation : direction of the line of sight [deg]
    field : vertical field of view [deg]
    """
    room = 0.10  # m, around the middles of what must be seen
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    forward, right, up = sight(azimuth, elevation)
    wide = np.tan(np.deg2rad(field) / 2)
    distance = 0.0
    for _ in range(4):  # nearer things look larger, so that the middle of the picture is found by looking
        points = seen - middle
        away, aside, above = points @ forward, points @ right, points @ up
        sides = np.maximum(np.abs(aside) / aspect, np.abs(above)) + room
        distance = float((sides / wide - away).max())
        depth = distance + away
        for axis, seen_at in ((right, aside / depth), (up, above / depth)):
            middle += 0.5 * (seen_at.min() + seen_at.max()) * distance * axis
    return middle, distance


def sight(azimuth: float, elevation: float) -> tuple[Array, Array, Array]:
    """Return the directions forward, right and up of a camera; arrays, shape (3,)."""
    a, e = np.deg2rad([azimuth, elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    return forward, right, np.cross(right, forward)


def front_of(robot: Robot, work: Array) -> float:
    """Return the azimuth of the robot's bases from the work [deg]. It is rounded to an axis.

    Parameters
    ----------
    work : array, shape (2,), middle of the work from above [m]
    """
    x, y = np.mean([source.base.position[:2] for source in robot.sources], axis=0) - work
    if np.hypot(x, y) < 0.1:  # robots around what they do have no front
        return 180.0
    return float(90.0 * np.round(2 / np.pi * np.arctan2(y, x)))


def _write_gif(pictures: Iterable[Image.Image], path: Path, rate: float) -> None:
    every = max(1, round(rate / 12.5))  # pictures a second of a GIF at most
    frames = [picture.quantize(64) for picture in islice(pictures, 0, None, every)]
    pause = round(1000 * every / rate)  # ms
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=pause, loop=0)
