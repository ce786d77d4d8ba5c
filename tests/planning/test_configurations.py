"""Free edges keep their margin everywhere: to rounding among static obstacles, within 1 mm among moving ones.

Between stored samples an obstacle that turns about a hinge is taken to move straight.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.model import Scene, load_coordinates
from comove.planning.configurations import (
    configuration_space,
    deforms,
    edge_is_free,
    edge_is_free_in_time,
    interpolate,
    span,
)
from comove.planning.spacetime import spacetime
from tests.cases import examples
from tests.verification.random_boxes import box_near_contact
from tests.verification.random_motions import near_contact, with_turning_obstacles

N_EDGES, N_SAMPLES = 12, 60
PLENTY = 0.01  # m beyond the margin: such edges are free, or the planner finds nothing


def drawn(seed, moving):
    """A random motion of rods or a box past obstacles."""
    rng = np.random.default_rng(seed)
    if rng.random() < 0.5:
        return near_contact(rng, moving), rng
    while True:
        motion = box_near_contact(rng)
        if not moving:
            return motion, rng
        motion = with_turning_obstacles(motion, rng)
        if motion is not None:
            return motion, rng


def edges(motion, rng):
    """Pairs of configurations, and their normalised times, along the motion and beside it."""
    s = np.sort(rng.uniform(0.0, 1.0, (N_EDGES, 2)), axis=1)
    s[:, 1] = s[:, 0] + 0.3 * (s[:, 1] - s[:, 0])
    ends = [motion.at(at)[0] for at in s]
    shift = np.zeros((N_EDGES, 1, ends[0].shape[1]))
    shift[..., : motion.scene.n_dims] = 0.02 * rng.standard_normal((N_EDGES, 1, motion.scene.n_dims))
    return np.array(ends) + shift, s


def clearances(motion, space, p, q, times):
    """Clearances along an edge by the scene, which places obstacles first; array, shape (N_SAMPLES,) [m]."""
    found, at = np.empty(N_SAMPLES), np.empty_like(p)
    for i, share in enumerate(np.linspace(0.0, 1.0, N_SAMPLES)):
        interpolate(space, p, q, share, at)
        nodes = motion.coordinates.nodes(np.ascontiguousarray(at[None, :, None]))[0, 0]
        found[i] = motion.scene.clearance_at(nodes, times[0] + share * (times[1] - times[0]))[0]
    return found


@pytest.mark.parametrize("moving", [0.0, 1.0])
@examples(30)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_free_edge_keeps_its_margin(moving, seed):
    motion, rng = drawn(seed, moving)
    scene = motion.scene
    space = configuration_space(scene, motion.coordinates)
    world, nodes = spacetime(scene, space), np.empty((scene.body.n_nodes, 3))
    for (p, q), s in zip(*edges(motion, rng), strict=True):
        margin = space.required + rng.choice([0.0, 0.003])
        if moving:
            free = edge_is_free_in_time(
                space,
                world.timing,
                np.append(p, s[0]),
                np.append(q, s[1]),
                margin,
                np.empty(len(p) + 1),
                nodes,
            )
        else:
            free = edge_is_free(space, p, q, margin, np.empty_like(p), nodes)
        found = clearances(motion, space, p, q, s * scene.duration * bool(moving))
        fine = (span(space, p, q) + world.timing.fastest * bool(moving) * (s[1] - s[0])) / N_SAMPLES
        if free:
            assert found.min() >= margin - (1e-3 if moving else 1e-9)
        elif found.min() > margin + PLENTY + fine and not scene.kept_apart[0].size:
            pytest.fail("it is far from everything")


@examples(100)
@given(
    radius=st.floats(0.05, 0.45),
    heading=st.floats(-np.pi, np.pi),
    turned=st.floats(1.0, 200.0) | st.floats(-200.0, -1.0),
    begins=st.floats(0.0, 0.9),
    takes=st.floats(0.01, 0.1),
)
def test_what_stands_is_met_by_a_blade_that_turns(radius, heading, turned, begins, takes):
    """A blade turns about its middle, by `turned` degrees a second, beside a hand that does not move."""
    hand = [0.5 + radius * np.cos(heading), 0.5 + radius * np.sin(heading)]
    blade = {"shape": "box", "center": [0.5, 0.5], "size": [0.8, 0.01]}
    scene = Scene.from_dict(
        {
            "name": "blade",
            "duration": 10.0,
            "workspace": {"lower": [-1, -1], "upper": [2, 2]},
            "obstacles": [blade | {"motion": {"turn": {"rate_deg_per_s": turned}}}],
            "manipulators": [{"name": "a", "start": [-0.5, -0.5], "goal": [1.5, 1.5]}],
        }
    )
    coordinates = load_coordinates(scene)
    space = configuration_space(scene, coordinates)
    ends, scratch, nodes = (begins, begins + takes), np.empty(3), np.empty((1, 3))
    p, q = (np.append(hand, at) for at in ends)
    free = edge_is_free_in_time(space, spacetime(scene, space).timing, p, q, 0.01, scratch, nodes)
    angle = np.deg2rad(turned) * scene.duration * np.linspace(*ends, 400)
    along, off = radius * np.cos(heading - angle), radius * np.sin(heading - angle)
    apart = np.hypot(np.maximum(abs(along) - 0.4, 0.0), np.maximum(abs(off) - 0.005, 0.0))
    if free:
        assert apart.min() > 0.01 - 1e-9
    else:
        assert apart.min() < 0.02


def test_paths_are_deformed_into_each_other_on_one_side_of_an_obstacle_alone():
    scene = Scene.from_dict(
        {
            "name": "post",
            "duration": 4.0,
            "workspace": {"lower": [-1, -1], "upper": [2, 2]},
            "obstacles": [{"shape": "circle", "center": [0.5, 0.5], "radius": 0.1}],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": "a", "start": [-0.1, 0.5], "goal": [0.9, 0.5]},
                {"name": "b", "start": [0.1, 0.5], "goal": [1.1, 0.5]},
            ],
        }
    )
    space, s = configuration_space(scene, load_coordinates(scene)), np.linspace(0.0, 1.0, 101)

    def way(height, turn=0.0, pace=1):
        t = s**pace
        return np.stack([t, 0.5 + height * np.sin(np.pi * t) ** 2, turn * t], axis=1)

    assert deforms(space, way(0.3), way(0.6), 0.0) and deforms(space, way(-0.6), way(-0.3), 0.0)
    assert not deforms(space, way(0.3), way(-0.3), 0.0)
    # Where one has passed the post, the other has hardly begun.
    assert deforms(space, way(0.3), way(0.3, pace=12), 0.0)
    assert not deforms(space, way(0.3), way(-0.3, pace=12), 0.0)
    assert not deforms(space, way(0.3), way(0.3, 2 * np.pi), 0.0)  # the ends are the same, the ways are not
