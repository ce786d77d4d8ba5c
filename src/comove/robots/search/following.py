"""Kernels in which arms follow the end effectors.

Each sample is solved from the joints of the samples before it, and redundant joints are drawn to a *course*, the line
from the joints at the start to those at the goal, so the joints move as continuously as the end effectors. Residuals,
margins of the joints, rates, torques and distances of the links are summed into one penalty for each motion.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel, sort_by
from comove.contacts.displaced import instant_at
from comove.model.moving import Displacements
from comove.robots.search.chains import Chains, Iteration, inside, reach_pose, torques
from comove.robots.search.links import (
    STILL,
    HandOrientation,
    Links,
    LinkSurroundings,
    clearance_around,
    clearance_between,
    place_links,
)
from comove.robots.search.ranges import WristRanges

MET = 1e-4  # m, residual at which a pose counts as reached in a search
SEARCHING = Iteration(gain=0.2, keep=0.02, tolerance=MET, steady=0.05, most=6)
"""Iteration for a sample of a movement: redundancy need not have come to rest."""
PERSISTENT = Iteration(gain=0.4, keep=SEARCHING.keep, tolerance=1e-9, steady=1e-4, most=30)
"""Iteration from random joints; what has not come to rest by then hardly ever does."""
SETTLING = PERSISTENT._replace(stalled=0.85)
"""The same, given up where it comes no nearer."""
PATIENT = PERSISTENT._replace(gain=0.2, most=70)
"""Iteration that goes on where no joints have the pose yet: it is at the end of an arm's reach, or beyond."""
N_PATIENT = 8  # nearest joints from which it goes on


class Arms(NamedTuple):
    """Chains, links, ranges and surroundings of arms, for kernels."""

    chains: Chains
    links: Links
    ranges: WristRanges
    around: LinkSurroundings

    def among(self, obstacles: Array, moved: Displacements = STILL) -> Arms:
        """Return the same arms among other obstacles, a table at 0 s."""
        return self._replace(around=self.around._replace(obstacles=obstacles, moved=moved))


class Strain(NamedTuple):
    """The demands of motions on arms; arrays, shape (n_rollouts, n_arms), clearance (n_rollouts,).

    Attributes
    ----------
    missing : largest distance by which an end effector's pose is out of reach [m] (a radian counts `TURN`)
    rates : array, shape (n_rollouts, n_arms, 3), largest share of the limits of speed, acceleration and torque
    jolt : mean square of the accelerations as shares of their limits
    penalty : penalty of the arm, 0 where every limit is kept
    clearance : least distance of a link [m], at most the required clearance plus `spare`
    contact : array, shape (n_rollouts,), penalty of links that are too near
    """

    missing: Array
    rates: Array
    jolt: Array
    penalty: Array
    clearance: Array
    contact: Array


@kernel(nogil=True)
def solutions(
    chains: Chains,
    arm: int,
    rotation: Array,
    point: Array,
    posture: Array,
    seeds: Array,
    first: Iteration,
    n_patient: int,
) -> tuple[Array, Array]:
    """Solve an arm's joints for a pose from seeds; return joints and residuals. `seeds` are overwritten.

    Parameters
    ----------
    first : iteration from each seed
    n_patient : nearest joints from which a patient one goes on where none has the pose
    """
    n, least = seeds.shape[0], np.inf
    missing, order = np.empty(n), np.empty(n, dtype=np.int64)
    for k in range(n):
        order[k] = k
        missing[k] = reach_pose(chains, arm, rotation, point, posture, first, seeds[k])
        least = min(least, missing[k])
    if least > first.tolerance:
        sort_by(missing, order, 0, n, np.empty(n, dtype=np.int64))
        for place in range(min(n, n_patient)):
            k = order[place]
            missing[k] = reach_pose(chains, arm, rotation, point, posture, PATIENT, seeds[k])
    return seeds, missing


@kernel
def hand_rotation(around: LinkSurroundings, nodes: Array, i: int, out: Array) -> None:
    """Compute the orientation of end effector i; `nodes` is (n_nodes, 3). See `Grasp.hand_rotations`."""
    hold, c, s = around.hold, 1.0, 0.0
    if hold.keypoints.shape[0] > 0:
        _hand_on_keypoints(hold, nodes, i, out)
        return
    if hold.turning[i] and hold.first != hold.second:
        x = nodes[hold.first, 0] - nodes[hold.second, 0]
        y = nodes[hold.first, 1] - nodes[hold.second, 1]
        size = sqrt(x * x + y * y)
        c, s = x / size, y / size
    rest = hold.at_rest[i]
    for b in range(3):
        out[0, b] = c * rest[0, b] - s * rest[1, b]
        out[1, b] = s * rest[0, b] + c * rest[1, b]
        out[2, b] = rest[2, b]


@kernel
def _hand_on_keypoints(hold: HandOrientation, nodes: Array, i: int, out: Array) -> None:
    """Compute the orientation of end effector i from the payload's keypoints."""
    p, q, r = nodes[hold.keypoints[0]], nodes[hold.keypoints[1]], nodes[hold.keypoints[2]]
    ax, ay, az = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    bx, by, bz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size, height = sqrt(ax * ax + ay * ay + az * az), sqrt(nx * nx + ny * ny + nz * nz)
    ax, ay, az = ax / size, ay / size, az / size
    nx, ny, nz = nx / height, ny / height, nz / height
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    if not hold.turning[i]:
        ax, ay, az, bx, by, bz, nx, ny, nz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    rest = hold.at_rest[i]
    for k in range(3):
        out[0, k] = ax * rest[0, k] + bx * rest[1, k] + nx * rest[2, k]
        out[1, k] = ay * rest[0, k] + by * rest[1, k] + ny * rest[2, k]
        out[2, k] = az * rest[0, k] + bz * rest[1, k] + nz * rest[2, k]


@kernel
def posture_on(course: Array, around: LinkSurroundings, nodes: Array, out: Array) -> None:
    """Interpolate a course's posture by the payload's distances from both ends. It draws redundant joints.

    Parameters
    ----------
    course : array, shape (2, n_joints), joints at start and goal
    nodes : array, shape (n_nodes, 3), end effectors first [m]
    out : result, array of shape (n_joints,)
    """
    away = np.zeros(2)
    for end in range(2):
        for i in range(around.ends.shape[1]):
            square = 0.0
            for axis in range(3):
                square += (nodes[i, axis] - around.ends[end, i, axis]) ** 2
            away[end] += sqrt(square)
    share = away[0] / max(away[0] + away[1], 1e-12)
    for j in range(out.shape[0]):
        out[j] = course[0, j] + share * (course[1, j] - course[0, j])


@kernel(nogil=True)
def follow(arms: Arms, nodes: Array, course: Array, duration: float) -> tuple[Array, ...]:
    """Follow motions of payload and end effectors; return the fields of `Strain`.

    Parameters
    ----------
    nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), end effectors first, evenly spaced over `duration` [m]
    course : array, shape (2, n_joints), joints at start and goal; the first pose is solved from the former
    """
    chains = arms.chains
    n_rollouts, n_steps, n_arms = nodes.shape[0], nodes.shape[1], chains.first.shape[0] - 1
    missing, penalty = np.zeros((n_rollouts, n_arms)), np.zeros((n_rollouts, n_arms))
    rates, jolt = np.zeros((n_rollouts, n_arms, 3)), np.zeros((n_rollouts, n_arms))
    clearance, contact = np.zeros(n_rollouts), np.zeros(n_rollouts)
    q, left = np.empty((n_steps, course.shape[1])), np.empty((n_steps, n_arms))
    for k in range(n_rollouts):
        follow_one(arms, nodes[k], course, q, left)
        for i in range(n_arms):
            for t in range(n_steps):
                missing[k, i] = max(missing[k, i], left[t, i])
        clearance[k], contact[k] = contact_along(arms, q, nodes[k])
        _demand(arms, nodes[k], q, left, duration, rates[k], jolt[k], penalty[k])
    return missing, rates, jolt, penalty, clearance, contact


@kernel(nogil=True)
def demands(arms: Arms, nodes: Array, course: Array, duration: float) -> tuple[Array, ...]:
    """Follow one motion; return the fields of `Strain` that need no links, without the last two, and the joints.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3), as in `follow`
    """
    n_steps, n_arms = nodes.shape[0], arms.chains.first.shape[0] - 1
    q, left, missing = np.empty((n_steps, course.shape[1])), np.empty((n_steps, n_arms)), np.zeros(n_arms)
    rates, jolt, penalty = np.zeros((n_arms, 3)), np.zeros(n_arms), np.zeros(n_arms)
    follow_one(arms, nodes, course, q, left)
    for i in range(n_arms):
        for t in range(n_steps):
            missing[i] = max(missing[i], left[t, i])
    _demand(arms, nodes, q, left, duration, rates, jolt, penalty)
    return missing, rates, jolt, penalty, q


@kernel(nogil=True)
def course_penalties(arms: Arms, nodes: Array, courses: Array, duration: float) -> Array:
    """Compute the arms' penalties on several courses along one motion. See `Strain`.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3), as in `follow`
    courses : array, shape (n_courses, 2, n_joints)

    Returns
    -------
    array, shape (n_courses, n_arms)
    """
    n_steps, n_arms = nodes.shape[0], arms.chains.first.shape[0] - 1
    penalty, rates, jolt = np.zeros((courses.shape[0], n_arms)), np.empty((n_arms, 3)), np.empty(n_arms)
    q, left = np.empty((n_steps, courses.shape[2])), np.empty((n_steps, n_arms))
    for k in range(courses.shape[0]):
        rates[:], jolt[:] = 0.0, 0.0
        follow_one(arms, nodes, courses[k], q, left)
        _demand(arms, nodes, q, left, duration, rates, jolt, penalty[k])
    return penalty


@kernel
def _demand(
    arms: Arms,
    nodes: Array,
    q: Array,
    left: Array,
    duration: float,
    rates: Array,
    jolt: Array,
    penalty: Array,
) -> None:
    """Add each arm's demands of one motion to rates, jolts and penalties. See `Strain`."""
    wished = 0.15  # rad, of margin to the limits, below which it costs something
    chains, n_steps = arms.chains, nodes.shape[0]
    for i in range(chains.first.shape[0] - 1):
        for t in range(n_steps):
            if left[t, i] > MET:
                penalty[i] += (1.0 + 50.0 * left[t, i]) / n_steps
        for t in range(n_steps):
            least = np.inf
            for j in range(chains.first[i], chains.first[i + 1]):
                least = min(least, q[t, j] - chains.lower[j], chains.upper[j] - q[t, j])
            penalty[i] += 2.0 * max(0.0, wished - least) / n_steps
    _rates(arms, q, nodes, duration / (n_steps - 1), rates, jolt)
    for i in range(chains.first.shape[0] - 1):
        for ratio in rates[i]:
            if ratio > arms.around.share:
                penalty[i] += 0.05 + (ratio - arms.around.share)


@kernel
def follow_one(arms: Arms, nodes: Array, course: Array, q: Array, missing: Array) -> None:
    """Compute the joints along one motion.

    Results are `q`, (n_steps, n_joints), and `missing`, (n_steps, n_arms) [m].
    """
    chains, around = arms.chains, arms.around
    n_steps, rotation, posture = nodes.shape[0], np.empty((3, 3)), np.empty(course.shape[1])
    for t in range(n_steps):
        posture_on(course, around, nodes[t], posture)
        for i in range(chains.first.shape[0] - 1):
            for j in range(chains.first[i], chains.first[i + 1]):
                if t == 0:
                    q[t, j] = course[0, j]
                elif t == 1 or missing[t - 1, i] > MET:
                    q[t, j] = q[t - 1, j]
                else:  # on, as before
                    q[t, j] = inside(chains, j, 2.0 * q[t - 1, j] - q[t - 2, j], SEARCHING.keep)
            hand_rotation(around, nodes[t], i, rotation)
            missing[t, i] = reach_pose(chains, i, rotation, nodes[t, i], posture, SEARCHING, q[t])


@kernel(nogil=True)
def contact_along(arms: Arms, q: Array, nodes: Array) -> tuple[float, float]:
    """Compute the links' least clearance [m], and the penalty of missing clearance. It is capped at the desired one.

    Links are placed at every second sample. In between the ends of their axes are assumed to move on straight lines;
    near the payload or an obstacle, as it moves meanwhile, distances are computed at every 2 cm, at most ten times.
    """
    stride, sub_step, most = 2, 0.02, 10
    chains, links, around = arms.chains, arms.links, arms.around
    n_steps = q.shape[0]
    ends, load = np.empty((3, 2, links.joint.shape[0], 3)), np.empty_like(nodes[0])  # here, there, in between
    for k in range(3):
        for i in range(links.joint.shape[0]):
            for axis in range(3):
                ends[k, 0, i, axis], ends[k, 1, i, axis] = links.start[i, axis], links.end[i, axis]
    wished, eased = around.clearance + around.spare, around.eased
    least, penalty = wished, 0.0
    place_links(chains, links, q[0], ends[0, 0], ends[0, 1])
    for t in range(0, n_steps, stride):
        turn, after = (t // stride) % 2, min(t + stride, n_steps - 1)
        instant = instant_at(around.moved, t / (n_steps - 1))
        here, there, between = ends[turn], ends[1 - turn], ends[2]
        place_links(chains, links, q[after], there[0], there[1])
        moved = _longest_step(links, here, there)
        apart = clearance_between(links, here[0], here[1], wished - eased) + eased
        if apart < wished:
            least = min(least, apart)
            penalty += stride * _cost_of_contact(around, wished - apart) / n_steps
        moved += around.fastest * (after - t) / (n_steps - 1)
        far = wished + moved
        apart = clearance_around(links, around, instant, here[0], here[1], nodes[t], far)
        if apart >= far:
            continue
        parts = min(1 + int(moved / sub_step), most)
        for part in range(parts):
            if part > 0:
                _blend(here, there, part / parts, between)
                _blend(nodes[t], nodes[after], part / parts, load)
                instant = instant_at(around.moved, (t + part / parts * (after - t)) / (n_steps - 1))
                apart = clearance_around(links, around, instant, between[0], between[1], load, wished)
            if apart < wished:
                least = min(least, apart)
                penalty += stride * _cost_of_contact(around, wished - apart) / (n_steps * parts)
    return least, penalty


@kernel
def _longest_step(links: Links, here: Array, there: Array) -> float:
    """Bound the displacement of links' ends from above [m]; arrays, shape (2, n_links, 3)."""
    longest = 0.0
    for end in range(2):
        for i in links.moving:
            square = 0.0
            for axis in range(3):
                square += (there[end, i, axis] - here[end, i, axis]) ** 2
            longest = max(longest, square)
    return sqrt(longest)


@kernel
def _blend(a: Array, b: Array, share: float, out: Array) -> None:
    """Write a + share (b - a) into `out`; contiguous arrays of equal shape."""
    x, y, z = a.ravel(), b.ravel(), out.ravel()
    for i in range(z.shape[0]):
        z[i] = x[i] + share * (y[i] - x[i])


@kernel
def _cost_of_contact(around: LinkSurroundings, lacking: float) -> float:
    """Return the cost of missing clearance [m]. It jumps at the required clearance."""
    return 50.0 * lacking + (lacking > around.spare)


@kernel
def _rates(arms: Arms, q: Array, nodes: Array, dt: float, rates: Array, jolt: Array) -> None:
    """Compute largest shares of limits, shape (n_arms, 3), and jolts, (n_arms,)."""
    chains, n_steps, n_joints = arms.chains, q.shape[0], q.shape[1]
    v, w, pull, tau = np.zeros(n_joints), np.zeros(n_joints), np.zeros(3), np.zeros(n_joints)
    for t in range(n_steps):
        # at rest at both ends: as if mirrored in time
        before, after = t - 1 if t > 0 else 1, t + 1 if t + 1 < n_steps else n_steps - 2
        for j in range(n_joints):
            v[j] = (q[after, j] - q[before, j]) / (2.0 * dt)
            w[j] = (q[after, j] - 2.0 * q[t, j] + q[before, j]) / (dt * dt)
        for i in range(chains.first.shape[0] - 1):
            for axis in range(3):
                pull[axis] = (
                    nodes[after, i, axis] - 2.0 * nodes[t, i, axis] + nodes[before, i, axis]
                ) / dt**2
            if t % 4 == 0:
                torques(chains, i, q[t], v, w, arms.around.carried[i], pull, tau)
            for j in range(chains.first[i], chains.first[i + 1]):
                moved = q[after, j] - q[t, j]
                room = chains.upper[j] - q[after, j] if moved > 0.0 else q[after, j] - chains.lower[j]
                slowest = min(chains.velocity[j], max(room, 1e-9) / max(chains.approach[j], 1e-12))
                rates[i, 0] = max(rates[i, 0], abs(moved) / dt / slowest)
                rates[i, 1] = max(rates[i, 1], abs(w[j]) / chains.acceleration[j])
                jolt[i] += (w[j] / chains.acceleration[j]) ** 2 / (n_steps * n_joints)
                rates[i, 2] = max(rates[i, 2], abs(tau[j]) / chains.effort[j])
