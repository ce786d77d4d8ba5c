"""False verifications of forged folders that contradict scene or robot.

    python benchmarks/tampering.py [--only motions runs studies joints simulations robot-runs] [--workers 2]
        [--motions 45000] [--runs 45000] [--studies 4000] [--joints 3000] [--simulations 1500] [--robot-runs 1500]

Folders of each kind are made once. A forgery that knows the source then changes one at random: bytes and numbers of
any array, entries of any summary, the scene of the folder's own, weights of the curve with samples, measures and
claims computed again by comove's own functions on an easier scene, poses and obstacles of runs, times, clocks that
are set, tremors between samples of torques, robot descriptions, rows of run databases; or combines parts of different
folders. All checksums are redone. Half of the folders are verified against the trusted scene, half against
their own, as commands do.

Verified folders are checked by code that shares neither geometry nor files with the verifier: samples as a
consumer would play them, distances by `tests/brute_force.py`, obstacles moved by the keys of the scene's file,
differences for speeds and accelerations, Pinocchio's kinematics and dynamics for joints. "Wrong" is a verified folder
that contradicts the scene or the robot, or states a clearance that samples undercut. Anything but a verification
result or a refusal in one sentence is a crash.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import json
import shutil
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from functools import cache
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from timing import print_table

sys.path.insert(0, str(Path(__file__).parents[1]))

import comove
from comove.control import Executor, Pace, write_run
from comove.errors import ComoveError, ComoveWarning
from comove.io.folders import whole_folder
from comove.model import Scene
from comove.model.coordinates import coordinates_for
from comove.model.files.keys import canonical
from comove.results import RESULT
from comove.results.reference import SCENE
from comove.results.runs import RUN, StoredRun
from comove.results.sealed import checksum, finite
from comove.results.solution import SOLUTION, motion_arrays, read_result, rebuild, smoothness_of
from comove.stored import ResultPart, verify_part
from comove.verification.measures import WEIGHTS, unit_terms, unit_terms_of
from comove.verification.record import verify_execution
from comove.verification.verify import verify
from comove.view.figures import save_result

SHM = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
COUNTS = {
    "motions": 45_000,
    "runs": 45_000,
    "studies": 4_000,
    "joints": 3_000,
    "simulations": 1_500,
    "robot-runs": 1_500,
}
WORDS = ("rejected", "refused", "verified, and true", "WRONG", "crash")
NEAR = 2e-6  # m, by which samples and bounds may differ
CHUNK = 10
DT = 1e-4  # relative, by which differences of samples overshoot a limit

STANDING = {
    "name": "standing",
    "duration": 4.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [
        {"shape": "box", "center": [0.5, 0.15], "size": [0.1, 0.3]},
        {"shape": "circle", "center": [0.3, 0.9], "radius": 0.04, "motion": {"velocity": [0.05, -0.01]}},
    ],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
    "limits": {"speed": 0.6, "acceleration": 2.0, "clearance": 0.01},
}
IN_SPACE = {
    "name": "space",
    "duration": 5.0,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "obstacles": [
        {"shape": "sphere", "center": [0.5, 0.5, 0.35], "radius": 0.12},
        {"shape": "box", "center": [0.5, 0.5, 0.85], "size": [0.3, 0.3, 0.2]},
    ],
    "load": {"shape": "bar", "length": 0.3, "radius": 0.01},
    "manipulators": [
        {"name": "left", "start": [0.2, 0.35, 0.4], "goal": [0.8, 0.35, 0.4]},
        {"name": "right", "start": [0.2, 0.65, 0.4], "goal": [0.8, 0.65, 0.4]},
    ],
    "limits": {"speed": 0.6, "acceleration": 2.0, "jerk": 20.0, "clearance": 0.005},
}
SCENES = (STANDING, IN_SPACE)


# --- the look at what was called verified -------------------------------------------------------------------------


def clearance_of(scene: Scene, time: np.ndarray, hands: np.ndarray) -> float:
    """Return the least clearance of a bar at samples [m]."""
    from tests.brute_force import obstacle_distance

    radius = getattr(scene.file.load, "radius", 0.0) or 0.0
    overhang = getattr(scene.file.load, "overhang", 0.0) or 0.0
    length = np.linalg.norm(hands[0, 0] - hands[0, 1])
    share = np.linspace(-overhang / length, 1.0 + overhang / length, 41)[:, None]
    points = (1.0 - share) * hands[:, :1] + share * hands[:, 1:2]  # (n_steps, n_share, n_dims)
    lower, upper = np.array(scene.file.workspace.lower), np.array(scene.file.workspace.upper)
    least = float(min((points - lower).min(), (upper - points).min()))
    for obstacle in scene.file.obstacles:
        least = min(least, float(obstacle_distance(obstacle, points, time).min()))
    return least - radius


def contradictions(
    scene: Scene, time: np.ndarray, hands: np.ndarray, *, miss: float = 1e-6, differ: bool = True
) -> list[str]:
    """Return how samples of end effectors contradict a scene with a bar. `hands` has the shape (n_steps, n_hands,
    n_dims)."""
    file, found = scene.file, []
    starts = np.array([hand.start for hand in file.manipulators])
    goals = np.array([hand.goal for hand in file.manipulators])
    if np.abs(np.linalg.norm(hands[0] - starts, axis=1)).max() > miss + 1e-3 * (miss > 1e-5):
        found.append("start")
    if np.linalg.norm(hands[-1] - goals, axis=1).max() > miss:
        found.append("goal")
    apart = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1)
    if np.abs(apart - file.load.length).max() > 1e-3 * file.load.length + 1e-6:
        found.append("distance")
    if clearance_of(scene, time, hands) < scene.clearance - NEAR:
        found.append("clearance")
    if not differ:
        return found
    step = np.diff(time)
    velocity = np.diff(hands, axis=0) / step[:, None, None]
    if np.linalg.norm(velocity, axis=2).max() > scene.speed_limit * (1 + DT):
        found.append("speed")
    bend = np.diff(velocity, axis=0) / (0.5 * (step[1:] + step[:-1]))[:, None, None]
    if np.linalg.norm(bend, axis=2).max() > scene.acceleration_limit * (1 + DT):
        found.append("acceleration")
    jerk = np.diff(bend, axis=0) / step[1:-1, None, None]
    if len(jerk) and np.linalg.norm(jerk, axis=2).max() > scene.jerk_limit * (1 + 0.01):
        found.append("jerk")
    return found


# --- the forger -----------------------------------------------------------------------------------------------------


def noise(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    """Return an array with some numbers changed slightly or strongly."""
    array = array.copy()
    if array.dtype.kind != "f" or not array.size:
        return array
    flat, size = array.reshape(-1), 10.0 ** rng.uniform(-9, 1)
    kind = rng.integers(5)
    if kind == 0:  # one number
        flat[rng.integers(flat.size)] += size * rng.normal()
    elif kind == 1:  # a stretch of them
        i = rng.integers(flat.size)
        flat[i : i + rng.integers(1, flat.size + 1)] += size * rng.normal()
    elif kind == 2:  # all
        flat += size * rng.normal(size=flat.size)
    elif kind == 3:  # scaled
        flat *= 1.0 + size * rng.normal()
    else:
        flat[rng.integers(flat.size)] = rng.choice([np.nan, np.inf, 0.0, 1e300, -1.0])
    return array


def other_entry(rng: np.random.Generator, value: Any) -> Any:
    """Return another value of a summary's entry."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, float):
        return float(value * rng.choice([0.0, 0.5, 2.0, -1.0, 1 + 1e-7]) + rng.choice([0.0, 1e-3]))
    if isinstance(value, dict) and value:
        key = str(rng.choice(list(value)))
        return value | {key: other_entry(rng, value[key])}
    return [None, "", 5, [], {}, "\x1b[2J", 1e308, True][rng.integers(8)]


def clock_set(rng: np.random.Generator, time: np.ndarray) -> np.ndarray:
    """Return time stamps of a clock that was set, mispaced or trembling."""
    time, at = time.copy(), int(rng.integers(1, len(time)))
    size = 10.0 ** rng.uniform(-6, 1)
    kind = rng.integers(4)
    if kind < 2:
        time[at:] += size if kind else -size
    elif kind == 2:
        steps = np.diff(time)
        steps[at - 1 : at - 1 + rng.integers(1, len(time))] *= 10.0 ** rng.uniform(-2, 2)
        time[1:] = time[0] + np.cumsum(steps)
    else:
        time[1:-1] += size * np.median(np.diff(time)) * rng.uniform(-1, 1, len(time) - 2)
    return time


def easier(rng: np.random.Generator, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the contents of a more permissive scene."""
    data = copy.deepcopy(dict(data))
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(6)
        obstacles = data.get("obstacles") or []
        if kind == 0 and obstacles:
            obstacles.pop(int(rng.integers(len(obstacles))))
        elif kind == 1 and obstacles:
            own = obstacles[int(rng.integers(len(obstacles)))]
            own["center"] = [
                float(x) for x in np.array(own["center"]) + rng.normal(size=len(own["center"])) * 0.3
            ]
            own.pop("motion", None)
        elif kind == 2:
            limits = data.setdefault("limits", {})
            for key in list(limits):
                if limits[key] is None:
                    continue
                limits[key] = limits[key] * float(10 ** rng.uniform(0, 2)) if key != "clearance" else 0.0
        elif kind == 3:
            data["duration"] = float(data["duration"] * 10 ** rng.uniform(-1, 0.5))
        elif kind == 4:
            data["workspace"] = {
                "lower": [x - 1.0 for x in data["workspace"]["lower"]],
                "upper": [x + 1.0 for x in data["workspace"]["upper"]],
            }
        else:
            for hand in data["manipulators"]:
                hand["goal"] = [float(x) for x in np.array(hand["goal"]) + 0.05]
    return data


def scene_of(data: Mapping[str, Any]) -> Scene:
    """Return a scene, without warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        return Scene.from_dict(dict(data))


def claimed(motion: Any, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return a summary that claims a motion verified, with comove's measures."""
    report = verify(motion).report
    measures = {name: finite(value) for name, value in report.asdict().items()}
    terms = {name: WEIGHTS[name] * unit for name, unit in unit_terms(motion).items()} | {"resemblance": 0.0}
    return {
        **summary,
        **measures,
        **smoothness_of(motion),
        "verified": True,
        "reasons": [],
        "cost_terms": terms,
        "cost": sum(terms.values()),
        "cost_weights": {name: WEIGHTS[name] for name in ("goal", "velocity", "obstacle")},
        "duration": motion.scene.duration,
        "scene": motion.scene.name,
        "scene_sha256": motion.scene.sha256,
    }


@dataclass(frozen=True)
class Case:
    """Forged folder, with the trusted scene and its own."""

    folder: Path
    trusted: Scene | None
    own: Scene | None

    @property
    def scene(self) -> Scene | None:
        """Return the scene of the verification."""
        return self.trusted if self.trusted is not None else self.own


def bytes_changed(rng: np.random.Generator, folder: Path) -> None:
    """Change or cut off some bytes of a file."""
    path = sorted(path for path in folder.iterdir() if path.suffix in (".json", ".npz"))[rng.integers(2)]
    data = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 5)):
        data[rng.integers(len(data))] = rng.integers(256)
    path.write_bytes(data[: rng.integers(1, len(data))] if rng.random() < 0.3 else data)


# --- motions of hands -----------------------------------------------------------------------------------------------


@cache
def bases(kind: str) -> Path:
    """Return folders of a kind, made once a process."""
    return MAKERS[kind](Path(tempfile.mkdtemp(prefix="tampering-", dir=SHM)))


def make_motions(folder: Path) -> Path:
    """Make solved scenes, with several seeds."""
    for number, data in enumerate(SCENES):
        for seed in (0, 1):
            with whole_folder(folder / f"{number}-{seed}", RESULT) as draft:
                save_result(comove.solve(scene_of(data), seed=seed), draft, wall_time_s=1.0)
    return folder


def forge_motion(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge a motion of end effectors."""
    number = int(rng.integers(len(SCENES)))
    source, other = (base / f"{number}-{seed}" for seed in rng.permutation(2))
    shutil.copytree(source, folder)
    scene, stored = scene_of(SCENES[number]), read_result(source)
    summary, arrays, own = dict(stored.summary), dict(stored.arrays), SCENES[number]
    kind = rng.integers(8)
    if kind == 0:
        bytes_changed(rng, folder)
        return Case(folder, scene if rng.random() < 0.5 else None, scene)
    if kind == 1:  # numbers of an array
        for name in rng.choice(list(arrays), rng.integers(1, 3)):
            arrays[str(name)] = noise(rng, arrays[str(name)])
    elif kind == 2:  # entries of the summary
        for key in rng.choice(list(summary), rng.integers(1, 3)):
            summary[str(key)] = other_entry(rng, summary[str(key)])
    elif kind == 3:  # another motion's arrays or summary
        theirs = read_result(other)
        if rng.random() < 0.5:
            arrays = dict(theirs.arrays)
        else:
            names = [name for name in arrays if rng.random() < 0.5]
            arrays |= {name: theirs.arrays[name] for name in names}
    elif kind == 4:  # what the curve is said to be
        arrays["basis_metric"] = np.array(rng.choice(["velocity", "acceleration", "jerk", "none"]))
        arrays["coordinates"] = np.array(rng.choice(["load", "arms", "projected"]))
    else:  # another curve on an easier scene, with everything that goes with it
        if kind > 5:
            own = easier(rng, own)
        easy = scene_of(own)
        curve, size = dict(arrays), 10.0 ** rng.uniform(-6, 0.3)
        if rng.random() < 0.8:
            shape = curve["weights"].shape
            decay = 0.5 ** (np.arange(shape[1]) * rng.choice([0.0, 0.5]))
            curve["weights"] = curve["weights"] + size * decay * rng.normal(size=shape)
        boundary = coordinates_for(easy, str(curve["coordinates"])).boundary()
        curve |= {"start": boundary[:2], "goal": boundary[2:]}  # of the easier scene
        if rng.random() < 0.2:
            end = str(rng.choice(["start", "goal"]))
            curve[end] = noise(rng, curve[end])
        motion = rebuild(curve, easy)
        arrays, summary = motion_arrays(motion), claimed(motion, summary)
        if rng.random() < 0.5:
            summary["scene_sha256"], summary["scene"] = scene.sha256, scene.name
        if rng.random() < 0.15:
            summary["clearance_min"] = 0.5
    (folder / SCENE).write_bytes(canonical(scene_of(own).file) + b"\n")
    shutil.rmtree(folder / "inputs", ignore_errors=True)
    (folder / "inputs.json").unlink(missing_ok=True)
    SOLUTION.write(folder, summary, arrays)
    return Case(folder, scene if rng.random() < 0.5 else None, scene_of(own))


def look_at_motion(case: Case) -> list[str]:
    """Return the contradictions of a verified end-effector motion."""
    stored = read_result(case.folder)
    found = contradictions(case.scene, stored.arrays["time"], stored.arrays["position"])
    least = clearance_of(case.scene, stored.arrays["time"], stored.arrays["position"])
    stated = stored.summary["clearance_min"]
    if stated is not None and stated > least + NEAR:
        found.append("stated clearance")
    return found


# --- executions -----------------------------------------------------------------------------------------------------


def make_runs(folder: Path) -> Path:
    """Make executions of the scenes, with several seeds."""
    for number, data in enumerate(SCENES):
        for seed in (0, 1):
            data = {**data, "limits": {k: v for k, v in data["limits"].items() if k != "jerk"}}
            executor = Executor(scene_of(data), seed=seed, pace=Pace(period=0.02))
            record = executor.run(20.0)
            with whole_folder(folder / f"{number}-{seed}", RESULT) as draft:
                report, log = verify_execution(record), executor.log
                write_run(draft, record, report, log, seed=seed, interrupted=False, wall_time_s=1.0)
    return folder


def forge_run(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge an execution."""
    number = int(rng.integers(len(SCENES)))
    source, other = (base / f"{number}-{seed}" for seed in rng.permutation(2))
    shutil.copytree(source, folder)
    own = json.loads((folder / SCENE).read_text())
    scene = scene_of(own)
    summary, arrays = RUN.read(source)
    arrays = {name: array.copy() for name, array in arrays.items()}
    n, kind = len(arrays["time"]), rng.integers(10)
    swing = np.sin(np.linspace(0.0, np.pi, n)) ** rng.integers(1, 6)
    if kind == 0:
        bytes_changed(rng, folder)
        return Case(folder, scene if rng.random() < 0.5 else None, scene)
    if kind == 1:
        for name in rng.choice(list(arrays), rng.integers(1, 3)):
            arrays[str(name)] = noise(rng, arrays[str(name)])
    elif kind == 2:
        for key in rng.choice(list(summary), rng.integers(1, 3)):
            summary[str(key)] = other_entry(rng, summary[str(key)])
    elif kind == 3:  # through things, with poses and hands alike
        away = 10.0 ** rng.uniform(-4, -0.3) * rng.normal(size=scene.n_dims)
        arrays["position"] += swing[:, None, None] * away
        arrays["center"][:, 0, : scene.n_dims] += swing[:, None] * away
    elif kind == 4:  # faster, or slower
        arrays["time"] *= 10.0 ** rng.uniform(-1, 1)
    elif kind == 5:  # steps left out, or doubled
        keep = np.sort(rng.choice(n, rng.integers(3, n + 1), replace=bool(rng.random() < 0.5)))
        arrays = {name: array[keep] for name, array in arrays.items()}
        if rng.random() < 0.5:
            arrays["time"] = np.linspace(0.0, arrays["time"][-1], len(keep))
    elif kind == 6:  # turned, stretched or off the plane
        arrays["quaternion"] *= 10.0 ** rng.uniform(-1, 0.1)
    elif kind == 9:
        arrays["time"] = clock_set(rng, arrays["time"])
    elif kind == 7:
        theirs = RUN.read(other)[1]
        length = min(n, len(theirs["time"]))
        names = [name for name in arrays if rng.random() < 0.5]
        arrays = {name: (theirs if name in names else arrays)[name][:length] for name in arrays}
    if rng.random() < 0.2:  # off the plane, where nothing is in the way
        arrays["center"][..., 2] += rng.choice([1e-3, 0.3, 5.0])
    if rng.random() < 0.5:  # obstacles elsewhere
        arrays["obstacle_center"] = arrays["obstacle_center"] + rng.normal(size=scene.n_dims)
    if kind == 8 or rng.random() < 0.3:
        own = easier(rng, own)
    easy = scene_of(own)
    stored = StoredRun(folder, summary, arrays, easy)
    if kind != 2:
        said = verify_execution(stored.record)
        measures = {name: finite(value) for name, value in said.asdict().items() if name != "reasons"}
        terms = {name: WEIGHTS[name] * unit for name, unit in unit_terms_of(arrays["position"]).items()}
        terms["resemblance"] = 0.0
        summary |= measures | {"verified": True, "reasons": [], "duration_s": float(arrays["time"][-1])}
        summary |= {"cost_terms": terms, "cost": sum(terms.values())}
        summary |= {"scene_sha256": (scene if rng.random() < 0.5 else easy).sha256, "scene": easy.name}
    (folder / SCENE).write_bytes(canonical(easy.file) + b"\n")
    RUN.write(folder, summary, arrays)
    return Case(folder, scene if rng.random() < 0.5 else None, easy)


def look_at_run(case: Case) -> list[str]:
    """Return a verified execution's contradictions, also halfway between samples."""
    summary, arrays = RUN.read(case.folder)
    if (np.diff(arrays["time"]) <= 0.0).any():
        return ["clock"]
    found = contradictions(case.scene, arrays["time"], arrays["position"], miss=1.1e-3, differ=False)
    least = clearance_of(case.scene, arrays["time"], arrays["position"])
    if summary["clearance_min"] is not None and summary["clearance_min"] > least + NEAR:
        found.append("stated clearance")
    halfway = (0.5 * (one[1:] + one[:-1]) for one in (arrays["time"], arrays["position"]))
    if clearance_of(case.scene, *halfway) < -NEAR:
        found.append("contact between steps")
    turned = np.abs(np.linalg.norm(arrays["quaternion"], axis=2) - 1.0).max() > NEAR
    if turned or (case.scene.n_dims == 2 and np.abs(arrays["center"][..., 2]).max() > NEAR):
        found.append("poses")
    step = np.diff(arrays["time"])
    speed = np.linalg.norm(np.diff(arrays["position"], axis=0), axis=2) / step[:, None]
    if speed.max() > case.scene.speed_limit * (1 + DT):
        found.append("speed")
    return found


# --- studies --------------------------------------------------------------------------------------------------------


def make_studies(folder: Path) -> Path:
    """Make a study of three episodes."""
    import yaml

    from comove.data import Study, on_processes, run_study

    examples = Path(__file__).parents[1] / "examples" / "studies"
    contents = yaml.safe_load((examples / "planar.yaml").read_text()) | {"episodes": 3, "seed": 0}
    shutil.copy(examples / "posts.yaml", folder)
    (folder / "study.yaml").write_text(yaml.safe_dump(contents))
    run_study(Study.load(folder / "study.yaml"), folder / "out", on_processes(1))
    return folder


def forge_study(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge the run database of a study."""
    from comove.data import StudyStore
    from comove.data.episode import packed, unpacked
    from comove.data.runs import RUNS

    folder.mkdir()
    shutil.copy(base / "out" / RUNS, folder)
    store = StudyStore.open(folder / RUNS)
    kept = list(store.motions())
    run, motion = kept[rng.integers(len(kept))]
    other = kept[rng.integers(len(kept))][1]
    data, curve = json.loads(zlib.decompress(motion.scene)), unpacked(motion.curve)
    kind = rng.integers(5)
    if kind == 0:
        curve = unpacked(other.curve)
    elif kind == 1:
        name = str(rng.choice([name for name in curve if curve[name].dtype.kind == "f"]))
        curve[name] = noise(rng, curve[name])
    elif kind == 2:
        data = easier(rng, data)
    elif kind == 3:
        data = json.loads(zlib.decompress(other.scene))
    scene = scene_of(data)
    rows: dict[str, Any] = {"clearance_min": 0.5, "end_error": 0.0, "scene": scene.name}
    if rng.random() < 0.7:
        rows["scene_sha256"] = scene.sha256
    with contextlib.suppress(ComoveError):
        rows["motion_sha256"] = checksum(motion_arrays(rebuild(curve, scene)))
    with store.connected() as connection:
        values = zlib.compress(canonical(scene.file)), packed(curve), run.key
        connection.execute("UPDATE motions SET scene = ?, curve = ? WHERE key = ?", values)
        for key, value in rows.items():
            connection.execute(f"UPDATE runs SET {key} = ? WHERE key = ?", (value, run.key))
    return Case(folder, None, None)


@cache
def trusted_study() -> Any:
    """Return the study of its file."""
    from comove.data import Study

    return Study.load(bases("studies") / "study.yaml")


def judge_study(case: Case) -> list[str]:
    """Return the contradictions of an exported dataset. Raise the errors of the export."""
    from comove.data.datasets.samples import episodes_of

    study, found = trusted_study(), []
    for episode in episodes_of(case.folder, study.folder, 100, study):
        drawn = drawn_of(episode.run.number)
        duration, time = drawn.duration, episode.time
        inside = time <= duration
        found += contradictions(drawn, time[inside], episode.position[inside], differ=False, miss=0.02)
        least = clearance_of(drawn, time, episode.position)
        if episode.about["clearance_min"] > least + 1e-4 or episode.about["scene_sha256"] != drawn.sha256:
            found.append("figures")
    return found


@cache
def drawn_of(number: int) -> Scene:
    """Return the scene that the study samples."""
    return trusted_study().draw(number).scene


# --- robots ---------------------------------------------------------------------------------------------------------


def make_joints(folder: Path) -> Path:
    """Make the known movement of Baxter."""
    from tests.robots.known_folder import write

    write(folder / "result")
    return folder


def forge_joints(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge the joints of a robot, or the robot."""
    from comove.robots import JointMotion, verify_joints
    from comove.robots.files import JOINTS, joint_arrays
    from tests.robots.known_carry import baxter, known_carry

    motion, joints = known_carry()
    shutil.copytree(base / "result", folder)
    shutil.rmtree(folder / "inputs", ignore_errors=True)
    (folder / "inputs.json").unlink(missing_ok=True)
    summary, arrays = JOINTS.read(folder)
    arrays = {name: array.copy() for name, array in arrays.items()}
    kind, robot = rng.integers(8), baxter()
    if kind == 0:
        bytes_changed(rng, folder)
        return Case(folder, motion.scene if rng.random() < 0.5 else None, motion.scene)
    if kind == 1:
        name = str(rng.choice([name for name in arrays if arrays[name].dtype.kind == "f"]))
        arrays[name] = noise(rng, arrays[name])
    elif kind == 2:
        for key in rng.choice(list(summary), rng.integers(1, 3)):
            summary[str(key)] = other_entry(rng, summary[str(key)])
    else:  # other joints or times, with what goes with them
        position, time_ = arrays["position"].copy(), arrays["time"].copy()
        if kind == 3:
            swing = np.sin(np.linspace(0.0, np.pi, len(time_))) ** 3
            position[:, rng.integers(position.shape[1])] += 10.0 ** rng.uniform(-6, 0) * swing
        elif kind == 4:
            time_ *= 10.0 ** rng.uniform(-1, 0.3)
        elif kind == 6:  # a tremor, which samples of torques may miss
            time_ = np.linspace(0.0, time_[-1], int(rng.integers(2, 9)) * len(time_))
            position = np.array(joints.curve(time_))
            wave = np.sin(
                2.0 * np.pi * rng.choice([25.0, 50.0, 100.0, 200.0]) * time_ + rng.choice([0.0, 1.0])
            )
            wave *= np.sin(np.linspace(0.0, np.pi, len(time_))) ** 3
            position[:, rng.integers(position.shape[1])] += 10.0 ** rng.uniform(-7, -2) * wave
        elif kind == 7:  # the same places at other instants
            time_ = clock_set(rng, time_)
        else:
            position += 10.0 ** rng.uniform(-6, -1) * rng.normal(size=position.shape[1])
        forged = JointMotion(time_, joints.joint_names, position)
        arrays = joint_arrays(forged)
        if rng.random() < 0.7:  # what the verifier itself finds, or would find
            report = verify_joints(robot, motion, forged).report
            summary |= {name: finite(value) for name, value in report.asdict().items()}
    summary["verified"] = True if rng.random() < 0.9 else summary.get("verified")
    if rng.random() < 0.2:
        summary["robot_file"] = "pr2"
    JOINTS.write(folder, summary, arrays)
    return Case(folder, motion.scene if rng.random() < 0.5 else None, motion.scene)


@dataclass(frozen=True)
class RawRobot:
    """Robot from its installed URDF.

    Attributes
    ----------
    links : its links (`tests.robots.raw_links`)
    lower, upper, velocity, effort : limits of the joints in the raw file
    """

    links: Any
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray

    def over_limits(self, q: np.ndarray, t: np.ndarray) -> list[str]:
        """Return which limits samples of joints exceed."""
        found = []
        if (q < self.lower - 1e-9).any() or (q > self.upper + 1e-9).any():
            found.append("range")
        if (np.abs(np.diff(q, axis=0) / np.diff(t)[:, None]) > self.velocity * (1 + DT)).any():
            found.append("joint speed")
        return found

    def over_torque(self, robot: Any, scene: Scene, q: np.ndarray, t: np.ndarray) -> bool:
        """Return whether torques along a spline of samples exceed their limits. A bar is held in its middle, half of
        it by each end effector; springs hold their share of the weight."""
        import pinocchio as pin
        from scipy.interpolate import CubicSpline

        (part,) = self.links.parts
        model = part.model.copy()
        half = pin.Inertia(0.5 * (scene.file.load.mass or 0.25), np.zeros(3), np.zeros((3, 3)))
        for name in scene.manipulators:
            frame = model.frames[model.getFrameId(robot.arm(name).tip)]
            model.appendBodyToJoint(frame.parentJoint, half, frame.placement * pin.SE3(robot.arm(name).tool))
        curve, data = CubicSpline(t, q, bc_type="clamped"), model.createData()
        for instant in np.interp(np.arange(7 * len(t) - 6) / 7, np.arange(len(t)), t)[
            :: max(1, len(t) // 300)
        ]:
            values = [curve(instant, order) for order in range(3)]
            rates = np.zeros((2, model.nv))
            rates[:, part.columns] = values[1:]
            whole = part.whole(values[0])
            torque = pin.rnea(model, data, whole, *rates)[part.columns]
            weight = pin.computeGeneralizedGravity(part.model, part.data, whole)[part.columns]
            if (np.abs(torque - robot.relief * weight) > self.effort * (1 + DT)).any():
                return True
        return False


@cache
def raw_baxter() -> RawRobot:
    """Return Baxter, from its installed URDF."""
    import xml.etree.ElementTree as ET

    from tests.robots.known_carry import baxter
    from tests.robots.raw_links import RawLinks

    robot = baxter()
    (file,) = {source.file for source in robot.sources}
    limits = {joint.get("name"): joint.find("limit") for joint in ET.parse(file).iter("joint")}
    limits = {name: limit for name, limit in limits.items() if limit is not None}
    names = robot.joint_names
    told = [
        [float(limits[name].get(key)) for name in names] for key in ("lower", "upper", "velocity", "effort")
    ]
    return RawRobot(RawLinks(robot), *map(np.array, told))


def look_at_joints(case: Case) -> list[str]:
    """Return the contradictions of verified joints by the raw URDF."""
    from comove.robots.files import JOINTS
    from tests.robots.known_carry import baxter

    summary, arrays = JOINTS.read(case.folder)
    q, t, raw = arrays["position"], arrays["time"], raw_baxter()
    if (np.diff(t) <= 0.0).any():
        return ["clock"]
    found = raw.over_limits(q, t)
    if raw.over_torque(baxter(), case.scene, q, t):
        found.append("torque")
    if summary["clearance_scene"] is not None:
        some = slice(None, None, max(1, len(t) // 40))
        least = float(raw.links.distances(case.scene.file.obstacles, t[some], q[some]).min())
        if summary["clearance_scene"] > least + 1e-4:
            found.append(
                f"stated clearance of links, {summary['clearance_scene']:g} m, at samples {least:g} m"
            )
    return found + _hands_off(case, q, t)


def _hands_off(case: Case, q: np.ndarray, t: np.ndarray) -> list[str]:
    """Return where joints deviate from the end effectors' stored samples."""
    stored = read_result(case.folder)
    time_, position = stored.arrays["time"], stored.arrays["position"]
    at = np.stack([np.interp(t, time_, x) for x in position.reshape(len(time_), -1).T], 1)
    off = np.linalg.norm(tools(case.scene, q) - at.reshape(len(t), -1, 3), axis=2).max()
    return ["hands"] if off > 2e-4 or abs(t[-1] - time_[-1]) > 1e-6 else []


def tools(scene: Scene, q: np.ndarray) -> np.ndarray:
    """Return the tools' positions by Pinocchio on the raw URDF. The tools are those of the description; array, shape
    (n_steps, n_hands, 3)."""
    links = raw_baxter().links
    return np.array([[links.grasp(name, joints).translation for name in scene.manipulators] for joints in q])


def make_simulations(folder: Path) -> Path:
    """Make a simulation of the known movement of Baxter."""
    from comove.sim import play, write_simulation
    from tests.robots.known_carry import baxter, known_carry

    make_joints(folder)
    motion, joints = known_carry()
    write_simulation(play(joints, baxter(), motion.scene), folder / "result")
    return folder


def forge_simulation(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge a simulation."""
    from comove.sim import SIMULATION
    from tests.robots.known_carry import known_carry

    scene = known_carry()[0].scene
    shutil.copytree(base / "result", folder)
    shutil.rmtree(folder / "inputs", ignore_errors=True)
    (folder / "inputs.json").unlink(missing_ok=True)
    summary, arrays = SIMULATION.read(folder)
    arrays = {name: array.copy() for name, array in arrays.items()}
    kind = rng.integers(4)
    if kind == 0:
        for key in rng.choice(list(summary), rng.integers(1, 3)):
            summary[str(key)] = other_entry(rng, summary[str(key)])
    elif kind == 1:
        for name in rng.choice(list(arrays), rng.integers(1, 3)):
            arrays[str(name)] = noise(rng, arrays[str(name)])
    elif kind == 2:  # the load elsewhere, and all that follows from it left out
        away = 10.0 ** rng.uniform(-4, 0) * rng.normal(size=3)
        arrays["load_pose"][:, :3, 3] += np.linspace(0.0, 1.0, len(arrays["time"]))[:, None] * away
        for name in ("lag", "distance_error", "slip", "internal", "squeeze"):
            arrays.pop(name, None)
        summary |= {"end_error": 0.0, "lag_max": 0.0, "slip_max": 0.0}
    else:
        arrays["time"] *= 10.0 ** rng.uniform(-1, 1)
    summary |= {"delivered": True, "reasons": []} if rng.random() < 0.8 else {}
    SIMULATION.write(folder, summary, arrays)
    return Case(folder, scene if rng.random() < 0.5 else None, scene)


def look_at_simulation(case: Case) -> list[str]:
    """Return the contradictions of an accepted simulation."""
    from comove.sim import SIMULATION

    summary, arrays = SIMULATION.read(case.folder)
    if not summary["delivered"]:
        return []
    goals = np.array([hand.goal for hand in case.scene.file.manipulators])
    middle = arrays["load_pose"][-1, :3, 3]
    found = ["load"] if np.linalg.norm(middle - goals.mean(axis=0)) > 0.03 else []
    hands = tools(case.scene, arrays["joints"][-1:])[0]
    return found + (["hands"] if np.linalg.norm(hands - goals, axis=1).max() > 0.02 else [])


def make_robot_runs(folder: Path) -> Path:
    """Make an online run that follows its plan."""
    from tests.robots.known_run import write_known_run

    write_known_run(folder / "result")
    return folder


def forge_robot_run(rng: np.random.Generator, base: Path, folder: Path) -> Case:
    """Forge an online run of a robot."""
    from comove.sim.robot_runs import ROBOT_RUN
    from tests.robots.known_carry import known_carry

    scene = known_carry()[0].scene
    shutil.copytree(base / "result", folder)
    summary, arrays = ROBOT_RUN.read(folder)
    arrays = {name: array.copy() for name, array in arrays.items()}
    kind, n = rng.integers(6), len(arrays["time"])
    swing = np.sin(np.linspace(0.0, np.pi, n)) ** 3
    if kind == 0:
        for key in rng.choice(list(summary), rng.integers(1, 3)):
            summary[str(key)] = other_entry(rng, summary[str(key)])
    elif kind == 1:
        for name in rng.choice(list(arrays), rng.integers(1, 3)):
            arrays[str(name)] = noise(rng, arrays[str(name)])
    elif kind == 2:
        joint, size = rng.integers(arrays["commanded"].shape[1]), 10.0 ** rng.uniform(-5, 0)
        for name in ("commanded", "measured"):
            arrays[name][:, joint] += size * swing
    elif kind == 3:
        arrays["time"] *= 10.0 ** rng.uniform(-1, 1)
        summary["duration_s"] = float(arrays["time"][-1])
    elif kind == 5:
        arrays["time"] = clock_set(rng, arrays["time"])
        summary["duration_s"] = float(arrays["time"][-1])
    else:
        arrays["driven_off"][rng.integers(n) :] = True
        arrays["obstacle_center"] += rng.normal(size=3)
    summary |= {"as_it_should_be": True, "reasons": []}
    ROBOT_RUN.write(folder, summary, arrays)
    return Case(folder, scene if rng.random() < 0.5 else None, scene)


def look_at_robot_run(case: Case) -> list[str]:
    """Return the contradictions of an accepted robot run."""
    from comove.sim.robot_runs import ROBOT_RUN

    _, arrays = ROBOT_RUN.read(case.folder)
    q, t, found = arrays["commanded"], arrays["time"], []
    if (np.diff(t) <= 0.0).any():
        return ["clock"]
    found += raw_baxter().over_limits(q, t)
    hands = tools(case.scene, arrays["measured"])
    goals = np.array([hand.goal for hand in case.scene.file.manipulators])
    if np.linalg.norm(hands[-1] - goals, axis=1).max() > 5e-3:
        found.append("goal")
    if clearance_of(case.scene, t, hands) <= -1e-3:
        found.append("clearance")
    return found


# --- all of it ------------------------------------------------------------------------------------------------------

MAKERS: dict[str, Callable[[Path], Path]] = {
    "motions": make_motions,
    "runs": make_runs,
    "studies": make_studies,
    "joints": make_joints,
    "simulations": make_simulations,
    "robot-runs": make_robot_runs,
}
FORGERS = {
    "motions": (forge_motion, ResultPart.MOTION, look_at_motion),
    "runs": (forge_run, ResultPart.RUN, look_at_run),
    "studies": (forge_study, None, judge_study),
    "joints": (forge_joints, ResultPart.JOINTS, look_at_joints),
    "simulations": (forge_simulation, ResultPart.SIMULATION, look_at_simulation),
    "robot-runs": (forge_robot_run, ResultPart.ROBOT_RUN, look_at_robot_run),
}


def tried(kind: str, seed: int) -> tuple[str, str]:
    """Forge one folder; return the verifier's result, and details if wrong."""
    forge, part, look = FORGERS[kind]
    rng = np.random.default_rng([109, list(FORGERS).index(kind), seed])
    folder = Path(tempfile.mkdtemp(prefix="forged-", dir=SHM)) / "result"
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                case = forge(rng, bases(kind), folder)
            except (ComoveError, ValueError, KeyError, IndexError, np.linalg.LinAlgError, FloatingPointError):
                return "refused", "by the forger's own tools"
            try:
                if part is not None and not verify_part(folder, part, case.trusted).verified:
                    return "rejected", ""
                found = look(case)
            except ComoveError:
                return "refused", ""
            except Exception as error:
                return "crash", f"{kind} {seed}: {type(error).__name__}: {error}"
        return ("WRONG", f"{kind} {seed}: {', '.join(found)}") if found else ("verified, and true", "")
    finally:
        shutil.rmtree(folder.parent, ignore_errors=True)


def batch(kind: str, first: int, count: int) -> tuple[Counter[str], list[str]]:
    """Try some folders."""
    results = [tried(kind, first + i) for i in range(count)]
    told = [words for verdict, words in results if verdict in ("WRONG", "crash")]
    return Counter(verdict for verdict, _ in results), told


def main() -> None:
    """Forge, verify and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(COUNTS), default=list(COUNTS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="number of the first folder of each kind")
    parser.add_argument(
        "--minutes", type=float, default=np.inf, help="time after which nothing more is begun"
    )
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count)
    asked = vars(parser.parse_args())
    totals, begun = {kind: Counter[str]() for kind in asked["only"]}, time.perf_counter()
    tasks = {kind: _tasks(kind, asked["first"], asked[kind.replace("-", "_")]) for kind in asked["only"]}
    shared = filter(None, chain.from_iterable(zip_longest(*tasks.values())))  # all kinds by turns
    with ProcessPoolExecutor(asked["workers"]) as pool:
        running = {pool.submit(batch, *task): task[0] for task in islice(shared, asked["workers"])}
        while running:
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                found, told = done.result()
                totals[running.pop(done)] += found
                print(*told, sep="\n", file=sys.stderr, end="\n" if told else "", flush=True)
                task = None if time.perf_counter() - begun > 60 * asked["minutes"] else next(shared, None)
                if task is not None:
                    running[pool.submit(batch, *task)] = task[0]
    rows = [
        [kind, str(total.total()), *(str(total[word]) for word in WORDS)] for kind, total in totals.items()
    ]
    print_table(("folders", "forged", *WORDS), rows)
    print(f"\n{time.perf_counter() - begun:.0f} s")


def _tasks(kind: str, first: int, count: int) -> list[tuple[str, int, int]]:
    """Return batches of folders: kind, first number, and count."""
    return [(kind, start, min(CHUNK, first + count - start)) for start in range(first, first + count, CHUNK)]


if __name__ == "__main__":
    main()
