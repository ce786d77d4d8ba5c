"""Predictive quality of distributions, and their effect on motions.

- likelihood: 7 recordings of each LASA shape, every one left out in turn: the log density of its positions at 19
  instants, each by itself, a coordinate; and its Mahalanobis distance squared a coordinate (1 where the spread is
  right). Beside comove the sample mean and covariance at each instant, and the ProMPs of movement_primitives and of
  mp-pytorch where they are installed, with as many weights a dimension. Mp-pytorch learns the weights of every
  recording; their mean and covariance, with a millionth of its mean diagonal added, are its user's to take, and it
  cannot be conditioned;
- conditioning: the recording left out is given at 1 and at 3 instants; error of the mean elsewhere, as a share of the
  error before;
- bimanual: two hands whose deviations hang together, drawn anew (each set 8 recordings and one left out): the log
  density of both hands, and the error of the right hand's mean, over that before, once the left hand of the recording
  left out is given at 3 instants;
- time of a fit of 6 recordings, and of 1000 samples of 201 steps;
- scenes: fresh planar draws with one hand and circles, demonstrations that vary in a part of the way: distance
  weighted by precision, of motions with the distribution and with its mean alone;
- picture: the tube of the demonstrations, the wall, and both motions.

    python benchmarks/distributions.py [--shapes 30] [--scenes 50] [--picture tube.png] [--only handwriting ...]
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from timing import elapsed, number, on_one_thread, print_table

import comove
from comove.dmp import ProMP, ViaPoint
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.model.adaptation import covariance_of_hands
from comove.planning import carried_demonstration, movements_of
from comove.planning.resemblance import followed, precision_root
from comove.planning.seeds import minimum_jerk
from comove.trajectory import interpolated

Array = np.ndarray
N_WEIGHTS = 20  # a dimension
INSTANTS = np.linspace(0.0, 1.0, 21)
GIVEN = (10,), (5, 10, 15)  # of the instants
SEED = 126
DEVIATIONS = 2.0  # standard deviations on either side of the mean, of a tube that is drawn
TUBE = "#7a3e9d"


def main() -> None:
    """Print the requested tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=30)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--picture", help="where to draw the tube")
    parser.add_argument("--only", nargs="*", choices=("handwriting", "bimanual", "scenes"))
    parser.add_argument("--sets", type=int, default=30, help="of two hands")
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    if asked.only is None or "handwriting" in asked.only:
        handwriting(asked.shapes)
    if asked.only is None or "bimanual" in asked.only:
        bimanual(asked.sets)
    if asked.only is None or "scenes" in asked.only:
        scenes(asked.scenes)
    if asked.picture:
        picture(asked.picture)


def even(demo: Demonstration, s: Array = INSTANTS) -> Array:
    """Return the positions of a recording at shares of its duration."""
    return interpolated(s * demo.duration, demo.time, demo.position)


class Comove:
    """Distribution of comove."""

    def __init__(self, demos: list[Demonstration]) -> None:
        self.promp = ProMP.fit(demos, n_basis=N_WEIGHTS)

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance of observations at the instants."""
        t = INSTANTS * self.promp.duration
        return self.promp.mean_at(t), self.promp.covariance_at(t) + np.diag(self.promp.noise**2)

    def given(self, at: tuple[int, ...], position: Array) -> Array:
        """Return the mean at the instants, given some positions."""
        via = [ViaPoint(INSTANTS[i] * self.promp.duration, position[i]) for i in at]
        return self.promp.condition(*via).mean_at(INSTANTS * self.promp.duration)

    def samples(self) -> Array:
        """Sample 1000 movements."""
        return self.promp.sample_trajectories(np.random.default_rng(0), 1000)


class MovementPrimitives:
    """Distribution of movement_primitives, with its own defaults. Its noise is the learned variance."""

    def __init__(self, demos: list[Demonstration]) -> None:
        from movement_primitives.promp import ProMP as Peer

        self.promp = Peer(n_dims=2, n_weights_per_dim=N_WEIGHTS)
        s = np.linspace(0.0, 1.0, 101)  # with a thousand samples its expectation takes minutes
        self.promp.imitate(np.stack([s] * len(demos)), np.stack([even(demo, s) for demo in demos]))

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance of observations at the instants."""
        n = len(INSTANTS)
        whole = self.promp.cov_trajectory(INSTANTS).reshape(2, n, 2, n)  # dimension after dimension
        covariance = np.einsum("ctdt->tcd", whole) + self.promp.variance * np.eye(2)
        return self.promp.mean_trajectory(INSTANTS), covariance

    def given(self, at: tuple[int, ...], position: Array) -> Array:
        """Return the mean at the instants, given some positions."""
        promp = self.promp
        for i in at:
            promp = promp.condition_position(position[i], y_cov=1e-6 * np.eye(2), t=INSTANTS[i], t_max=1.0)
        return promp.mean_trajectory(INSTANTS)

    def samples(self) -> Array:
        """Sample 1000 movements."""
        s = np.linspace(0.0, 1.0, 201)
        return self.promp.sample_trajectories(s, 1000, np.random.RandomState(0))


class MPPyTorch:
    """Distribution of mp-pytorch, with its own defaults."""

    def __init__(self, curves: Array) -> None:
        import torch
        from mp_pytorch.mp import MPFactory

        logging.disable(logging.WARNING)
        count, n_steps, self.n_dims = curves.shape
        settings = {
            "num_basis": N_WEIGHTS,
            "basis_bandwidth_factor": 2,
            "num_basis_outside": 0,
            "alpha_phase": 2,
        }
        self.mp = MPFactory.init_mp("promp", settings, num_dof=self.n_dims, tau=1.0, dtype=torch.float64)
        times = torch.linspace(0.0, 1.0, n_steps, dtype=torch.float64).repeat(count, 1)
        weights = self.mp.learn_mp_params_from_trajs(times, torch.as_tensor(curves))["params"]
        covariance = torch.cov(weights.T)
        ridge = 1e-6 * covariance.trace() / len(covariance)
        self.mean = weights.mean(dim=0)
        self.root = torch.linalg.cholesky(
            covariance + ridge * torch.eye(len(covariance), dtype=torch.float64)
        )
        self.torch = torch

    def _at(self, s: Array) -> None:
        self.mp.set_add_dim([])
        self.mp.update_inputs(times=self.torch.as_tensor(s), params=self.mean, params_L=self.root)

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance of observations at the instants."""
        n = len(INSTANTS)
        self._at(INSTANTS)
        whole = self.mp.get_traj_pos_cov().numpy().reshape(self.n_dims, n, self.n_dims, n)
        return self.mp.get_traj_pos().numpy(), np.einsum("ctdt->tcd", whole)

    def samples(self) -> Array:
        """Sample 1000 movements."""
        self._at(np.linspace(0.0, 1.0, 201))
        return self.mp.sample_trajectories(num_smp=1000)[0].numpy()


class SampleMoments:
    """Sample mean and covariance at every instant. Known positions change nothing elsewhere."""

    def __init__(self, demos: list[Demonstration]) -> None:
        self.curves = np.stack([even(demo) for demo in demos])

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance at the instants."""
        away = self.curves - self.curves.mean(axis=0)
        covariance = np.einsum("ntc,ntd->tcd", away, away) / (len(away) - 1)
        return self.curves.mean(axis=0), covariance + 1e-6 * np.ptp(self.curves) ** 2 * np.eye(2)

    def given(self, at: tuple[int, ...], position: Array) -> Array:
        """Return the mean, with the known positions in it."""
        mean = self.curves.mean(axis=0)
        mean[list(at)] = position[list(at)]
        return mean


def installed(peer: str) -> bool:
    """Return whether a peer is installed; print a note otherwise."""
    found = importlib.util.find_spec(peer) is not None
    if not found:
        print(f"{peer} is not installed and left out: pip install 'comove[bench]'")
    return found


def handwriting(n_shapes: int) -> None:
    """Compare on left-out recordings."""
    kinds: dict[str, Callable[[list[Demonstration]], Any]] = {
        "comove": Comove,
        "sample moments": SampleMoments,
    }
    if installed("movement_primitives"):
        kinds["movement_primitives, ProMP"] = MovementPrimitives
    if installed("mp_pytorch"):
        s = np.linspace(0.0, 1.0, 101)
        kinds["mp-pytorch, ProMP"] = lambda demos: MPPyTorch(np.stack([even(demo, s) for demo in demos]))
    names = lasa_names()[:n_shapes]
    measured: dict[str, list[tuple[float, ...]]] = {name: [] for name in kinds}
    for shape in names:
        demos = [Demonstration.from_lasa(shape, k) for k in range(7)]
        for k, left_out in enumerate(demos):
            for name, kind in kinds.items():
                measured[name].append(_measures(kind, demos[:k] + demos[k + 1 :], even(left_out)))
    rows = []
    for name, values in measured.items():
        middle, mean = np.nanmedian(values, axis=0), np.mean(values, axis=0)
        rows.append(
            [
                name,
                f"{middle[0]:.3f} ({mean[0]:.3f})",
                f"{middle[1]:.2f} ({mean[1]:.2f})",
                *(f"{x:.3f}" if x > 0 else "-" for x in middle[2:4]),
                f"{number(1e3 * middle[4])} ms",
                f"{number(1e3 * middle[5])} ms" if middle[5] > 0 else "-",
            ]
        )
    head = ["log density", "distance squared", "given 1", "given 3", "fit", "1000 samples"]
    print_table([f"{len(names)} shapes, 7 left out each, median (mean)", *head], rows)


def _measures(
    kind: Callable[[list[Demonstration]], Any], demos: list[Demonstration], position: Array
) -> tuple:
    started = time.perf_counter()
    model = kind(demos)
    fit = time.perf_counter() - started
    mean, covariance = model.moments()
    away, inner = position - mean, slice(1, -1)
    square = np.einsum("ti,ti->t", away, np.linalg.solve(covariance, away[..., None])[..., 0])
    density = -0.5 * (square + np.linalg.slogdet(2 * np.pi * covariance)[1])
    before = np.sqrt((away**2).sum(axis=1).mean())
    errors = [
        np.sqrt(((model.given(at, position) - position) ** 2).sum(axis=1).mean())
        if hasattr(model, "given")
        else np.nan
        for at in GIVEN
    ]
    drawn = elapsed(model.samples) if hasattr(model, "samples") else np.nan
    return (
        density[inner].mean() / 2,
        square[inner].mean() / 2,
        errors[0] / before,
        errors[1] / before,
        fit,
        drawn,
    )


def two_hands(rng: np.random.Generator, n: int = 9) -> list[Array]:
    """Return (101, 4) recordings of planar hands, the right following the left."""
    s = np.linspace(0.0, 1.0, 101)
    way = minimum_jerk(s)
    bends = np.stack([np.sin(np.pi * k * way) / k for k in (1, 2, 3)])
    base = np.stack(
        [way, rng.uniform(-0.3, 0.3) * bends[0], way, 0.4 + rng.uniform(-0.3, 0.3) * bends[1]], axis=1
    )
    together = np.tile(rng.uniform(0.5, 1.0, (2, 2)) * np.sign(rng.standard_normal((2, 2))), 1)
    found = []
    for _ in range(n):
        left = 0.05 * np.einsum("kd,kt->td", rng.standard_normal((3, 2)), bends)
        own = 0.01 * np.einsum("kd,kt->td", rng.standard_normal((3, 4)), bends)
        found.append(base + np.concatenate([left, left @ together.T], axis=1) + own)
    return found


class TwoHands:
    """Distribution of comove of both hands, together or separately."""

    def __init__(self, takes: list[Array], together: bool = True) -> None:
        s = np.linspace(0.0, 1.0, len(takes[0]))
        demos = [
            {
                name: Demonstration(s, take[:, part])
                for name, part in (("left", slice(2)), ("right", slice(2, 4)))
            }
            for take in takes
        ]
        if together:
            self.parts = [ProMP.fit(demos, n_basis=N_WEIGHTS)]
        else:
            self.parts = [
                ProMP.fit([demo[name] for demo in demos], n_basis=N_WEIGHTS) for name in ("left", "right")
            ]

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance of both hands at the instants."""
        mean = np.concatenate([part.mean_at(INSTANTS) for part in self.parts], axis=1)
        covariance, first = np.zeros((len(INSTANTS), 4, 4)), 0
        for part in self.parts:
            last = first + part.n_columns
            covariance[:, first:last, first:last] = part.covariance_at(INSTANTS) + np.diag(part.noise**2)
            first = last
        return mean, covariance

    def right(self, left: Array) -> Array:
        """Return the right hand's mean, given the left one thrice."""
        if len(self.parts) > 1:
            return self.parts[1].mean_at(INSTANTS)
        via = [ViaPoint(INSTANTS[i], left[i]) for i in GIVEN[1]]
        told = self.parts[0].condition(*via, position_covariance=1e-6, manipulator="left")
        return told.mean_at(INSTANTS)[:, 2:]


class PeerOfTwoHands:
    """Distribution of movement_primitives in four dimensions."""

    def __init__(self, takes: list[Array]) -> None:
        from movement_primitives.promp import ProMP as Peer

        self.promp = Peer(n_dims=4, n_weights_per_dim=N_WEIGHTS)
        self.promp.imitate(np.stack([np.linspace(0.0, 1.0, len(takes[0]))] * len(takes)), np.stack(takes))

    def moments(self) -> tuple[Array, Array]:
        """Return mean and covariance of both hands at the instants."""
        n = len(INSTANTS)
        whole = self.promp.cov_trajectory(INSTANTS).reshape(4, n, 4, n)
        return self.promp.mean_trajectory(INSTANTS), np.einsum(
            "ctdt->tcd", whole
        ) + self.promp.variance * np.eye(4)

    def right(self, left: Array) -> Array:
        """Return the right hand's mean, given the left one thrice."""
        promp, unknown = self.promp, np.diag([1e-6, 1e-6, 1e6, 1e6])
        for i in GIVEN[1]:
            promp = promp.condition_position(
                np.append(left[i], [0.0, 0.0]), y_cov=unknown, t=INSTANTS[i], t_max=1.0
            )
        return promp.mean_trajectory(INSTANTS)[:, 2:]


def bimanual(count: int) -> None:
    """Compare on two hands with correlated deviations."""
    kinds: dict[str, Callable[[list[Array]], Any]] = {
        "comove, both hands": TwoHands,
        "comove, each for itself": lambda takes: TwoHands(takes, together=False),
    }
    if installed("movement_primitives"):
        kinds["movement_primitives, ProMP"] = PeerOfTwoHands
    if installed("mp_pytorch"):
        kinds["mp-pytorch, ProMP"] = lambda takes: MPPyTorch(np.stack(takes))
    rows = []
    rng = np.random.default_rng(SEED)
    sets = [two_hands(rng) for _ in range(count)]
    for name, kind in kinds.items():
        values = []
        for takes in sets:
            started = time.perf_counter()
            model = kind(takes[:-1])
            fit = time.perf_counter() - started
            position = takes[-1][:: (len(takes[-1]) - 1) // (len(INSTANTS) - 1)]
            mean, covariance = model.moments()
            away = (position - mean)[1:-1]
            square = np.einsum("ti,tij,tj->t", away, np.linalg.inv(covariance[1:-1]), away)
            density = -0.5 * (square + np.linalg.slogdet(2 * np.pi * covariance[1:-1])[1])
            ratio = np.nan
            if hasattr(model, "right"):
                after = model.right(position[:, :2]) - position[:, 2:]
                ratio = np.linalg.norm(after) / np.linalg.norm((position - mean)[:, 2:])
            values.append((density.mean() / 4, ratio, fit))
        middle = np.median(values, axis=0)
        told = f"{middle[1]:.3f}" if middle[1] > 0 else "-"
        rows.append([name, f"{middle[0]:.3f}", told, f"{number(1e3 * middle[2])} ms"])
    print_table([f"{count} sets of two hands, medians", "log density", "right, given left", "fit"], rows)


def recordings(rng: np.random.Generator, n: int = 10) -> list[Demonstration]:
    """Return movements to the right that vary around one instant only."""
    s = np.linspace(0.0, 1.0, 201)
    way = minimum_jerk(s)
    centre, height = rng.uniform(0.35, 0.65), rng.uniform(-0.3, 0.3)
    first = np.exp(-0.5 * ((s - centre) / 0.1) ** 2) * np.sin(np.pi * s)
    found = []
    for _ in range(n):
        bump = rng.uniform(0.06, 0.15) * rng.standard_normal() * first
        own = 0.005 * rng.standard_normal() * np.sin(np.pi * s) ** 2
        y = 0.7 + height * np.sin(np.pi * way) ** 2 + bump + own
        found.append(Demonstration(4 * s, np.stack([0.2 + 1.6 * way, y], axis=1)))
    return found


def drawn_scene(rng: np.random.Generator, promp: ProMP) -> comove.Scene:
    """Return a scene with a circle in the demonstrated path's inner half."""
    at = promp.mean_at([rng.uniform(0.3, 0.7) * promp.duration])[0] + rng.uniform(-0.06, 0.06, 2)
    return comove.Scene.from_dict(
        {
            "name": "drawn",
            "duration": 4.0,
            "workspace": {"lower": [0, 0], "upper": [2, 1.4]},
            "obstacles": [
                {"shape": "circle", "center": at.tolist(), "radius": float(rng.uniform(0.05, 0.12))}
            ],
            "manipulators": [{"name": "hand", "start": [0.2, 0.7], "goal": [1.8, 0.7]}],
        }
    )


def scenes(count: int) -> None:
    """Compare motions along distributions with motions along their means."""
    rng, values = np.random.default_rng(SEED), []
    for i in range(count):
        promp = ProMP.fit(recordings(rng))
        scene = drawn_scene(rng, promp)
        along, even_pull = (comove.solve(scene, demonstration=d, seed=i) for d in (promp, promp.mean))
        taught, root = carried_demonstration(movements_of(promp, scene), scene), precision_root(promp, scene)
        measures = []
        for solution in (along, even_pull):
            near = followed(solution.attempt, taught, root)
            measures += [solution.verified, near.weighted, near.distance, solution.effort.seconds]
        values.append(measures)
    table = np.array(values, dtype=float)
    rows = []
    for name, part in (("distribution", table[:, :4]), ("its mean", table[:, 4:])):
        rows.append(
            [
                name,
                f"{int(part[:, 0].sum())} of {count}",
                *(f"{100 * np.median(part[:, k]):.2f} ({100 * part[:, k].mean():.2f}) cm" for k in (1, 2)),
                f"{np.median(part[:, 3]):.3f} s",
            ]
        )
    print_table([f"{count} scenes, median (mean)", "verified", "weighted", "distance", "time"], rows)
    ratio = table[:, 1] / table[:, 5]
    print(
        f"weighted distance over that along the mean: median {np.median(ratio):.3f}, at most {ratio.max():.3f}"
    )
    print(f"nearer with the distribution in {int((ratio < 1).sum())} of {count} scenes")


def draw_tube(axes: Any, mean: Array, covariance: Array, *, label: str = "") -> None:
    """Draw the mean of planar movements, and two standard deviations.

    Parameters
    ----------
    mean : array, shape (n_steps, 2) [m]
    covariance : array, shape (n_steps, 2, 2) [m^2]
    label : label of the tube in the legend
    """
    heading = np.gradient(mean, axis=0)
    length = np.linalg.norm(heading, axis=1, keepdims=True)
    normal = np.stack([-heading[:, 1], heading[:, 0]], axis=1) / np.where(length > 0, length, 1.0)
    variance = np.einsum("tc,tcd,td->t", normal, covariance, normal)
    aside = DEVIATIONS * np.sqrt(np.maximum(variance, 0.0))[:, None] * normal
    border = np.concatenate([mean + aside, (mean - aside)[::-1]])
    axes.fill(*border.T, color=TUBE, alpha=0.2, linewidth=0.0, zorder=0.5, label=label or None)
    axes.plot(*mean.T, "--", color=TUBE, linewidth=1.2)


def picture(path: str) -> None:
    """Draw the tube of the demonstrations, the wall, and both motions."""
    from comove.view.figures import save_picture
    from comove.view.figures.motion import draw_panel
    from comove.view.figures.style import new_figure

    rng = np.random.default_rng(3)
    demos = recordings(rng)
    promp = ProMP.fit(demos)
    spread = promp.std_at(INSTANTS * promp.duration)[:, 1]
    widest = float(INSTANTS[int(np.argmax(spread))])
    at = promp.mean_at([(widest + 0.08) * promp.duration])[0]
    data = drawn_scene(rng, promp).file.model_dump(exclude_none=True, exclude_unset=True)
    wall = {"shape": "box", "center": [float(at[0]), float(at[1]) + 0.42], "size": [0.06, 1.0]}
    scene = comove.Scene.from_dict({**data, "name": "wall", "obstacles": [wall]})
    figure = new_figure(12.0, 4.6)
    s = np.linspace(0.0, 1.0, 201)
    for k, (title, given) in enumerate((("along the distribution", promp), ("along its mean", promp.mean))):
        solution = comove.solve(scene, demonstration=given, seed=0)
        axes = figure.add_subplot(1, 2, k + 1)
        taught = carried_demonstration(movements_of(promp, scene), scene)[:, 0, :2]
        near = followed(solution.attempt, taught[:, None], precision_root(promp, scene))
        draw_panel(axes, solution.attempt, (0, 1))
        draw_tube(axes, taught, covariance_of_hands(promp, scene, s), label="two standard deviations")
        for demo in demos:
            axes.plot(*demo.position.T, color="0.6", linewidth=0.5, zorder=0)
        verdict = "verified" if solution.verified else "not verified"
        axes.set_title(
            f"{title}: {verdict}, {100 * near.weighted:.1f} cm weighted by precision", fontsize="medium"
        )
    save_picture(figure, path)
    print(f"drawn: {path}")


if __name__ == "__main__":
    main()
