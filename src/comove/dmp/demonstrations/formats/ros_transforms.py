"""Movements of one frame in another, from ROS transforms.

As in tf2, each frame has one parent, transforms between their stamps are interpolated (positions linearly,
orientations along the shortest turn), and transforms that are constant hold at all times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from comove.arrays import Array, Integers
from comove.dmp.demonstrations.cleaning import NORM_TOLERANCE, without_sign_changes
from comove.dmp.demonstrations.resampling import slerp
from comove.dmp.demonstrations.samples import fault
from comove.errors import DemonstrationError, listed, near_name
from comove.geometry.rotations import conjugate, matrices, quaternion_product

_Pose = tuple[Array, Array]
"""Positions (n_steps, 3) [m] and unit quaternions w x y z (n_steps, 4); n_steps is 1 for a constant pose."""


STILL = 1e-12
"""Largest change of a constant transform: of positions [m], and of quaternions."""


@dataclass(frozen=True)
class Transforms:
    """Poses of the frame `child` in the frame `parent`, with increasing stamps.

    Attributes
    ----------
    stamps : array, shape (n_steps,), [ns]
    position, orientation : arrays, shapes (n_steps, 3) [m] and (n_steps, 4), quaternions w x y z
    """

    child: str
    parent: str
    stamps: Integers
    position: Array
    orientation: Array
    notes: tuple[str, ...] = ()

    @cached_property
    def is_moving(self) -> bool:
        """Return whether any pose differs from the first."""
        poses = np.concatenate((self.position, self.orientation), axis=1)
        return not bool((np.abs(poses - poses[0]) <= STILL).all())

    def at(self, stamps: Integers) -> _Pose:
        """Return the poses at stamps within the range, or the constant one."""
        if not self.is_moving:
            return self.position[:1], self.orientation[:1]
        if np.array_equal(stamps, self.stamps):
            return self.position, self.orientation
        zero = self.stamps[0]
        time, at = (self.stamps - zero) / 1e9, (stamps - zero) / 1e9
        position = np.stack([np.interp(at, time, column) for column in self.position.T], axis=1)
        return position, slerp(time, without_sign_changes(self.orientation)[0], at)


class TransformTree:
    """Frames and the transforms between neighbours.

    Parameters
    ----------
    path, topic : place of the transforms in messages
    transforms : those of each pair of neighbours
    """

    def __init__(self, path: Path, topic: str, transforms: Sequence[Transforms]) -> None:
        self.path, self.topic = path, topic
        self.edges = {(one.child, one.parent): one for one in transforms}
        self.parents: dict[str, list[str]] = {}
        for child, parent in self.edges:
            self.parents.setdefault(child, []).append(parent)

    def movements(self) -> dict[str, Transforms]:
        """Return the moving transform as "", or all ends' as CHILD@PARENT. The ends are those of the tree that move.

        Raises
        ------
        DemonstrationError
            If no frame moves, or frames have several parents or go round in a circle.
        """
        moving = [one for one in self.edges.values() if one.is_moving]
        if not moving:
            raise fault(
                self.path,
                self.topic,
                f"none of its frames moves: {listed([f'{child} in {parent}' for child, parent in self.edges], 10)}",
                "choose another topic",
            )
        if len(moving) == 1:
            return {"": moving[0]}
        found, refusal = dict[str, Transforms](), None
        ends = {one.child for one in moving} | set(self.parents) - {parent for _, parent in self.edges}
        for end in sorted(ends):
            try:
                chain = self._chain(end)
            except DemonstrationError as error:
                refusal = error
                continue
            is_end = not any(one.parent == end for one in self.edges.values())
            if is_end and any(one.is_moving for one in chain):
                found[f"{end}@{chain[-1].parent}"] = self._resolved(end, chain[-1].parent)
        if not found and refusal is not None:
            raise refusal
        return found

    def movement(self, name: str) -> Transforms:
        """Return the movement CHILD@PARENT, or CHILD in its root.

        Raises
        ------
        DemonstrationError
            If a frame is unknown, no transforms lead from one to the other, frames have several parents or go round
            in a circle, or the stamps have no common time.
        """
        child, _, parent = name.partition("@")
        frames = dict.fromkeys(frame for edge in self.edges for frame in edge)
        for frame in filter(None, (child, parent)):
            if frame not in frames:
                raise self._fault(f"there is no frame {frame!r}", near_name(frame, sorted(frames)))
        if (child, parent) in self.edges:
            return self.edges[child, parent]
        if not parent:
            chain = self._chain(child)
            if not chain:
                raise self._fault(f"{child!r} is the root of its tree", f"name two frames: CHILD@{child}")
            parent = chain[-1].parent
        return self._resolved(child, parent)

    def _fault(self, message: str, way_out: str, pair: Sequence[str] = ()) -> DemonstrationError:
        """Return an error; `pair` are frames of a readable movement."""
        if not pair:
            return fault(self.path, self.topic, message, way_out)
        name = f"{self.topic}:{pair[0]}@{pair[1]}"
        return fault(self.path, self.topic, message, f"{way_out}, such as {name}", topic=name)

    def _chain(self, frame: str) -> list[Transforms]:
        """Return the transforms from a frame up to its root."""
        chain: list[Transforms] = []
        while parents := self.parents.get(frame):
            if len(parents) > 1:
                raise self._fault(
                    f"the frame {frame!r} has {len(parents)} parents: {listed(parents, 10)}",
                    "name two frames with one way between them",
                    (frame, parents[0]),
                )
            chain.append(self.edges[frame, parents[0]])
            frame = parents[0]
            passed = [one.child for one in chain]
            if frame in passed:
                circle = [*passed[passed.index(frame) :], frame]
                raise self._fault(
                    f"its frames go round in a circle: {listed(circle, 10)}",
                    "name two neighbours",
                    circle[:2],
                )
        return chain

    def _resolved(self, child: str, parent: str) -> Transforms:
        """Return a frame's poses in another, at the most frequent stamps."""
        up, down = self._chain(child), self._chain(parent)
        above = [child, *(one.parent for one in up)]
        shared = [frame for frame in above if frame in (parent, *(one.parent for one in down))]
        if not shared or child == parent:
            raise self._fault(
                f"no transforms lead from {parent!r} to {child!r}",
                f"name another frame for {child!r}: its tree begins at {above[-1]!r}"
                if child != parent
                else "name two frames",
            )
        top = shared[0]
        up = up[: above.index(top)]
        down = down[: [parent, *(one.parent for one in down)].index(top)]
        up, down = [self._unit(one) for one in up], [self._unit(one) for one in down]
        moving = [one for one in (*up, *down) if one.is_moving]
        if not moving:
            raise self._fault(f"{child!r} does not move in {parent!r}", "name another frame")
        first = max(int(one.stamps[0]) for one in moving)
        last = min(int(one.stamps[-1]) for one in moving)
        leading = max(moving, key=lambda one: np.count_nonzero((one.stamps >= first) & (one.stamps <= last)))
        stamps = leading.stamps[(leading.stamps >= first) & (leading.stamps <= last)]
        if len(stamps) < 2:
            spans = listed([f"{one.child} in {one.parent}" for one in moving], 10)
            raise self._fault(
                f"the transforms between {parent!r} and {child!r} have no common time: {spans}",
                "name two neighbours",
                (moving[0].child, moving[0].parent),
            )
        position, orientation = _after(_inverse(_product(down, stamps)), _product(up, stamps))
        notes = tuple(dict.fromkeys(note for one in moving for note in one.notes))
        if uneven := [one for one in moving if not np.array_equal(one.stamps, stamps)]:
            holes = [int(np.diff(one.stamps[_around(one.stamps, first, last)]).max()) for one in uneven]
            note = f"transforms interpolated as tf2 does, over {max(holes) / 1e9:.3g} s at most"
            notes = (*notes, note)
        return Transforms(child, parent, stamps, position, orientation, notes)

    def _unit(self, one: Transforms) -> Transforms:
        """Return transforms with unit quaternions; raise if one is far off."""
        norm = np.linalg.norm(one.orientation, axis=1, keepdims=True)
        bad = ~(np.abs(norm - 1.0) <= NORM_TOLERANCE)
        if bad.any():
            quaternion = one.orientation[int(np.argmax(bad))].tolist()
            raise self._fault(
                f"a transform from {one.parent!r} to {one.child!r} has the quaternion {quaternion}, whose norm is "
                "not 1",
                f"name two frames with another way between them; those of {self.topic}:{one.child}@{one.parent} are "
                "read without turning",
            )
        return replace(one, orientation=one.orientation / norm)


def _around(stamps: Integers, first: int, last: int) -> slice:
    start = max(int(np.searchsorted(stamps, first, side="right")) - 1, 0)
    return slice(start, int(np.searchsorted(stamps, last)) + 1)


def _product(chain: Sequence[Transforms], stamps: Integers) -> _Pose:
    """Return the first child's pose in a chain's last parent."""
    pose: _Pose = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    for one in chain:
        pose = _after(one.at(stamps), pose)
    return pose


def _after(outer: _Pose, inner: _Pose) -> _Pose:
    """Return the composition of poses, `inner` given in `outer`."""
    turned = (matrices(outer[1]) @ inner[0][:, :, None])[:, :, 0]
    return outer[0] + turned, quaternion_product(outer[1], inner[1])


def _inverse(pose: _Pose) -> _Pose:
    turned = conjugate(pose[1])
    return -(matrices(turned) @ pose[0][:, :, None])[:, :, 0], turned
