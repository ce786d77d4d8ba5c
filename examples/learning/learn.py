"""Learn to carry a bar from generated episodes, and verify the results.

    comove generate examples/learning/gate.yaml --out gates --format npz --rate 20
    python examples/learning/learn.py gates --numbers 10 100 1000

A policy gets the share of the elapsed time, the end effectors, their goals and the obstacles, and returns the end
effectors at the next samples: a chunk, of which the beginning is executed before the next query. It is trained by
imitation alone, on the first 10, 100 and 1000 episodes, and then carries the bar in unseen scenes from the same
distribution. Each policy does so twice: its end effectors move as it says, or to the nearest pose of the bar, so
that no output can strain it. The motion is verified as every execution is, between the samples too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comove.data import Study
from comove.errors import ComoveError, ExtraError, OptionError, ResultError
from comove.io.arrays import read_arrays
from comove.io.files import require_target
from comove.model.coordinates import Coordinates, load_coordinates, poses_at
from comove.model.scene import Scene
from comove.verification.record import ExecutionReport, Record, RecordSamples, verify_execution
from comove.view.figures import save_picture
from comove.view.figures.motion import FINE, OFF, TOUCHES, draw_frame
from comove.view.figures.shapes import outline
from comove.view.figures.style import draw_way, new_figure

try:
    import torch
except ImportError:
    sys.exit(f"error: {ExtraError('learning', 'learn')}")

HERE = Path(__file__).parent
AGAIN = "comove generate STUDY --out DIR --format npz --rate 20"


@dataclass(frozen=True)
class Settings:
    """Settings of a policy.

    Attributes
    ----------
    chunk, taken : samples that the policy predicts, and those of them that are executed before the next query
    width : units of each of the two hidden layers
    steps, batch : steps of gradient descent, and samples in each
    rate : largest rate of learning, which falls to zero along half a cosine
    decay : decay of the weights
    noise : standard deviation by which end effectors are moved in training, so that the policy learns to return [m]
    seed : seed of the weights, the samples and the noise
    """

    chunk: int = 20
    taken: int = 5
    width: int = 256
    steps: int = 10_000
    batch: int = 256
    rate: float = 1e-3
    decay: float = 0.1
    noise: float = 0.01
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Episodes:
    """Episodes of one study.

    Attributes
    ----------
    number : number of the first of them in the study
    time : array, shape (n_steps,) [s]
    hands : array, shape (n_episodes, n_steps, n_manipulators, n_dims) [m]
    around : array, shape (n_episodes, n_values), goals of the end effectors and centres of the obstacles [m]
    """

    number: int
    time: np.ndarray
    hands: np.ndarray
    around: np.ndarray

    @classmethod
    def read(cls, folder: Path, count: int) -> Episodes:
        """Read the first episodes of `comove generate` in NPZ format."""
        files = sorted((folder / "npz").glob("episode_*.npz"))[:count]
        if len(files) < count:
            raise ResultError(
                f"it has {len(files)} episodes as NPZ, and {count} are asked for",
                file=folder,
                way_out=f"run: {AGAIN}",
            )
        parts = [read_arrays(file, ("time", "position", "environment")) for file in files]
        for file, part in zip(files, parts, strict=True):
            if any(part[name].shape != parts[0][name].shape for name in part):
                raise ResultError(
                    "it has other numbers of samples, hands or obstacles than the first episode",
                    file=file,
                    way_out="let all episodes last as long, among the same obstacles",
                )
        hands = np.stack([part["position"] for part in parts])
        around = np.stack([part["environment"][0] for part in parts])
        return cls(int(files[0].stem.partition("_")[2]), parts[0]["time"], hands, around)

    def first(self, count: int) -> Episodes:
        """Return the first episodes."""
        return Episodes(self.number, self.time, self.hands[:count], self.around[:count])

    def are_of(self, study: Study) -> bool:
        """Return whether the first episode is that of a study."""
        scene = study.draw(self.number).scene
        return scene is not None and np.array_equal(around_of(scene), self.around[0])


def around_of(scene: Scene) -> np.ndarray:
    """Return end-effector goals and obstacle centres, as in episodes [m]. Array, shape (n_values,)."""
    return np.append(scene.goal, scene.centers[:, : scene.n_dims])


class Policy(torch.nn.Module):
    """Policy from elapsed time, end effectors and surroundings to motion."""

    def __init__(self, seen: torch.Tensor, ahead: torch.Tensor, settings: Settings):
        """Scale inputs and outputs by their spread in the episodes."""
        super().__init__()
        self.settings, width = settings, settings.width
        self.middle, self.spread = seen.mean(0), seen.std(0) + 1e-3  # m: what hardly varies says little
        self.reach = ahead.std(0) + 1e-3
        self.layers = torch.nn.Sequential(
            torch.nn.Linear(seen.shape[1], width),
            torch.nn.GELU(),
            torch.nn.Linear(width, width),
            torch.nn.GELU(),
            torch.nn.Linear(width, ahead.shape[1]),
        )

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Return the next end effectors' displacements, in units of their spread."""
        return self.layers((seen - self.middle) / self.spread)

    @torch.no_grad()
    def next_hands(self, share: float, hands: np.ndarray, around: np.ndarray) -> np.ndarray:
        """Return the next end effectors in several scenes [m]. Array, shape (n_scenes, taken, n_manipulators,
        n_dims)."""
        flat = hands.reshape(len(hands), -1)
        seen = np.column_stack([np.full(len(flat), share), flat, around])
        moved = self(torch.from_numpy(seen).float()) * self.reach
        chunk = moved.numpy().astype(float).reshape(len(hands), self.settings.chunk, *hands.shape[1:])
        return hands[:, None] + chunk[:, : self.settings.taken]


def trained(episodes: Episodes, settings: Settings) -> Policy:
    """Return a policy that imitates the episodes. It minimises the mean square error of its chunks."""
    torch.manual_seed(settings.seed)
    n_episodes, n_steps = episodes.hands.shape[:2]
    hands = episodes.hands.reshape(n_episodes, n_steps, -1)
    size = hands.shape[2]
    later = np.minimum(np.arange(n_steps)[:, None] + np.arange(1, settings.chunk + 1), n_steps - 1)
    ahead = hands[:, later] - hands[:, :, None]  # at rest after the end
    share = np.broadcast_to(np.linspace(0.0, 1.0, n_steps)[:, None], (n_episodes, n_steps, 1))
    around = np.repeat(episodes.around[:, None], n_steps, axis=1)
    seen = torch.from_numpy(np.concatenate([share, hands, around], axis=2)).float().flatten(0, 1)
    aims = torch.from_numpy(ahead).float().reshape(len(seen), -1)
    policy = Policy(seen, aims, settings)
    optimiser = torch.optim.AdamW(policy.parameters(), settings.rate, weight_decay=settings.decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
    for _ in range(settings.steps):
        rows = torch.randint(len(seen), (settings.batch,))
        noise = settings.noise * torch.randn(settings.batch, size)
        moved = seen[rows]
        moved[:, 1 : 1 + size] += noise
        aim = aims[rows] - noise.repeat(1, settings.chunk)
        loss = (policy(moved) - aim / policy.reach).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return policy


def carried(
    policy: Policy, scenes: Sequence[Scene], time: np.ndarray, *, held: bool
) -> list[Record | RecordSamples]:
    """Execute a policy in scenes; return the records.

    Parameters
    ----------
    time : array, shape (n_steps,), times of the samples [s]
    held : whether end effectors move to the nearest pose of the payload, and not freely
    """
    loads = [load_coordinates(scene) for scene in scenes]
    around = np.stack([around_of(scene) for scene in scenes])
    hands = np.stack([scene.start for scene in scenes])[:, None]
    while hands.shape[1] < len(time):
        share = min(1.0, time[hands.shape[1] - 1] / scenes[0].duration)
        chunk = policy.next_hands(share, hands[:, -1], around)
        if held:
            chunk = np.stack([on_load(load, own) for load, own in zip(loads, chunk, strict=True)])
        hands = np.concatenate([hands, chunk], axis=1)
    hands = hands[:, : len(time)]
    if not held:
        return [RecordSamples(scene, time, own) for scene, own in zip(scenes, hands, strict=True)]
    return [record_of(*parts, time) for parts in zip(scenes, loads, hands, strict=True)]


def on_load(load: Coordinates, hands: np.ndarray) -> np.ndarray:
    """Return the end effectors at the nearest poses of the payload. Arrays, (n_steps, n_hands, n_dims) [m]."""
    nodes = load.nodes(np.ascontiguousarray(load.from_hands(hands).T[None]))[0]
    return nodes[:, : hands.shape[1], : hands.shape[2]]


def record_of(scene: Scene, load: Coordinates, hands: np.ndarray, time: np.ndarray) -> Record:
    """Return the record of a payload that moves from pose to pose."""
    poses = poses_at(load, load.from_hands(hands))
    centers, sagitta = scene.centers + scene.offsets(time), scene.obstacle_sagittas(time)
    return Record(scene, time, poses.center, poses.quaternion, centers, sagitta)


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of goals, and of distances at any instant [m]."""

    goal: float = 0.01
    distance: float = 0.005

    def met(self, report: ExecutionReport) -> tuple[bool, bool, bool]:
        """Return whether goals, clearance and distance were kept."""
        return (
            report.end_error <= self.goal,
            report.clearance_min > 0.0,
            report.distance_error_max <= self.distance,
        )


def row_of(reports: Sequence[ExecutionReport], tolerances: Tolerances) -> list[str]:
    """Return the success shares of scenes, and the median distance error."""
    met = np.array([tolerances.met(report) for report in reports])
    shares = [*met.mean(axis=0), met.all(axis=1).mean()]
    off = 1000 * float(np.median([report.distance_error_max for report in reports]))
    return [*(f"{100 * share:.1f} %" for share in shares), f"{off:.1f} mm"]


def draw(rows: Sequence[tuple[str, Sequence[RecordSamples]]], tolerances: Tolerances) -> Any:
    """Draw motions of several policies in the same scenes. Each policy has a row."""
    columns = len(rows[0][1])
    figure = new_figure(4.2 * columns, 3.4 * len(rows))
    for i, (title, records) in enumerate(rows):
        for j, record in enumerate(records):
            axes = figure.add_subplot(len(rows), columns, i * columns + j + 1)
            met = tolerances.met(verify_execution(record))
            said = ("misses the goal", "touches", "distance off")
            told = ", ".join(text for text, good in zip(said, met, strict=True) if not good)
            axes.set_title(f"{title}: {told or 'carried'}", fontsize="medium")
            draw_record(axes, record, tolerances)
    return figure


def draw_record(axes: Any, record: RecordSamples, tolerances: Tolerances) -> None:
    """Draw a planar motion, with contacts red and distance errors orange."""
    scene = record.scene
    draw_frame(axes, scene, (0, 1))
    for obstacle in scene.obstacles:
        axes.fill(*outline(obstacle, (0, 1)).T, facecolor="0.62", edgecolor="0.25", linewidth=0.6)
    for nodes in record.nodes[::4]:
        first, second = nodes[:2]
        off = abs(np.linalg.norm(second - first) - scene.distances[0].distance) > tolerances.distance
        tone = TOUCHES if scene.clearance_at(nodes)[0] <= 0.0 else OFF if off else FINE
        axes.plot(*nodes[:, :2].T, color=tone, linewidth=1.1, alpha=0.75, zorder=3)
    for hand, name in enumerate(scene.manipulators):
        draw_way(axes, record.nodes[:, hand, :2], scene.goal[hand], hand, name)


def unseen(study: Study, first: int, count: int) -> list[Scene]:
    """Return unseen scenes from the episodes' distribution. `first` is the number of the first one."""
    drawn = [study.draw(number) for number in range(first, first + count)]
    return [found.scene for found in drawn if found.scene is not None]


def main() -> None:
    """Train and test a policy for each number of episodes. The shares of successful scenes are printed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("episodes", type=Path, help="folder of `comove generate --format npz`")
    parser.add_argument("--study", type=Path, default=HERE / "gate.yaml", help="study that made them")
    parser.add_argument(
        "--numbers", type=int, nargs="+", default=[10, 100, 1000], help="episodes to learn from"
    )
    parser.add_argument("--scenes", type=int, default=500, help="scenes that the policies have not seen")
    parser.add_argument(
        "--first", type=int, default=2_000_000, help="number of the first of these in the study"
    )
    parser.add_argument("--steps", type=int, default=Settings.steps, help="steps of training")
    parser.add_argument("--seed", type=int, default=Settings.seed, help="seed of the training")
    parser.add_argument(
        "--out", type=Path, default=Path("learned.png"), help="picture of the first four scenes"
    )
    options = parser.parse_args()
    try:
        run(options)
    except ComoveError as error:
        sys.exit(f"error: {error}")


def run(options: argparse.Namespace) -> None:
    """Run the command."""
    if min(options.numbers) < 1 or options.scenes < 4 or options.steps < 1:
        raise OptionError(
            "there is nothing to learn or to show", way_out="give numbers above 0, and 4 scenes or more"
        )
    require_target(options.out, OptionError)
    study = Study.load(options.study)
    if options.first < study.total:
        raise OptionError(
            f"scene {options.first} is among the {study.total} episodes of the study",
            key="--first",
            way_out=f"give {study.total} or more",
        )
    episodes = Episodes.read(options.episodes, max(options.numbers))
    if not episodes.are_of(study):
        raise OptionError(
            f"the episodes in {options.episodes} are not those of {options.study}",
            key="--study",
            way_out="name the study that made them",
        )
    scenes, tolerances = unseen(study, options.first, options.scenes), Tolerances()
    time = np.arange(round(1.25 * len(episodes.time))) * episodes.time[1]  # a quarter more, to come to rest
    torch.set_num_threads(1)
    print("| episodes | hands | arrive | touch nothing | keep the distance | all three | distance off by |")
    print("|---|---|---|---|---|---|---|")
    drawn = []
    for number in options.numbers:
        policy = trained(episodes.first(number), Settings(steps=options.steps, seed=options.seed))
        for held, hands in ((False, "free"), (True, "on the load")):
            records = carried(policy, scenes, time, held=held)
            cells = row_of([verify_execution(record) for record in records], tolerances)
            print(f"| {' | '.join([str(number), hands, *cells])} |", flush=True)
            if not held:
                drawn.append((f"{number} episodes", records[:4]))
    save_picture(draw([drawn[0], drawn[-1]], tolerances), options.out)
    print(f"picture: {options.out}")


if __name__ == "__main__":
    main()
