"""Drawing of scenes and recordings in a viewer's scene. Meshes, lines and poses are added to a page or a file.
Everything is added under a name; an element with the same name replaces the old one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveError
from comove.geometry.rotations import exponential
from comove.model.demonstration import demonstration_of
from comove.model.scene import Scene
from comove.model.shapes import spatial
from comove.planning import carried_demonstration, movements_of
from comove.view.figures.shapes import load_pairs
from comove.view.figures.style import COLOURS, GOAL, MOVING, START
from comove.view.workbench.bodies import LinkSurface
from comove.view.workbench.edits import Grip, contents_of, grips_of, place_of
from comove.view.workbench.geometry import (
    Piece,
    Proportions,
    Surface,
    ball,
    clearance_colours,
    colour_of,
    longest_side,
    obstacle_surfaces,
    pieces_of,
    segments_of,
    workspace_lines,
)
from comove.view.workbench.playback import RecordedMotion, Touch
from comove.view.workbench.teaching import Taught, demonstration_from

STILL, GREY, PALE = colour_of("#9aa1ab"), colour_of("#b9bec6"), colour_of("#c9cdd3")
BLOCKS = colour_of("#d7263d")
ROBOT = "/robot"  # path under which the robot is drawn, whichever the scene
BESIDE = "/beside"  # path under which a second scene is drawn


@dataclass(frozen=True, eq=False)
class DrawnRobot:
    """Robot that is drawn, or is to be drawn.

    Attributes
    ----------
    bodies : its visible bodies
    home : array, shape (n_joints, 7), poses of its joints until a motion is drawn
    joints : the viewer's handles of its joints
    links : the viewer's handles of its bodies
    """

    bodies: Sequence[LinkSurface]
    home: Array
    joints: Sequence[Any] = ()
    links: Sequence[Any] = ()


@dataclass(eq=False)
class Stage:
    """Drawing of one scene and one motion.

    Parameters
    ----------
    api : the viewer's scene, of a client or of a server
    scene : the drawn scene
    prefix : path under which everything is drawn
    aside : array, shape (3,), displacement of the drawing from the scene's coordinates [m]
    sizes : sizes of drawn elements
    """

    api: Any
    scene: Scene
    prefix: str = ""
    aside: Array = field(default_factory=lambda: np.zeros(3))
    sizes: Proportions = field(default_factory=Proportions)
    recording: RecordedMotion | None = None
    obstacles: list[Any] = field(default_factory=list)
    marks: dict[str, Any] = field(default_factory=dict)
    touches: Sequence[Touch] = ()
    pale: bool = False
    robot: DrawnRobot | None = None
    _pieces: tuple[Piece, ...] = ()
    _moving: list[Any] = field(default_factory=list)
    _motion: dict[str, Any] = field(default_factory=dict)
    _ghosts: bool = True

    @property
    def side(self) -> float:
        """Return the longest side of the workspace [m]."""
        return longest_side(self.scene)

    @property
    def lift(self) -> float:
        """Return the height at which planar scenes are drawn [m]."""
        return 0.5 * self.sizes.height * self.side if self.scene.n_dims == 2 else 0.0

    @classmethod
    def beside(cls, first: Stage, scene: Scene) -> Stage:
        """Return an empty stage to the right in another one's view."""
        right = np.array([-np.sin(first.heading), np.cos(first.heading), 0.0])
        halves = [0.5 * float(np.abs(right) @ _size(s)) for s in (first.scene, scene)]
        sizes = first.sizes
        between = sizes.between if scene.file.robot is None else sizes.between_arms
        aside = right * (sum(halves) + between * 2.0 * max(halves)) + _middle(first.scene) - _middle(scene)
        aside[2] = 0.0
        first.api.remove_by_name(BESIDE)
        first.api.add_frame(BESIDE, show_axes=False, position=tuple(aside))
        return cls(first.api, scene, BESIDE, aside, sizes)

    @property
    def heading(self) -> float:
        """Return the camera's angle about the vertical, opposite to a robot [rad]."""
        if self.scene.n_dims == 2:
            return float(-0.5 * np.pi)
        way = (self.scene.goal - self.scene.start).mean(axis=0)
        sides = float(np.arctan2(way[1], way[0])) + np.radians([-62.0, 62.0])
        if self.robot is None:
            return float(sides[0])
        away = (_middle(self.scene) - self.robot.home[:, :3].mean(axis=0))[:2]
        return float(sides[np.argmax(away @ [np.cos(sides), np.sin(sides)])])

    def draw_scene(self, demonstration: Array | None = None) -> None:
        """Draw workspace, obstacles, starts and goals.

        Parameters
        ----------
        demonstration : array, shape (n_steps, n_manipulators, 3), drawn as thin lines where given [m]
        """
        self._lines("workspace", workspace_lines(self.scene), colour_of("#777d87"), 1.5)
        self._floor()
        self._draw_obstacles()
        for grip in grips_of(self.scene):
            if grip.kind != "obstacle":
                self._draw_mark(grip)
        for i in np.flatnonzero(self.scene.moving):
            way = self.scene.offsets(np.linspace(0.0, self.scene.file.duration or 1.0, 101))[:, i]
            path = self.scene.centers[i] + way + [0.0, 0.0, 0.5 * self.lift]
            self._lines(f"way_{i}", segments_of(path)[::2], colour_of(MOVING), 1.5)
        if demonstration is not None:
            for hand in range(demonstration.shape[1]):
                path = demonstration[:, hand] + [0.0, 0.0, 1.1 * self.lift]
                self._lines(f"demonstration_{hand}", segments_of(path)[::2], colour_of("#6b7280"), 1.5)

    def _draw_obstacles(self) -> None:
        """Draw the obstacles as they are at 0 s."""
        moving, few = self.scene.moving, len(self.scene.moving) < self.sizes.many
        self.obstacles = [
            self._mesh(
                f"{self.prefix}/obstacle_{i}",
                surface,
                colour_of(MOVING) if moving[i] else STILL,
                opacity=None if self.scene.n_dims == 2 else 0.55,
                side="double",
                cast_shadow=few,
                receive_shadow=few,
                position=tuple(self.scene.centers[i]),
            )
            for i, surface in enumerate(obstacle_surfaces(self.scene, self.sizes))
        ]

    def name(self, text: str) -> None:
        """Write a name above the scene, or remove it if empty."""
        self.api.remove_by_name(f"{self.prefix}/name")
        if text:
            top, upwards = _middle(self.scene), self.scene.n_dims - 1
            top[upwards] += 0.55 * float(_size(self.scene)[upwards])
            self.api.add_label(f"{self.prefix}/name", text, position=tuple(top), anchor="bottom-center")

    def draw_robot(self, bodies: Sequence[LinkSurface], home: Array) -> None:
        """Draw a robot by its bodies and the poses of its joints. They are those of `DrawnRobot`."""
        path = f"{self.prefix}{ROBOT}"
        self.api.add_frame(path, show_axes=False)
        joints = [self.api.add_frame(f"{path}/joint_{joint}", show_axes=False) for joint in range(len(home))]
        links = [
            self._mesh(
                f"{path}/{'base' if body.joint < 0 else f'joint_{body.joint}'}/body_{number}",
                body.surface,
                body.colour,
                side="double",
            )
            for number, body in enumerate(bodies)
        ]
        self.robot = DrawnRobot(bodies, home, joints, links)
        self.pose_robot(home)

    def pose_robot(self, poses: Array) -> None:
        """Set the joint poses of the robot, shape (n_joints, 7)."""
        for handle, pose in zip(self.robot.joints if self.robot is not None else (), poses, strict=False):
            handle.position, handle.wxyz = tuple(pose[:3]), tuple(pose[3:])

    def _mesh(self, path: str, surface: Surface, colour: Any, **how: Any) -> Any:
        """Add triangles of one colour. `how` are further arguments of the viewer."""
        vertices, faces = surface.vertices.astype(np.float32), surface.faces.astype(np.uint32)
        return self.api.add_mesh_simple(path, vertices, faces, color=colour, **how)

    def _floor(self) -> None:
        low, high = self.scene.lower, self.scene.upper
        middle, size = 0.5 * (low + high), high - low
        ground = 0.0 if self.scene.n_dims == 2 else float(low[2])
        self.api.add_grid(
            f"{self.prefix}/floor",
            width=float(size[0]),
            height=float(size[1]),
            cell_size=0.1 * self.side,
            section_size=0.5 * self.side,
            position=(float(middle[0]), float(middle[1]), ground - 1e-3 * self.side),
        )

    def _draw_mark(self, grip: Grip) -> None:
        """Draw a group's start or goal: a ball, and lines to end effectors."""
        ends = self.scene.start if grip.kind == "start" else self.scene.goal
        colour = colour_of(START if grip.kind == "start" else GOAL)
        place = place_of(contents_of(self.scene), grip) + [0.0, 0.0, self.lift]
        self.marks[grip.name] = self._mesh(
            f"{self.prefix}/{grip.name}",
            ball(self.sizes.grip * self.side),
            colour,
            opacity=0.85,
            position=tuple(place),
        )
        hands = spatial(ends[list(grip.hands)])
        hands[:, 2] += self.lift
        if len(hands) > 1:
            lines = np.stack([np.broadcast_to(place, hands.shape), hands], axis=1)
            self._lines(f"{grip.name}_hands", lines, colour, 3.0)

    def _lines(self, name: str, points: Array, colour: Any, thickness: float) -> Any:
        """Draw segments, shape (n, 2, 3), in one or several colours. Thickness is in pixels."""
        colours = np.broadcast_to(np.asarray(colour, dtype=np.uint8).reshape(-1, 1, 3), (len(points), 2, 3))
        return self.api.add_line_segments(
            f"{self.prefix}/{name}",
            points.astype(np.float32),
            np.ascontiguousarray(colours),
            thickness=thickness,
            thickness_units="screen",
        )

    def draw_motion(self, recording: RecordedMotion, pale: bool = False) -> None:
        """Draw a motion's payload and end effectors with their paths. The payload at equal times and the tightest
        instant are drawn too.

        Parameters
        ----------
        pale : whether it is drawn in grey, as one that is not verified on this scene
        """
        pieces = pieces_of(self.scene, recording.nodes, self.sizes)
        again = [piece.name for piece in pieces] == [piece.name for piece in self._pieces]
        changed = again and pale == self.pale and len(pieces) > 0 and _same_bodies(pieces, self._pieces)
        self.recording, self._pieces, self.pale = recording, pieces, pale
        if not changed:
            self._draw_bodies(pale)
        self._draw_paths(recording, pale)
        if self.robot is not None:
            for handle, body in zip(self.robot.links, self.robot.bodies, strict=True):
                if tuple(handle.color) != (wanted := GREY if pale else body.colour):
                    handle.color = wanted
        every = np.linspace(0, len(recording.time) - 1, self.sizes.ghosts).round().astype(int)
        for piece in pieces:
            handle = self._motion[f"ghost {piece.name}"]
            handle.visible = self._ghosts
            handle.batched_positions = piece.position[every].astype(np.float32)
            handle.batched_wxyzs = piece.quaternion[every].astype(np.float32)

    def _draw_bodies(self, pale: bool) -> None:
        for handle in [*self._moving, *self._motion.values()]:
            handle.remove()
        self._moving, self._motion = [], {}
        for piece in self._pieces:
            colour = GREY if pale else piece.colour
            self._moving.append(
                self._mesh(
                    f"{self.prefix}/load/{piece.name}",
                    piece.surface,
                    colour,
                    opacity=0.5 if pale else None,
                    position=tuple(piece.position[0]),
                    wxyz=tuple(piece.quaternion[0]),
                )
            )
            self._motion[f"ghost {piece.name}"] = self.api.add_batched_meshes_simple(
                f"{self.prefix}/ghosts/{piece.name}",
                piece.surface.vertices.astype(np.float32),
                piece.surface.faces.astype(np.uint32),
                batched_positions=np.zeros((self.sizes.ghosts, 3), dtype=np.float32),
                batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (self.sizes.ghosts, 1)).astype(np.float32),
                batched_colors=colour,
                opacity=0.15 if pale else 0.4,
                lod="off",
                cast_shadow=False,
                receive_shadow=False,
                visible=self._ghosts,
            )

    def _draw_paths(self, recording: RecordedMotion, pale: bool) -> None:
        high = np.array([0.0, 0.0, 1.2 * self.lift])
        for hand in range(recording.speed.shape[1]):
            colour = PALE if pale else colour_of(COLOURS[hand % len(COLOURS)])
            path = segments_of(recording.nodes[:, hand] + high)
            self._motion[f"path {hand}"] = self._lines(f"path_{hand}", path, colour, 2.0)
        colours: Any = PALE
        if not pale:
            tight = np.minimum(recording.clearance[:-1], recording.clearance[1:])
            colours = clearance_colours(tight, self.sizes.comfort * self.side)
        center = segments_of(recording.center + high)
        self._motion["path"] = self._lines("path_load", center, colours, 5.0)
        at = recording.nodes[recording.index_at(float(recording.tightest[0]))]
        edges = load_pairs(self.scene) or [(hand, hand + 1) for hand in range(recording.speed.shape[1] - 1)]
        if pale or not edges:
            if tightest := self._motion.pop("tightest", None):
                tightest.remove()
        else:
            self._motion["tightest"] = self._lines("tightest", at[edges] + 1.2 * high, BLOCKS, 4.0)

    def fade(self) -> None:
        """Draw the motion in grey, as unverified on the present scene."""
        if self.recording is not None and not self.pale:
            self.draw_motion(self.recording, pale=True)

    def show(self, index: int) -> None:
        """Move payload, end effectors and moving obstacles to a recorded state."""
        recording = self.recording
        if recording is None:
            return
        for handle, piece in zip(self._moving, self._pieces, strict=True):
            handle.position = tuple(piece.position[index])
            handle.wxyz = tuple(piece.quaternion[index])
        self.pose_robot(recording.links[index])
        moving = np.flatnonzero(recording.moved | self.scene.turning).tolist()
        self._move_obstacles(moving, recording.offsets[index], float(recording.time[index]))
        if self.touches:
            self.blame(*(touch.obstacle for touch in self.touches if touch.time <= recording.time[index]))

    def draw_run(self) -> None:
        """Remove the elements of a planned motion before a run."""
        self.show_ghosts(False, keep=True)
        for name in [name for name in self._motion if name.startswith(("path", "tightest"))]:
            self._motion.pop(name).remove()
        self.blame()

    def _move_obstacles(self, which: Sequence[int], offsets: Array, time: float) -> None:
        turned = exponential(self.scene.turns(np.array([time]))[0])
        for i in which:
            self.obstacles[i].position = tuple(self.scene.centers[i] + offsets[i])
            self.obstacles[i].wxyz = tuple(turned[i])

    def show_state(self, nodes: Array, offsets: Array, time: float) -> None:
        """Move payload, end effectors and obstacles to a run's state.

        Parameters
        ----------
        nodes, offsets : arrays, shape (n_nodes, 3) and (n_obstacles, 3), as of a recording [m]
        time : time of the state [s]
        """
        if self.recording is None:
            return
        states = np.stack([self.recording.nodes[0], nodes])  # bodies are drawn as they are in the first
        for handle, piece in zip(self._moving, pieces_of(self.scene, states, self.sizes), strict=True):
            handle.position, handle.wxyz = tuple(piece.position[1]), tuple(piece.quaternion[1])
        self._move_obstacles(range(len(self.obstacles)), offsets, time)

    def show_ghosts(self, visible: bool, *, keep: bool = False) -> None:
        """Show or hide the payload at equal times. `keep` leaves the choice for the next motion unchanged."""
        self._ghosts = self._ghosts if keep else visible
        for name, handle in self._motion.items():
            if name.startswith("ghost "):
                handle.visible = visible

    def blame(self, *obstacles: int) -> None:
        """Draw blocking obstacles in red, and all others as usual."""
        for i, handle in enumerate(self.obstacles):
            plain = colour_of(MOVING) if self.scene.moving[i] else STILL
            wanted = BLOCKS if i in obstacles else plain
            if tuple(handle.color) != wanted:
                handle.color = wanted

    def sheet(self) -> Any:
        """Return a sheet above the plane for drawing."""
        low, high = self.scene.lower, self.scene.upper
        height = 2.5 * self.lift
        corners = np.array(
            [
                [x, y, height]
                for x, y in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
            ]
        )
        return self._mesh(
            f"{self.prefix}/sheet",
            Surface(corners, np.array([[0, 1, 2], [0, 2, 3]])),
            colour_of("#ffd84d"),
            opacity=0.18,
            side="double",
            cast_shadow=False,
        )

    def draw_stroke(self, rows: Sequence[Sequence[float]]) -> None:
        """Draw a movement during its demonstration. `rows` are time [s] and position [m]."""
        path = spatial(np.array(rows)[:, 1:])
        path[:, 2] += 2.6 * self.lift
        if len(path) > 1:
            self._lines("stroke", segments_of(path), colour_of("#e07a00"), 4.0)

    def grips(self) -> dict[Grip, Any]:
        """Return all grips, with the viewer's handles."""
        return {
            grip: self.obstacles[grip.number] if grip.kind == "obstacle" else self.marks[grip.name]
            for grip in grips_of(self.scene)
        }

    def camera(self, beside: Stage | None = None) -> tuple[Array, Array, Array]:
        """Return position, target and up-vector of a camera; shape (3,).

        Parameters
        ----------
        beside : stage to the right, which shall be visible as well
        """
        middle, room = _middle(self.scene), self.side
        if beside is not None:
            apart = beside.aside + _middle(beside.scene) - middle
            middle = middle + 0.5 * apart
            room += 0.5 * float(np.linalg.norm(apart)) / (1.0 + self.sizes.between)
        if self.scene.n_dims == 2 and (beside is None or beside.scene.n_dims == 2):
            away = self.sizes.view * room * np.array([0.0, -0.02, 1.0])
            return middle + away, middle, np.array([0.0, 1.0, 0.0])
        away = 1.35 * room * np.array([np.cos(self.heading), np.sin(self.heading), 0.65])
        away *= self.sizes.view_of_arms if self.robot is not None else self.sizes.view
        return middle + away, middle, np.array([0.0, 0.0, 1.0])


def _middle(scene: Scene) -> Array:
    return 0.5 * _size(scene) + spatial(scene.lower)


def _size(scene: Scene) -> Array:
    return spatial(scene.upper) - spatial(scene.lower)


def clear(api: Any) -> None:
    """Remove everything but a robot from a viewer's scene. A robot has many meshes."""
    for name in list(api._handle_from_node_name):
        if not name.startswith(ROBOT):
            api.remove_by_name(name)


def demonstrated(scene: Scene, rows: Taught | None = None) -> Array | None:
    """Return a scene's demonstration for every end effector. Return None without one, or where it cannot be read.

    Parameters
    ----------
    rows : movement that replaces it
    """
    try:
        taught = movements_of(demonstration_of(scene) if rows is None else demonstration_from(rows), scene)
        return None if taught is None else carried_demonstration(taught, scene)
    except (ComoveError, OSError):
        return None


def _same_bodies(first: tuple[Piece, ...], second: tuple[Piece, ...]) -> bool:
    return all(
        a.surface.vertices.shape == b.surface.vertices.shape
        and np.allclose(a.surface.vertices, b.surface.vertices, atol=1e-6)
        for a, b in zip(first, second, strict=True)
    )
