"""
Points of a scanner
===================

Carry a bar past a disc and a box of which only clouds of points are known.

A real scanner's points are passed on in the same way: in metres, in the scene's frame, with the time on the clock of
the execution at which they were measured. Points of the arms are left out before.
"""

import numpy as np

import comove
from comove.control import Clouds, Executor, Scanner
from comove.control.safety.twists import nodes_of

scene = comove.Scene.from_dict(
    {
        "name": "scanned",
        "duration": 4.0,  # s
        "workspace": {"lower": [0, 0], "upper": [1, 1]},  # m
        "obstacles": [{"shape": "box", "center": [0.5, 0.1], "size": [0.2, 0.05]}],  # known, and stands
        "load": {"shape": "bar", "length": 0.2, "radius": 0.005},
        "manipulators": [
            {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
            {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
        ],
        "limits": {"speed": 0.5, "acceleration": 2.0, "clearance": 0.01},
    }
)
rng = np.random.default_rng(0)
NOISE = 0.002  # m


def disc(time):
    """Return points on a disc that crosses the path [m]. Array, shape (n_points, 2)."""
    angle = np.linspace(0, 2 * np.pi, 50)
    return [0.5, 0.95 - 0.2 * time] + 0.07 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def box(time):
    """Return points on a box that approaches the payload from 1 s."""
    side = np.linspace(-0.05, 0.05, 11)
    ends = np.full(11, 0.05)
    border = [(side, ends), (side, -ends), (ends, side), (-ends, side)]
    away = 10.0 if time < 1.0 else 0.0  # out of sight
    return [1.0 - 0.15 * time + away, 0.35] + np.concatenate([np.stack(pair, axis=1) for pair in border])


def scan(time):
    """Return noisy points of both obstacles, and an invalid one."""
    points = np.concatenate([disc(time), box(time), [[np.nan, np.nan]]])
    return points + NOISE * rng.standard_normal(points.shape)


observer = Clouds(scene, Scanner(noise=NOISE, spacing=0.01))
executor = Executor(scene, observer)
nearest = np.inf
while not executor.arrived and executor.time < 15.0:
    if executor.n_steps % 5 == 0:  # a cloud every 50 ms
        observer.update(scan(executor.time), executor.time)
    executor.step()
    hands = nodes_of(scene, executor.poses)[:2, :2]
    bar = hands[0] + np.linspace(0, 1, 101)[:, None] * (hands[1] - hands[0])
    truth = np.concatenate([disc(executor.time), box(executor.time)])
    nearest = min(nearest, np.linalg.norm(bar[:, None] - truth, axis=2).min() - 0.005)

print(f"arrived: {executor.arrived}, after {executor.time:.2f} s")
print(f"clear of what moves: {nearest > 0.0}, by {1000 * nearest:.1f} mm")
print(f"spheres now: {len(observer.observe(executor.time).margin) - len(scene.obstacles)}")
for event in executor.log.events:
    print(f"{event.time:5.2f} s  {event.what}")
