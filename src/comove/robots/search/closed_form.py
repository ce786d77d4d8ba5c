"""Inverse kinematics in closed form, for arms whose geometry allows it.

An arm is a product of exponentials, ``T = exp(s_1 q_1) ... exp(s_n q_n) M`` (Brockett, 1984): s_i is the axis of
joint i at zero, M the grasp there. Read from the grasp to the base it is a product of exponentials again, ``T^-1``,
of the same axes in the other order with the other sign; so a shoulder whose axes meet in a point serves as well as a
wrist. A redundant arm has one joint that is given; with it, the axes of the joints after it are turned, and there are
six joints left. They are solved by the subproblems of Paden (1985) and Kahan, where

============== =============================================================== =====================
form           axes, in the order in which joints are solved                   arms
============== =============================================================== =====================
`WRIST_MEET_1` 4, 5, 6 meet in a point, and 1, 2 do                            Panda, xArm7, iiwa, PR2
`WRIST_MEET_2` 4, 5, 6 meet in a point, and 2, 3 do                            shoulders with an offset
`WRIST_ALONG`  4, 5, 6 meet in a point, and 2, 3 are parallel                  most of industry's
`ALONG`        2, 3, 4 are parallel, and 5, 6 meet in a point                  Universal Robots
============== =============================================================== =====================

Joints that a pose leaves free, as two axes of a wrist in line do, are set to their values at zero. Solutions are as
exact as the description's geometry, which is often rounded to a few digits: `chains.reach_pose` does the rest.
"""

from __future__ import annotations

from itertools import product
from math import acos, atan2, pi
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.robots.search.chains import Chains, place_arm
from comove.robots.search.triples import (
    Triple,
    about,
    about_axis,
    cross,
    dot,
    length,
    plus,
    rotated,
    rotated_back,
)

WRIST_MEET_1, WRIST_MEET_2, WRIST_ALONG, ALONG = range(4)
N_BRANCHES = 8  # solutions of six joints at most
FLAT = 1e-4  # m and rad, within which axes meet or are parallel: digits of published models
TOUCHING = 1e-6  # by which the cosine of an angle may exceed 1: the edge of what an arm reaches, and rounding


class ClosedForm(NamedTuple):
    """The geometry of an arm, and its closed form.

    Attributes
    ----------
    kind : form of the six joints that are solved
    free : number of the joint that is given, in the arm; -1 where there is none
    back : whether the arm is read from the grasp to the base
    axis, point : arrays, shape (n_joints of the arm, 3): directions of the axes at zero in the scene, and points on
        them [m]
    tool_rotation, tool_offset : arrays, shape (3, 3) and (3,): the grasp at zero, in the scene
    """

    kind: int
    free: int
    back: bool
    axis: Array
    point: Array
    tool_rotation: Array
    tool_offset: Array


def closed_form(chains: Chains, arm: int) -> ClosedForm | None:
    """Return an arm's closed form; None if its geometry has none known here.

    Of the joints of a redundant arm that may be given, the last is preferred, which moves the end effector alone,
    then the first; the elbow comes last, as it nearly follows from the distance of the end effector.
    """
    preferred = (6, 0, 1, 2, 4, 5, 3)
    part = slice(chains.first[arm], chains.first[arm + 1])
    n = int(part.stop - part.start)
    if n not in (6, 7) or chains.slides[part].any():
        return None
    rotations, points = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    place_arm(chains, arm, np.zeros(len(chains.lower)), rotations, points)
    axis = np.einsum("kij,kj->ki", rotations[:n], chains.axis[part])
    tool = rotations[n].copy(), points[n].copy()
    for free, back in product(preferred if n == 7 else (-1,), (False, True)):
        kind = _kind(axis, points[:n], free, 0.4, back)
        if kind is not None and all(
            _kind(axis, points[:n], free, angle, back) == kind for angle in (1.3, -2.1)
        ):
            return ClosedForm(kind, free, back, axis, points[:n].copy(), *tool)
    return None


def _kind(axis: Array, point: Array, free: int, angle: float, back: bool) -> int | None:
    """Return the form of the joints that remain besides a given one. None if it is unknown."""
    h, r = np.empty((6, 3)), np.empty((6, 3))
    remaining_axes(axis, point, free, angle, back, h, r)
    lines = list(zip(h, r, strict=True))
    if _meet(*lines[4:]) and _meet(*lines[3:5]) and _concurrent(lines[3:]):
        for kind, (i, j) in ((WRIST_MEET_1, (0, 1)), (WRIST_MEET_2, (1, 2))):
            if _meet(lines[i], lines[j]):
                return kind
        return WRIST_ALONG if _parallel(h[1], h[2]) and not _parallel(h[0], h[1]) else None
    parallel = _parallel(h[1], h[2]) and _parallel(h[2], h[3])
    apart = not (_parallel(h[0], h[1]) or _parallel(h[3], h[4]))
    return ALONG if parallel and apart and _meet(*lines[4:]) else None


def _parallel(h: Array, k: Array) -> bool:
    return bool(np.linalg.norm(np.cross(h, k)) < FLAT)


def _meet(one: tuple[Array, Array], two: tuple[Array, Array]) -> bool:
    (h, r), (k, s) = one, two
    across = np.cross(h, k)
    size = float(np.linalg.norm(across))
    return size > 0.1 and abs(float(across @ (s - r))) < FLAT * size


def _concurrent(lines: list[tuple[Array, Array]]) -> bool:
    """Return whether three lines meet in one point."""
    pairs = ((lines[0], lines[1]), (lines[1], lines[2]))
    one, two = (np.array(meeting(*(tuple(v.tolist()) for v in (h, r, k, s)))) for (h, r), (k, s) in pairs)
    return bool(np.abs(one - two).max() < FLAT)


@kernel
def remaining_axes(
    axis: Array, point: Array, free: int, angle: float, back: bool, h: Array, r: Array
) -> None:
    """Write the six remaining axes, in solving order, with `free` at `angle`.

    Parameters
    ----------
    h, r : results, arrays of shape (6, 3): directions and points [m]
    """
    row = 0
    for step in range(axis.shape[0]):
        k = axis.shape[0] - 1 - step if back else step
        if k == free:
            continue
        d, p = (axis[k, 0], axis[k, 1], axis[k, 2]), (point[k, 0], point[k, 1], point[k, 2])
        if 0 <= free < k:
            pivot = (axis[free, 0], axis[free, 1], axis[free, 2])
            at = (point[free, 0], point[free, 1], point[free, 2])
            d, p = about(pivot, angle, d), about_axis(pivot, at, angle, p)
        for x in range(3):
            h[row, x], r[row, x] = d[x], p[x]
        row += 1


@kernel
def meeting(h: Triple, r: Triple, k: Triple, s: Triple) -> Triple:
    """Return the middle of the nearest points of two axes. They have unit directions h, k through r, s."""
    c, w = dot(h, k), plus(s, r, -1.0)
    a, b, det = dot(h, w), dot(k, w), 1.0 - c * c
    one, two = plus(r, h, (a - c * b) / det), plus(s, k, (c * a - b) / det)
    return plus((0.5 * one[0], 0.5 * one[1], 0.5 * one[2]), two, 0.5)


@kernel
def turn_onto(k: Triple, v: Triple, w: Triple) -> float:
    """Return the angle about k that turns v nearest to w [rad]. It is 0 where v lies on the axis."""
    y, x = dot(k, cross(v, w)), dot(v, w) - dot(k, v) * dot(k, w)
    return 0.0 if abs(x) + abs(y) < 1e-12 else atan2(y, x)


@kernel
def turns_to_height(k: Triple, v: Triple, h: Triple, height: float) -> tuple[int, float, float]:
    """Return the number and angles [rad] of turns to a height. They turn v about k to ``h . v = height``."""
    along = dot(k, v) * dot(h, k)
    a, b = dot(h, v) - along, dot(h, cross(k, v))
    size = (a * a + b * b) ** 0.5
    if size < 1e-12:
        return (1, 0.0, 0.0) if abs(height - along) < TOUCHING else (0, 0.0, 0.0)
    share = (height - along) / size
    if abs(share) > 1.0 + TOUCHING:
        return 0, 0.0, 0.0
    middle, half = atan2(b, a), acos(min(1.0, max(-1.0, share)))
    return 2, middle + half, middle - half


@kernel
def turns_to_distance(k: Triple, v: Triple, w: Triple, distance: float) -> tuple[int, float, float]:
    """Return the number and angles [rad] of turns to a distance. They turn v about k to it from w."""
    return turns_to_height(k, v, w, 0.5 * (dot(v, v) + dot(w, w) - distance * distance))


@kernel
def solve_in_closed_form(form: ClosedForm, rotation: Array, point: Array, angle: float, out: Array) -> int:
    """Write all joints at which the grasp has a pose. The joint `form.free` is at `angle` [rad].

    Parameters
    ----------
    rotation, point : arrays, shape (3, 3) and (3,): the pose in the scene
    out : result, array of shape (N_BRANCHES, n_joints of the arm), angles in [-pi, pi]; a solution branch keeps its
        row, and rows without a solution are nan

    Returns
    -------
    The number of solutions.
    """
    h, r = np.empty((6, 3)), np.empty((6, 3))
    remaining_axes(form.axis, form.point, form.free, angle, form.back, h, r)
    turn, shift = np.empty((3, 3)), np.empty(3)
    _displacement(form, rotation, point, angle, turn, shift)
    six = np.full((N_BRANCHES, 6), np.nan)
    if form.kind == ALONG:
        _solve_along(h, r, turn, shift, six)
    else:
        _solve_wrist(form.kind, h, r, turn, shift, six)
    count = 0
    for branch in range(N_BRANCHES):
        found = not np.isnan(six[branch, 0])
        count += found
        row = 0
        for step in range(out.shape[1]):
            k = out.shape[1] - 1 - step if form.back else step
            if k == form.free:
                out[branch, k] = angle if found else np.nan
                continue
            value = -six[branch, row] if form.back else six[branch, row]
            out[branch, k] = value - 2.0 * pi * np.round(value / (2.0 * pi))
            row += 1
    return count


@kernel
def _displacement(
    form: ClosedForm, rotation: Array, point: Array, angle: float, turn: Array, shift: Array
) -> None:
    """Write the grasp's displacement by the six joints, as rotation and shift.

    It is T M^-1 without the given joint, and the inverse of that where the arm is read back.
    """
    for a in range(3):
        for b in range(3):
            turn[a, b] = 0.0
            for c in range(3):
                turn[a, b] += rotation[a, c] * form.tool_rotation[b, c]
    grasp = (form.tool_offset[0], form.tool_offset[1], form.tool_offset[2])
    if form.free >= 0:  # T M^-1 exp(-s q): rows turn as vectors do
        pivot, at = _line(form.axis, form.point, form.free)
        grasp = about_axis(pivot, at, angle, grasp)
        for a in range(3):
            row = about(pivot, angle, (turn[a, 0], turn[a, 1], turn[a, 2]))
            turn[a, 0], turn[a, 1], turn[a, 2] = row
    moved = rotated(turn, grasp)
    for a in range(3):
        shift[a] = point[a] - moved[a]
    if form.back:
        moved = rotated_back(turn, shift)
        for a in range(3):
            shift[a] = -moved[a]
        for a in range(3):
            for b in range(a):
                turn[a, b], turn[b, a] = turn[b, a], turn[a, b]


@kernel
def _line(h: Array, r: Array, i: int) -> tuple[Triple, Triple]:
    return (h[i, 0], h[i, 1], h[i, 2]), (r[i, 0], r[i, 1], r[i, 2])


@kernel
def _solve_wrist(kind: int, h: Array, r: Array, turn: Array, shift: Array, out: Array) -> None:
    """Solve arms whose last three axes meet.

    The first three joints take that point to its place, the last three turn the end effector.
    """
    h4, r4 = _line(h, r, 3)
    h5, r5 = _line(h, r, 4)
    center = meeting(h4, r4, h5, r5)
    target = plus(rotated(turn, center), (shift[0], shift[1], shift[2]))
    first = np.full((4, 3), np.nan)
    if kind == WRIST_ALONG:
        _place_along(h, r, center, target, first)
    else:
        _place_meeting(h, r, kind == WRIST_MEET_2, center, target, first)
    for i in range(4):
        if not np.isnan(first[i, 0]):
            _turn_hand(h, turn, first[i], out[2 * i : 2 * i + 2])


@kernel
def _place_meeting(h: Array, r: Array, back: bool, center: Triple, target: Triple, out: Array) -> None:
    """Write the first three joints where axes 1 and 2 meet; array, shape (4, 3).

    Read `back`, where 2 and 3 do: turned the other way, the joints take the wrist from its place to that at zero.
    """
    first, last, sign = (2, 0, -1.0) if back else (0, 2, 1.0)
    if back:
        center, target = target, center
    h1, r1 = _line(h, r, first)
    h2, r2 = _line(h, r, 1)
    h3, r3 = _line(h, r, last)
    o = meeting(h1, r1, h2, r2)
    w = plus(target, o, -1.0)
    n, a, b = turns_to_distance(h3, plus(center, r3, -1.0), plus(o, r3, -1.0), length(w))
    for i in range(n):
        q3 = a if i == 0 else b
        v = plus(about_axis(h3, r3, q3, center), o, -1.0)
        m, c, d = turns_to_height(h2, v, h1, dot(h1, w))
        for j in range(m):
            q2 = c if j == 0 else d
            row = 2 * i + j
            out[row, first] = sign * turn_onto(h1, about(h2, q2, v), w)
            out[row, 1], out[row, last] = sign * q2, sign * q3


@kernel
def _place_along(h: Array, r: Array, center: Triple, target: Triple, out: Array) -> None:
    """Write the first three joints where axes 2 and 3 are parallel; array, shape (4, 3)."""
    h1, r1 = _line(h, r, 0)
    h2, r2 = _line(h, r, 1)
    h3, r3 = _line(h, r, 2)
    n, a, b = turns_to_height(h1, plus(target, r1, -1.0), h2, dot(h2, plus(center, r1, -1.0)))
    for i in range(n):
        back = a if i == 0 else b
        w = plus(about_axis(h1, r1, back, target), r2, -1.0)
        m, c, d = turns_to_distance(h3, plus(center, r3, -1.0), plus(r2, r3, -1.0), length(w))
        for j in range(m):
            q3 = c if j == 0 else d
            v = plus(about_axis(h3, r3, q3, center), r2, -1.0)
            row = 2 * i + j
            out[row, 0], out[row, 1], out[row, 2] = -back, turn_onto(h2, v, w), q3


@kernel
def _turn_hand(h: Array, turn: Array, first: Array, out: Array) -> None:
    """Write both solutions from the first three joints; array, shape (2, 6). The last axes meet."""
    h4, h5, h6 = (h[3, 0], h[3, 1], h[3, 2]), (h[4, 0], h[4, 1], h[4, 2]), (h[5, 0], h[5, 1], h[5, 2])
    last = rotated(turn, h6)  # where the sixth axis has to be, brought back by the first three joints
    for j in range(3):
        last = about((h[j, 0], h[j, 1], h[j, 2]), -first[j], last)
    n, a, b = turns_to_height(h5, h6, h4, dot(h4, last))
    for i in range(n):
        q5 = a if i == 0 else b
        q4 = turn_onto(h4, about(h5, q5, h6), last)
        across = about(h4, q4, about(h5, q5, _across(h6)))  # where it would be without the sixth joint
        for j in range(2, -1, -1):
            across = about((h[j, 0], h[j, 1], h[j, 2]), first[j], across)
        for j in range(3):
            out[i, j] = first[j]
        out[i, 3], out[i, 4] = q4, q5
        out[i, 5] = turn_onto(h6, rotated_back(turn, across), _across(h6))


@kernel
def _across(h: Triple) -> Triple:
    """Return a unit vector perpendicular to h."""
    unit = (1.0, 0.0, 0.0) if abs(h[0]) < 0.6 else (0.0, 1.0, 0.0)
    v = cross(h, unit)
    size = length(v)
    return v[0] / size, v[1] / size, v[2] / size


@kernel
def _solve_along(h: Array, r: Array, turn: Array, shift: Array, out: Array) -> None:
    """Solve arms with axes 2, 3, 4 parallel and 5, 6 meeting; array, shape (8, 6)."""
    h1, r1 = _line(h, r, 0)
    h2, r2 = _line(h, r, 1)
    _, r3 = _line(h, r, 2)
    _, r4 = _line(h, r, 3)
    h5, r5 = _line(h, r, 4)
    h6, r6 = _line(h, r, 5)
    center = meeting(h5, r5, h6, r6)
    target = plus(rotated(turn, center), (shift[0], shift[1], shift[2]))
    n, a, b = turns_to_height(h1, plus(target, r1, -1.0), h2, dot(h2, plus(center, r1, -1.0)))
    for i in range(n):
        back = a if i == 0 else b
        wrist, last = about_axis(h1, r1, back, target), about(h1, back, rotated(turn, h6))
        m, c, d = turns_to_height(h5, h6, h2, dot(h2, last))
        for j in range(m):
            q5 = c if j == 0 else d
            # what the parallel joints leave where it is tells the sixth, and what they move, how far they turn
            q6 = turn_onto(h6, rotated_back(turn, about(h1, -back, h2)), about(h5, -q5, h2))
            seen = h6 if length(cross(h2, about(h5, q5, h6))) > 1e-6 else _across(h6)
            after = about(h1, back, rotated(turn, seen))
            together = turn_onto(h2, about(h5, q5, about(h6, q6, seen)), after)
            elbow = plus(wrist, about(h2, together, plus(center, r4, -1.0)), -1.0)  # of the fourth axis
            w = plus(elbow, r2, -1.0)
            k, e, f = turns_to_distance(h2, plus(r4, r3, -1.0), plus(r2, r3, -1.0), length(w))
            for l in range(k):
                q3 = e if l == 0 else f
                q2 = turn_onto(h2, plus(about_axis(h2, r3, q3, r4), r2, -1.0), w)
                row = 4 * i + 2 * j + l
                out[row, 0], out[row, 1], out[row, 2] = -back, q2, q3
                out[row, 3], out[row, 4], out[row, 5] = together - q2 - q3, q5, q6


@kernel
def nearest_turns(chains: Chains, first: int, posture: Array, q: Array) -> float:
    """Shift an arm's joints by whole turns towards `posture`, in place. They stay inside their limits.

    Parameters
    ----------
    first : number of the arm's first joint
    posture : array, shape (n_joints,), of all arms [rad]
    q : array, shape (n_joints of the arm,)

    Returns
    -------
    The largest difference of a joint from its posture [rad]; infinite where a joint cannot be inside its limits.
    """
    away = 0.0
    for k in range(q.shape[0]):
        j = first + k
        value = q[k] + 2.0 * pi * np.round((posture[j] - q[k]) / (2.0 * pi))
        if value > chains.upper[j]:
            value -= 2.0 * pi * np.ceil((value - chains.upper[j]) / (2.0 * pi))
        elif value < chains.lower[j]:
            value += 2.0 * pi * np.ceil((chains.lower[j] - value) / (2.0 * pi))
        if not chains.lower[j] <= value <= chains.upper[j]:  # nan as well
            return np.inf
        q[k] = value
        away = max(away, abs(value - posture[j]))
    return away


@kernel
def closed_seeds(
    form: ClosedForm, chains: Chains, arm: int, rotation: Array, point: Array, posture: Array, n_angles: int
) -> Array:
    """Return an arm's joints at a pose, on every solution branch.

    They are the nearest to a posture inside their limits. The given joint takes `n_angles` angles; where a branch
    ends and begins again, or comes nearer to the posture again, there is one result more.

    Parameters
    ----------
    rotation, point : arrays, shape (3, 3) and (3,): the pose in the scene
    posture : array, shape (n_joints,), of all arms [rad]

    Returns
    -------
    array, shape (n_found, n_joints), `posture` for the joints of other arms
    """
    first, n = chains.first[arm], chains.first[arm + 1] - chains.first[arm]
    steps = n_angles if form.free >= 0 else 1
    found, away = np.empty((steps, N_BRANCHES, n)), np.full((steps + 2, N_BRANCHES), np.inf)
    for step in range(steps):
        angle = 0.0
        if form.free >= 0:
            low, high = chains.lower[first + form.free], chains.upper[first + form.free]
            angle = low + (step + 0.5) / steps * (high - low)
        solve_in_closed_form(form, rotation, point, angle, found[step])
        for branch in range(N_BRANCHES):
            away[step + 1, branch] = nearest_turns(chains, first, posture, found[step, branch])
    out, count = np.empty((steps * N_BRANCHES, posture.shape[0])), 0
    for branch in range(N_BRANCHES):
        for step in range(steps):
            here = away[step + 1, branch]
            if here < np.inf and here < away[step, branch] and here <= away[step + 2, branch]:
                for j in range(posture.shape[0]):
                    inside = first <= j < first + n
                    out[count, j] = found[step, branch, j - first] if inside else posture[j]
                count += 1
    return out[:count]
