"""Obstacles for the tests of modulation, drawn at random: every shape, anywhere, turned and moving anyhow."""

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.lab.modulation import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    MovingObstacle,
    Sphere,
    Superquadric,
    level,
)

ALL = ("sphere", "ellipsoid", "superquadric", "box", "capsule", "cylinder")
length = st.floats(0.05, 1.0)
coordinate = st.floats(-2.0, 2.0)


def vectors(n_dims, of=coordinate):
    return st.tuples(*[of] * n_dims).map(np.array)


@st.composite
def shapes(draw, n_dims, names=ALL):
    name = draw(st.sampled_from([n for n in names if n_dims == 3 or n != "cylinder"]))
    sizes = draw(st.tuples(*[length] * n_dims))
    if name == "sphere":
        return Sphere(sizes[0])
    if name == "ellipsoid":
        return Ellipsoid(sizes)
    if name == "superquadric":
        return Superquadric(sizes, draw(st.tuples(*[st.floats(1.0, 6.0)] * n_dims)))
    if name == "box":
        return Box(sizes)
    return (Capsule if name == "capsule" else Cylinder)(sizes[0], sizes[1])


def rotations(n_dims):
    if n_dims == 2:
        return st.floats(-4, 4).map(lambda a: np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]))
    quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
    return quaternions.map(lambda q: Rotation.from_quat(q).as_matrix())


@st.composite
def bodies(draw, n_dims, names=ALL):
    """A moving, turning obstacle."""
    return MovingObstacle(
        draw(shapes(n_dims, names)),
        draw(vectors(n_dims)),
        draw(rotations(n_dims)),
        velocity=draw(vectors(n_dims)),
        angular_velocity=draw(vectors(2 * n_dims - 3)),
        margin=draw(st.sampled_from([0.0, 0.03])),
    )


@st.composite
def cases(draw, most=1, **options):
    """Some obstacles of one dimension, a point outside of all of them, and a wanted velocity."""
    n_dims = draw(st.sampled_from([2, 3]))
    obstacles = [draw(bodies(n_dims, **options)) for _ in range(draw(st.integers(1, most)))]
    return obstacles, draw(vectors(n_dims, st.floats(-4, 4))), draw(vectors(n_dims))


def on_surface(obstacle, direction):
    """Where the ray from the reference along `direction` leaves the obstacle with its margin, by bisection."""
    start = obstacle.center + obstacle.rotation @ obstacle.reference
    direction = direction / np.linalg.norm(direction)
    inside, outside = 0.0, 10.0
    for _ in range(80):
        middle = 0.5 * (inside + outside)
        if level(obstacle, start + middle * direction)[0] < 1.0:
            inside = middle
        else:
            outside = middle
    return start + outside * direction


def velocity_of(obstacle, point):
    """Velocity of a rigid body at a point of it, v + omega x r; array, shape (n_dims,), [m/s]."""
    arm, turn = point - obstacle.center, obstacle.angular_velocity
    if len(arm) == 2:
        return obstacle.velocity + turn[0] * np.array([-arm[1], arm[0]])
    return obstacle.velocity + np.cross(turn, arm)
