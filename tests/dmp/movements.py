"""Movements drawn at random, and recordings with orientations, for tests of primitives."""

import numpy as np
from scipy.spatial.transform import Rotation

from comove.dmp import DMP, ExponentialPhase, LinearPhase, Variant
from comove.dmp.demonstrations import Demonstration

REACH = 2.5  # rad, of the turn of a recording


def random_dmp(
    seed,
    variant=Variant.CLOSED_FORM,
    *,
    phase=ExponentialPhase(),  # noqa: B008
    n_dims=2,
    n_basis=12,
    still=False,
):
    """A movement that ends at rest, and begins so if it is still; its weights are of about the size of its way."""
    rng = np.random.default_rng(seed)
    start, goal, velocity = rng.uniform(-1, 1, (3, n_dims))
    weights, duration = rng.standard_normal((n_dims, n_basis)), rng.uniform(0.5, 20)
    rest = np.zeros(n_dims)
    return DMP(weights, start, goal, rest if still else velocity, rest, duration, phase, variant)


def resting_dmp(seed, **options):
    """A movement from rest to rest, whose acceleration fades out as well."""
    return random_dmp(seed, phase=LinearPhase(), still=True, **options)


def recording(seed=0, n_dims=3, reach=REACH, n_steps=401):
    """A hand that moves and turns, from rest to rest."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, n_steps)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    bends = np.stack([np.sin(np.pi * k * way) for k in (1, 2, 3)], axis=1)
    position = np.outer(way, rng.uniform(0.3, 1, n_dims)) + bends @ rng.uniform(-0.2, 0.2, (3, n_dims))
    vectors = np.outer(1 - way, rng.uniform(-1, 1, 3)) + bends @ rng.uniform(-0.5, 0.5, (3, 3))
    if n_dims == 2:
        vectors[:, :2] = 0.0
    vectors *= reach / np.linalg.norm(vectors, axis=1).max()
    turns = Rotation.from_rotvec(vectors)
    if n_dims == 3:
        turns = turns * Rotation.random(random_state=seed)
    return Demonstration(3.0 * s, position, orientation=turns.as_quat(scalar_first=True))
