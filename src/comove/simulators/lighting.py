"""Light, floor and sky of pictures, and the cameras that take them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.simulators.engine import engine
from comove.simulators.execution import Execution

Array = NDArray[np.float64]

LARGEST = (1080, 1920)  # pixels of a picture, height and width
FIELD = 40.0  # degrees, that the camera sees from top to bottom
NO_FRONT = 0.1  # m, between hands and bases: robots around what they do have no front
ROOM = 0.10  # m, around the middles of what must be seen


@dataclass(frozen=True)
class View:
    """Direction from which a camera looks.

    Attributes
    ----------
    aside : angle from the robot's front to the camera, about the vertical axis [deg]
    elevation : elevation of the line of sight, negative where the camera looks down [deg]
    """

    aside: float
    elevation: float


FRONT, ABOVE = View(aside=24.0, elevation=-30.0), View(aside=0.0, elevation=-89.0)


def furnish(spec: Any, *, shadows: bool = True) -> None:
    """Add light, sky and a floor's pattern to a world; without shadows pictures are drawn four times as fast."""
    mj = engine()
    spec.visual.global_.offheight, spec.visual.global_.offwidth = LARGEST
    spec.visual.global_.fovy = FIELD
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


def camera_for(execution: Execution, seen: Array, aspect: float, view: View = FRONT) -> Any:
    """Return a camera that looks at the robot and sees all of some points.

    Parameters
    ----------
    seen : array, shape (n_points, 3), the points [m]
    aspect : ratio of width to height of the picture
    """
    camera = engine().MjvCamera()
    camera.lookat[:] = (seen.min(axis=0) + seen.max(axis=0)) / 2
    camera.azimuth, camera.elevation = _front(execution) + view.aside, view.elevation
    a, e = np.deg2rad([camera.azimuth, camera.elevation])
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    up = np.cross(right, forward)
    wide = np.tan(np.deg2rad(FIELD) / 2)
    for _ in range(4):  # nearer things look larger, so that the middle of the picture is found by looking
        points = seen - camera.lookat
        away, aside, above = points @ forward, points @ right, points @ up
        sides = np.maximum(np.abs(aside) / aspect, np.abs(above)) + ROOM
        camera.distance = float((sides / wide - away).max())
        depth = camera.distance + away
        for axis, seen_at in ((right, aside / depth), (up, above / depth)):
            camera.lookat[:] += 0.5 * (seen_at.min() + seen_at.max()) * camera.distance * axis
    return camera


def _front(execution: Execution) -> float:
    """Return the azimuth of the line from the middle of the hands' work to the robot's bases, rounded to an axis
    [deg].
    """
    work = execution.hands[:, :, :2, 3].mean(axis=(0, 1))
    bases = np.mean([source.base.position[:2] for source in execution.robot.sources], axis=0)
    x, y = bases - work
    return 180.0 if np.hypot(x, y) < NO_FRONT else float(90.0 * np.round(2 / np.pi * np.arctan2(y, x)))
