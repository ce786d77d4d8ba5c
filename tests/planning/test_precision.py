"""A distribution drives the motion: it keeps to what people agree in and leaves what they vary in."""

import json
import warnings

import numpy as np
import pytest

from comove import Demonstration, LeastJerk, Scene, solve
from comove.dmp import ProMP
from comove.dmp.demonstrations.formats import write
from comove.errors import OptionError
from comove.model import demonstration_of
from comove.planning import carried_demonstration, movements_of
from comove.planning.resemblance import followed, precision_root

SCENE = {
    "name": "tube",
    "duration": 4.0,
    "workspace": {"lower": [0, 0], "upper": [2, 1.4]},
    "obstacles": [{"shape": "circle", "center": [0.85, 0.8], "radius": 0.12}],
    "manipulators": [{"name": "left", "start": [0.2, 0.6], "goal": [1.8, 0.6]}],
}


def recordings(n=10, seed=0, names=("",)):
    """Return movements from left to right that vary in the first half, and agree in the second."""
    rng, s = np.random.default_rng(seed), np.linspace(0, 1, 201)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    first, hill = np.exp(-0.5 * ((s - 0.42) / 0.1) ** 2), 0.25 * np.sin(np.pi * way) ** 2
    found = []
    for _ in range(n):
        bump = 0.12 * rng.standard_normal() * first
        own = {
            name: Demonstration(4 * s, np.stack([0.2 + 1.6 * way, 0.6 + hill + bump + 1e-3 * k], axis=1))
            for k, name in enumerate(names)
        }
        found.append(own.get("", own))
    return found


def test_the_precision_is_the_inverse_covariance_relative_to_its_mean():
    scene, promp = Scene.from_dict(SCENE), ProMP.fit(recordings())
    root = precision_root(promp, scene)
    weight = np.swapaxes(root, 1, 2) @ root
    s = np.linspace(0, 1, len(weight))
    covariance = promp.towards(start=promp.mean.start, goal=promp.mean.goal).covariance_at(s * promp.duration)
    variance = np.trace(covariance, axis1=1, axis2=2).mean() / 2
    expected = np.linalg.inv(covariance / variance + 0.1**2 * np.eye(2))
    assert np.abs(weight / expected[:, :1, :1] - expected / expected[:, :1, :1]).max() < 1e-3
    assert weight[80, 1, 1] < 0.1 * weight[150, 1, 1]  # dear where all agree


def test_the_motion_leaves_the_taught_way_where_people_vary():
    scene, promp = Scene.from_dict(SCENE), ProMP.fit(recordings())
    along, even = solve(scene, demonstration=promp), solve(scene, demonstration=promp.mean)
    assert along.verified and even.verified
    assert along.followed.weighted is not None and even.followed.weighted is None
    taught = carried_demonstration(movements_of(promp, scene), scene)
    root = precision_root(promp, scene)
    assert along.followed.weighted < followed(even.attempt, taught, root).weighted
    s = np.linspace(0.65, 0.95, 61)
    mean = promp.mean_at(s * promp.duration)
    off = [np.abs(x.attempt.hands(s)[0][:, 0] - mean).max() for x in (along, even)]
    assert off[0] < off[1] + 1e-6


def test_hands_that_were_recorded_together():
    two = {
        **SCENE,
        "obstacles": [],
        "manipulators": [
            {"name": "left", "start": [0.2, 0.6], "goal": [1.8, 0.6]},
            {"name": "right", "start": [0.2, 0.8], "goal": [1.8, 0.8]},
        ],
    }
    scene = Scene.from_dict(two)
    promp = ProMP.fit(recordings(names=("right", "left")))
    root = precision_root(promp, scene)
    assert root.shape[1:] == (4, 4)
    weight = root[84].T @ root[84]
    common, against = np.array([0, 1, 0, 1.0]), np.array([0, 1, 0, -1.0])
    assert common @ weight @ common < 0.1 * (against @ weight @ against)  # they went up and down together
    assert solve(scene, demonstration=promp, objective=LeastJerk(resemblance=0.9)).verified
    with pytest.raises(OptionError, match="the distribution is of right, left"):
        solve(Scene.from_dict(SCENE), demonstration=promp)


def test_a_folder_of_recordings_is_a_distribution(tmp_path):
    (tmp_path / "recordings").mkdir()
    for k, one in enumerate(recordings(4)):
        write(tmp_path / "recordings" / f"{k}.csv", one)
    (tmp_path / "recordings" / "README.txt").write_text("not read")
    (tmp_path / "scene.yaml").write_text(json.dumps({**SCENE, "demonstration": {"file": "recordings"}}))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        promp = demonstration_of(Scene.load(tmp_path / "scene.yaml"))
    assert isinstance(promp, ProMP) and promp.n_recordings == 4
