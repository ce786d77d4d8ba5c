"""Links as capsules, the model of a robot's bodies in a search.

Capsules are fast, and wider than the bodies that they hold. The verification works on the exact geometry.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.contacts.displaced import RESTING, Instant
from comove.contacts.query import ball_about
from comove.contacts.rods import nearest_shares, rod_distance, rods_distance
from comove.geometry.solids import N_CORNERS
from comove.model.moving import Displacements
from comove.model.scene import Scene, of_geometry
from comove.planning.timing import fastest_point
from comove.robots.model import Arm, Robot, pin
from comove.robots.search.capsules import LinkCapsule, capsules_of, vertices_of
from comove.robots.search.chains import Chains, chains_of, place_arm

STATIC = -1
ENOUGH = 0.05  # m, beyond what is asked for: distances above it are not told apart
ROUGH = 1e-3  # m, of distances to obstacles
FAT = 0.01  # m, by which capsules may come nearer to something than bodies may: they are about as much wider
FATTEST = 0.02  # m, likewise where a capsule is as much wider as any
STILL = Displacements.of(np.zeros((0, 0, 3)), np.zeros((0, 3)))  # of obstacles that do not move


class HandOrientation(NamedTuple):
    """Orientations of end effectors on a payload, for kernels; see `comove.model.grasp.Grasp`.

    Attributes
    ----------
    at_rest, turning : arrays, shape (n_arms, 3, 3) and (n_arms,), as of a `Grasp`
    first, second : indices of the end effectors that define the heading; equal where one holds the payload alone
    keypoints : array of int, shape (3,), keypoints that define the orientation; (0,) where end effectors do
    """

    at_rest: Array = np.zeros((0, 3, 3))
    turning: NDArray[np.bool_] = np.zeros(0, dtype=bool)
    first: int = 0
    second: int = 0
    keypoints: Integers = np.zeros(0, dtype=np.int64)


class LinkSurroundings(NamedTuple):
    """The arms' surroundings for kernels: obstacles, payload and grasps.

    Attributes
    ----------
    obstacles : array, shape (n_obstacles, N_COLUMNS), table of the obstacles at 0 s
    edges, radii : arrays, shape (n_edges, 2) and (n_edges,), rods of the payload: their end keypoints and radii [m]
    clearance : required clearance of the links [m]
    eased : reduction of the required clearance between links [m]
    spare : additional clearance that a search keeps [m]
    share : share of the limits of rates and torques that a search uses
    hold : grasps of the end effectors
    carried : array, shape (n_arms,), mass at each end effector [kg]
    posture : array, shape (n_joints,), home, to which redundant joints are drawn at the ends
    ends : array, shape (2, n, 3), the first keypoints at start and goal, end effectors at least [m]
    moved : displacements of the obstacles at even times of the movement; none if nothing moves
    fastest : largest speed of a point of an obstacle [m a duration]
    """

    obstacles: Array
    edges: Integers
    radii: Array
    clearance: float
    eased: float
    spare: float = 0.0
    share: float = 1.0
    hold: HandOrientation = HandOrientation()
    carried: Array = np.zeros(0)
    posture: Array = np.zeros(0)
    ends: Array = np.zeros((2, 0, 3))
    moved: Displacements = STILL
    fastest: float = 0.0

    def in_motion(self, scene: Scene, n_intervals: int = 400) -> LinkSurroundings:
        """Return the same with the motion of a scene's obstacles."""
        if not scene.moving.any():
            return self
        moved = scene.displacements(np.linspace(0.0, scene.duration, n_intervals + 1))
        return self._replace(moved=moved, fastest=fastest_point(scene.obstacles, moved))


class Links(NamedTuple):
    """Bodies as capsules in the frames of the joints that move them.

    Attributes
    ----------
    joint : array, shape (n_links,), index into the chains' joints, `STATIC` for a link that does not move
    arm : array, shape (n_links,), index of the arm, -1 for a link that does not move
    start, end : arrays, shape (n_links, 3), ends of the capsule's axis [m]; in the scene's frame for static links
    radius : array, shape (n_links,), radius of the capsule [m]
    reach : array, shape (n_links,), radius of the ball about its middle that holds it [m]
    pairs : array, shape (n_pairs, 2), pairs of links that must not meet, run by run
    wider : array, shape (n_pairs,), amount by which the capsules of a pair are nearer than its bodies [m]
    runs : array, shape (n_runs, 4), the groups of both links, then first and last (exclusive) row of the pairs
    group : array, shape (n_links,), group of links that move together, or of near ones of a static body
    group_first : array, shape (n_groups + 1,), first link of each group, about which its others are, then n_links
    group_reach, group_radius : arrays, shape (n_groups,), radii of a ball about the middle of the first link, and of
        a capsule about its axis, that hold the group [m]
    holds : array, shape (n_links,), whether the link is part of the end effector, which touches the payload
    moving : array, shape (n_moving,), indices of the links that move, arm by arm
    """

    joint: Integers
    arm: Integers
    start: Array
    end: Array
    radius: Array
    reach: Array
    pairs: Integers
    wider: Array
    runs: Integers
    group: Integers
    group_first: Integers
    group_reach: Array
    group_radius: Array
    holds: NDArray[np.bool_]
    moving: Integers

    def some(self, which: NDArray[np.bool_]) -> Links:
        """Keep only some of the pairs; array, shape (n_pairs,)."""
        pairs = self.pairs[which]
        return self._replace(pairs=pairs, wider=self.wider[which], runs=_runs(self.group[pairs]))

    def of(self, arm: int) -> Links:
        """Keep the links of one arm, with their own and static pairs."""
        others = (self.arm != arm) & (self.arm >= 0)
        own = self.some(~others[self.pairs].any(axis=1))
        return own._replace(moving=self.moving[self.arm[self.moving] == arm])


@of_geometry
def load_lines(scene: Scene) -> tuple[Integers, Array]:
    """Return lines that represent a payload, and their radii.

    They are rods, the edges and face diagonals of boxes, and the edges of triangles that bound other solids.

    Returns
    -------
    edges, radii : arrays, shape (n_edges, 2) and (n_edges,), numbers of keypoints, and [m]
    """
    body = scene.body
    lines = [(a, b) for a in range(N_CORNERS) for b in range(a) if (a ^ b).bit_count() < 3]
    are_boxes = body.solids.shape[1] == N_CORNERS
    nodes = scene.nodes_at("start")
    pairs = [
        (corners[a], corners[b])
        for corners in body.solids
        for a, b in (lines if are_boxes else _hull_edges(nodes[np.unique(corners)]))
    ]
    lattice = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return np.concatenate([body.edges, lattice]), np.concatenate([body.radii, np.zeros(len(lattice))])


def _hull_edges(points: Array) -> list[tuple[int, int]]:
    """Return the triangle edges of a hull, as pairs; `points` is (n, 3)."""
    from scipy.spatial import ConvexHull  # slow to import, and only meshes need it

    simplices = ConvexHull(points).simplices
    edges = np.unique(np.sort(simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return [(int(a), int(b)) for a, b in edges]


def links_of(robot: Robot, arms: tuple[Arm, ...], *, meeting: float = 0.02) -> Links:
    """Build capsules around the collision geometry. Arms that are not among `arms` stay at home.

    Only pairs that provably never come near each other are left out. Capsules are wider than bodies: where a pair of
    them meets at home, it is considered farther apart by the distance of the bodies there (`wider`).

    Parameters
    ----------
    meeting : distance at home up to which capsules count as meeting [m]
    """
    links, bodies = all_links(robot, arms)
    chains, home = chains_of(robot, arms), np.concatenate([arm.home for arm in arms])
    links, apart = links.some(may := _may_meet(chains, links)), pair_distances(chains, links, home[None])[may]
    meets = np.flatnonzero(apart <= meeting)
    exact = body_distances(robot, arms, home, bodies[links.pairs[meets]])
    wider = links.wider.copy()
    wider[meets] = np.maximum(0.0, exact - apart[meets])
    return links._replace(wider=wider)


def recalled(robot: Robot, arms: tuple[Arm, ...], links: Links, q: Array, too_near: float) -> Links:
    """Correct how much `wider` capsules are than bodies, after a rejection.

    Parameters
    ----------
    q : array, shape (n_joints,), joints of `arms` with too near bodies [rad, m for prismatic joints]
    too_near : distance of bodies above which pairs stay as they are [m]
    """
    _, bodies = all_links(robot, arms)
    apart, wider = pair_distances(chains_of(robot, arms), links, q[None]), links.wider.copy()
    some = np.flatnonzero((wider > 0.0) & np.isfinite(apart))
    exact = body_distances(robot, arms, q, bodies[links.pairs[some]])
    is_near = exact < too_near
    some, exact = some[is_near], exact[is_near]
    wider[some] = np.clip(exact - (apart[some] - wider[some]), 0.0, wider[some])
    return links._replace(wider=wider)


def body_distances(robot: Robot, arms: tuple[Arm, ...], q: Array, pairs: Integers) -> Array:
    """Compute distances of collision bodies at some arms' joints, others at home.

    Parameters
    ----------
    q : array, shape (n_joints,), joints of `arms` [rad, m for prismatic joints]
    pairs : array, shape (n_pairs, 2), numbers of bodies

    Returns
    -------
    array, shape (n_pairs,) [m]
    """
    geometry, joints = robot.collision.copy(), robot.home
    joints[np.concatenate([arm.columns for arm in arms])] = q
    geometry.removeAllCollisionPairs()
    unique, which = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
    for first, second in unique.tolist():
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    placed = geometry.createData()
    pin.computeDistances(robot.model, robot.model.createData(), geometry, placed, joints)
    return np.array([result.min_distance for result in placed.distanceResults])[which.ravel()]


def _may_meet(chains: Chains, links: Links) -> NDArray[np.bool_]:
    """Return which pairs may come within `ENOUGH`, as one arm's always do; array, shape (n_pairs,)."""
    root, length = 0.5 * (links.start + links.end), np.linalg.norm(links.end - links.start, axis=1) / 2
    length, slid = (
        length + links.radius,
        np.where(chains.slides, np.maximum(-chains.lower, chains.upper), 0.0),
    )
    for i in links.moving.tolist():
        first, joint = chains.first[links.arm[i]], links.joint[i]
        length[i] += (
            np.linalg.norm(root[i]) + np.linalg.norm(chains.offset[first + 1 : joint + 1], axis=1).sum()
        )
        length[i] += slid[first : joint + 1].sum()
        root[i] = chains.offset[first]
    one, two = links.pairs.T
    apart = np.linalg.norm(root[one] - root[two], axis=1) - length[one] - length[two]
    return (links.arm[one] == links.arm[two]) | (apart <= ENOUGH)


def _runs(groups: Integers) -> Integers:
    """Return `Links.runs` of pairs, whose `groups` have shape (n_pairs, 2)."""
    changes = np.flatnonzero((groups[1:] != groups[:-1]).any(axis=1)) + 1
    first = np.concatenate([np.zeros(min(1, len(groups)), dtype=np.int64), changes])
    return np.column_stack([groups[first], first, np.append(first[1:], len(groups))[: len(first)]])


@lru_cache(maxsize=32)
def all_links(robot: Robot, arms: tuple[Arm, ...]) -> tuple[Links, Integers]:
    """Build capsules with all pairs that move; return them and their bodies."""
    model, collision = robot.model, robot.collision
    columns = np.concatenate([arm.columns for arm in arms])
    of_arm = np.concatenate([np.full(len(arm.columns), i) for i, arm in enumerate(arms)])
    lasts = {int(arm.columns[-1]) for arm in arms}
    data = model.createData()
    pin.forwardKinematics(model, data, robot.home)
    owner, joints, ends, radii = list[int](), list[int](), list[list[Array]](), list[float]()
    clusters, known = list[int](), dict[object, list[LinkCapsule]]()
    for number, item in enumerate(collision.geometryObjects):
        column = model.idx_vs[item.parentJoint] if item.parentJoint else -1
        at = np.flatnonzero(columns == column)
        placement = item.placement if len(at) else data.oMi[item.parentJoint] * item.placement
        for near in _clusters(_known(known, item.geometry, len(at) > 0)):
            clusters += [int(at[0]) if len(at) else len(columns) + len(clusters)] * len(near)
            joints += [int(at[0]) if len(at) else STATIC] * len(near)
            owner += [number] * len(near)
            for start, end, radius in near:
                ends.append([placement.rotation @ p + placement.translation for p in (start, end)])
                radii.append(radius)
    placed, thick = np.array(ends, dtype=float).reshape(-1, 2, 3), np.array(radii, dtype=float)
    numbers, group = np.unique(np.array(clusters, dtype=np.int64), return_inverse=True)
    rods = [_rod_of_group(placed, thick, np.flatnonzero(group == g)) for g in range(len(numbers))]
    first, group_reach, group_radius = np.array(rods).reshape(-1, 3).T.copy()
    is_other = ~np.isin(np.arange(len(thick)), first)
    order = np.lexsort((is_other, group))
    joint, group = np.array(joints, dtype=np.int64)[order], group[order]
    bodies, placed, thick = np.array(owner, dtype=np.int64)[order], placed[order], thick[order]
    of_body = [np.flatnonzero(bodies == number).tolist() for number in range(collision.ngeoms)]
    pairs = [
        (i, j)
        for pair in collision.collisionPairs
        for i in of_body[pair.first]
        for j in of_body[pair.second]
        if joint[i] != STATIC or joint[j] != STATIC
    ]
    pairs.sort(key=lambda pair: (group[pair[0]], group[pair[1]]))
    paired = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    links = Links(
        joint=joint,
        arm=np.where(joint == STATIC, -1, of_arm[joint]),
        start=placed[:, 0].copy(),
        end=placed[:, 1].copy(),
        radius=thick,
        reach=thick + 0.5 * np.linalg.norm(placed[:, 1] - placed[:, 0], axis=1),
        pairs=paired,
        wider=np.zeros(len(paired)),
        runs=_runs(group[paired]),
        group=group,
        group_first=np.searchsorted(group, np.arange(len(numbers) + 1)),
        group_reach=group_reach,
        group_radius=group_radius,
        holds=np.isin(columns[joint], list(lasts)) & (joint != STATIC),
        moving=np.flatnonzero(joint != STATIC),
    )
    return links, bodies


def _clusters(capsules: list[LinkCapsule], most: int = 8) -> list[list[LinkCapsule]]:
    """Divide a body's capsules into compact sets of at most `most`."""
    if len(capsules) <= most:
        return [capsules]
    middles = np.array([0.5 * (capsule.start + capsule.end) for capsule in capsules])
    order = np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable").tolist()
    half = len(order) // 2
    parts = ([capsules[k] for k in some] for some in (order[:half], order[half:]))
    return [cluster for part in parts for cluster in _clusters(part, most)]


def _rod_of_group(ends: Array, radii: Array, group: Integers) -> tuple[int, float, float]:
    """Return the most central of some capsules, with radii about it [m].

    The radii are those of a ball about its middle and of a capsule about its axis that hold all.

    Parameters
    ----------
    ends : array, shape (n_links, 2, 3), ends of the capsules' axes in one frame for each group [m]
    group : array, shape (n,), numbers of the capsules of one group
    """
    points, thick = ends[group].reshape(-1, 3), np.repeat(radii[group], 2)
    away = np.linalg.norm(points - ends[group].mean(axis=1)[:, None], axis=2) + thick
    k = int(away.max(axis=1).argmin())
    (start, end), first = ends[group[k]], ends[group[k], 0]
    axis = end - start
    share = np.clip((points - first) @ axis / max(float(axis @ axis), 1e-18), 0.0, 1.0)
    aside = np.linalg.norm(points - first - share[:, None] * axis, axis=1) + thick
    aside[2 * k : 2 * k + 2] = radii[group[k]]  # without rounding
    return int(group[k]), float(away[k].max()), float(aside.max())


def _known(known: dict[object, list[LinkCapsule]], shape: Any, moves: bool) -> list[LinkCapsule]:
    """Return the capsules of a shape, computed once for equal meshes. Two arms often are of one make."""
    if not hasattr(shape, "vertices"):
        return capsules_of(shape, moves)
    key = moves, getattr(shape, "num_tris", None), vertices_of(shape).tobytes()
    if key not in known:
        known[key] = capsules_of(shape, moves)
    return known[key]


@kernel
def pair_distances(chains: Chains, links: Links, samples: Array) -> Array:
    """Compute least pair distances over configurations, infinite beyond `ENOUGH`; array, shape (n_pairs,) [m]."""
    start, end = links.start.copy(), links.end.copy()
    least = np.full(links.pairs.shape[0], np.inf)
    for k in range(samples.shape[0]):
        place_links(chains, links, samples[k], start, end)
        for p in range(links.pairs.shape[0]):
            i, j = links.pairs[p, 0], links.pairs[p, 1]
            thick = links.radius[i] + links.radius[j] - links.wider[p]
            apart = rods_distance(start[i], end[i], start[j], end[j], ENOUGH + thick)
            least[p] = min(least[p], apart - thick)
    return least


@kernel
def place_links(chains: Chains, links: Links, q: Array, start: Array, end: Array) -> None:
    """Compute the axes of the links that move, in the scene; results, arrays of shape (n_links, 3) [m].

    Rows of static links are not changed: pass arrays that begin as copies of `links.start` and `links.end`.
    """
    moving = 0
    for arm in range(chains.first.shape[0] - 1):
        n = chains.first[arm + 1] - chains.first[arm]
        rotations, points = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
        place_arm(chains, arm, q, rotations, points)
        for at in range(moving, links.moving.shape[0]):
            i = links.moving[at]
            if links.arm[i] != arm:
                break
            moving = at + 1
            k = links.joint[i] - chains.first[arm]
            r, p, a, b = rotations[k], points[k], links.start[i], links.end[i]
            ax, ay, az, bx, by, bz = a[0], a[1], a[2], b[0], b[1], b[2]
            for x in range(3):
                start[i, x] = p[x] + r[x, 0] * ax + r[x, 1] * ay + r[x, 2] * az
                end[i, x] = p[x] + r[x, 0] * bx + r[x, 1] * by + r[x, 2] * bz


@kernel
def links_clearance(
    links: Links,
    around: LinkSurroundings,
    instant: Instant,
    start: Array,
    end: Array,
    nodes: Array,
    cap: float,
) -> float:
    """Compute the links' least distance from obstacles, payload and each other [m]. It is at most `cap`.

    Links count as farther from each other by the reduction `eased`.

    Parameters
    ----------
    instant : instant of the obstacles, as in `comove.contacts.displaced`
    start, end : arrays, shape (n_links, 3), ends of the links' axes as `place_links` writes them [m]
    nodes : array, shape (n_nodes, 3), keypoints [m]
    """
    least, eased = clearance_around(links, around, instant, start, end, nodes, cap), around.eased
    return clearance_between(links, start, end, least - eased) + eased


@kernel
def clearances_at(
    chains: Chains,
    links: Links,
    around: LinkSurroundings,
    instant: Instant,
    joints: Array,
    nodes: Array,
    cap: float,
    blocked: float = -np.inf,
) -> Array:
    """Compute `links_clearance` at several joints, array of shape (n, n_joints).

    Returns
    -------
    array, shape (n,) [m]; -inf from the first one on that is not above `blocked`
    """
    found, start, end = np.full(joints.shape[0], -np.inf), links.start.copy(), links.end.copy()
    for k in range(joints.shape[0]):
        place_links(chains, links, joints[k], start, end)
        apart = links_clearance(links, around, instant, start, end, nodes, cap)
        if apart <= blocked:
            break
        found[k] = apart
    return found


@kernel
def clearance_around(
    links: Links,
    around: LinkSurroundings,
    instant: Instant,
    start: Array,
    end: Array,
    nodes: Array,
    cap: float,
) -> float:
    """Compute links' least distance from obstacles and payload [m], at most `cap`."""
    least, seen, is_near = cap, -1, False
    for i in links.moving:
        if links.group[i] != seen:  # of whose links none may be near, up to the same error of distances
            seen = links.group[i]
            wide = links.group_radius[seen]
            is_near = wide <= links.radius[i] or (
                _from_obstacles(around, instant, start[i], end[i], wide, least) < least
            )
        if is_near:
            least = _from_obstacles(around, instant, start[i], end[i], links.radius[i], least)
    return min(load_clearances(links, around, start, end, nodes, least))


@kernel(counted=False)
def _from_obstacles(
    around: LinkSurroundings, instant: Instant, a: Array, b: Array, radius: float, cap: float
) -> float:
    """Return a link's least distance [m] from obstacles, at most `cap`."""
    least, obstacles = cap, around.obstacles
    for j in range(obstacles.shape[0]):
        apart = rod_distance(obstacles, around.moved, j, instant, a, b, least + radius, ROUGH)
        least = min(least, apart - radius)
    return least


@kernel
def load_clearances(
    links: Links, around: LinkSurroundings, start: Array, end: Array, nodes: Array, cap: float
) -> tuple[float, float]:
    """Compute the payload's least distances [m] from moving and static links. Each is at most `cap`."""
    moving, still, ball = cap, cap, _ball_about_load(around, nodes)
    for g in range(links.group_reach.shape[0]):
        first = links.group_first[g]
        is_still = links.joint[first] == STATIC
        least = still if is_still else moving
        if links.holds[first] or not _may_touch(ball, start[first], end[first], links.group_reach[g] + least):
            continue
        for i in range(first, links.group_first[g + 1]):
            if _may_touch(ball, start[i], end[i], links.reach[i] + least):
                least = _from_load(around, start[i], end[i], links.radius[i], nodes, least)
        if is_still:
            still = least
        else:
            moving = least
    return moving, still


@kernel(counted=False)
def _may_touch(ball: tuple[float, float, float, float], a: Array, b: Array, reach: float) -> bool:
    """Return whether a ball is within `reach` [m] of a rod's middle."""
    x, y, z, size = ball
    u, v, w = 0.5 * (a[0] + b[0]) - x, 0.5 * (a[1] + b[1]) - y, 0.5 * (a[2] + b[2]) - z
    far = size + reach
    return u * u + v * v + w * w <= far * far


@kernel
def _ball_about_load(around: LinkSurroundings, nodes: Array) -> tuple[float, float, float, float]:
    """Return centre and radius of a ball around the payload [m]."""
    (x, y, z, size), thickest = ball_about(nodes), 0.0
    for radius in around.radii:
        thickest = max(thickest, radius)
    return x, y, z, size + thickest


@kernel(counted=False)
def _from_load(
    around: LinkSurroundings, a: Array, b: Array, radius: float, nodes: Array, cap: float
) -> float:
    """Return a link's least distance [m] from the payload, at most `cap`."""
    least, edges = cap, around.edges
    for e in range(edges.shape[0]):
        if edges[e, 0] != edges[e, 1]:
            thick = radius + around.radii[e]
            apart = rods_distance(a, b, nodes[edges[e, 0]], nodes[edges[e, 1]], least + thick)
            least = min(least, apart - thick)
    return least


@kernel
def links_near(
    chains: Chains, links: Links, around: LinkSurroundings, q: Array, nodes: Array, enough: float
) -> NDArray[np.bool_]:
    """Return which moving links are near obstacles or payload; array, shape (n_links,).

    They are within `enough` [m] at the joints q, array of shape (n_joints,).
    """
    start, end = links.start.copy(), links.end.copy()
    place_links(chains, links, q, start, end)
    near = np.zeros(links.joint.shape[0], dtype=np.bool_)
    for i in links.moving:
        a, b, radius = start[i], end[i], links.radius[i]
        least = _from_obstacles(around, RESTING, a, b, radius, enough)
        if not links.holds[i]:
            least = _from_load(around, a, b, radius, nodes, least)
        near[i] = least < enough
    return near


@kernel
def clearance_between(links: Links, start: Array, end: Array, cap: float) -> float:
    """Compute the links' least distance [m] from each other, at most `cap`."""
    least, middle = cap, np.empty_like(start)
    for i in range(start.shape[0]):
        for x in range(3):
            middle[i, x] = 0.5 * (start[i, x] + end[i, x])
    for run in range(links.runs.shape[0]):
        one, two, first, last = links.runs[run]
        a, b = links.group_first[one], links.group_first[two]
        far = links.group_reach[one] + links.group_reach[two] + least
        if not _are_near(middle, a, b, far):
            continue
        seen, is_near = -1, False
        for p in range(first, last):
            i, j = links.pairs[p, 0], links.pairs[p, 1]
            if i != seen:  # of the pairs with the same first link, none may be near
                far = links.reach[i] + links.group_reach[two] + least
                seen, is_near = i, _are_near(middle, i, b, far)
            if is_near and _are_near(middle, i, j, links.reach[i] + links.reach[j] + least - links.wider[p]):
                thick = links.radius[i] + links.radius[j] - links.wider[p]
                least = min(least, nearest_shares(start[i], end[i], start[j], end[j])[2] - thick)
    return least


@kernel(counted=False)
def _are_near(middle: Array, i: int, j: int, far: float) -> bool:
    """Return whether two of the points are less than `far` [m] apart."""
    x, y, z = middle[i, 0] - middle[j, 0], middle[i, 1] - middle[j, 1], middle[i, 2] - middle[j, 2]
    return far > 0.0 and x * x + y * y + z * z < far * far
