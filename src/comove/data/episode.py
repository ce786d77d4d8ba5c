"""One run of a study: its solution, figures and stored motion."""

from __future__ import annotations

import io
import json
import math
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.data.many import movement_of
from comove.data.runs import LONGEST, StoredMotion, StudyRun
from comove.data.variety import N_PATH, center_path, passing_class
from comove.errors import ComoveWarning, InputError, ResultError
from comove.model.files.keys import canonical
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning import Budget, Solution, solve
from comove.planning.effort import NORMAL, EffortLevel
from comove.planning.method import Method
from comove.results.sealed import checksum, finite
from comove.results.solution import curve_arrays, motion_arrays, rebuild
from comove.verification.bounds import largest_jerk, node_bounds

Made = tuple[StudyRun, StoredMotion | None]

OPTION = "budget:"  # of a study, in words
DAMAGED = "copy the store again, or generate the episode again in a new folder"


def solved_run(
    run: StudyRun, scene: Scene, method: Method, budget: float, effort: EffortLevel = NORMAL
) -> Made:
    """Solve a scene; return the run's row and its verified motion.

    The motion follows the demonstration that the scene names.

    Parameters
    ----------
    run : the row as far as it is known
    budget : processor time for the solution [s]
    """

    def search(run: StudyRun) -> Made:
        bounds = Budget.of(budget, option=OPTION)
        solution = solve(
            scene,
            demonstration=movement_of(scene),
            seed=run.seed,
            method=method,
            budget=bounds,
            effort=effort,
        )
        motion = stored(run.key, solution.attempt) if solution.verified else None
        return measured(run, solution), motion

    return timed_run(run, scene, search)


def timed_run(run: StudyRun, scene: Scene, search: Callable[[StudyRun], Made]) -> Made:
    """Return a search's result for a run, with its processor time. Invalid input is reported in the row."""
    begun, started = time.process_time(), datetime.now(UTC).isoformat(timespec="milliseconds")
    run, motion = replace(run, scene=scene.name, scene_sha256=scene.sha256, started=started), None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            run, motion = search(run)
    except InputError as error:
        run = replace(run, status="refused", reason=str(error)[:LONGEST])
    return replace(run, seconds=time.process_time() - begun), motion


def measured(run: StudyRun, solution: Solution) -> StudyRun:
    """Return the row of a run with the figures of its solution."""
    report, motion = solution.report, solution.attempt
    return replace(
        run,
        status="verified" if solution.verified else "not verified",
        reason="; ".join(solution.reasons)[:LONGEST],
        cut_short=int(solution.timed_out),
        duration=solution.scene.duration,
        cost=finite(solution.cost.total),
        clearance_min=finite(report.clearance_min),
        distance_error_max=finite(report.distance_error_max),
        end_error=finite(report.end_error),
        speed_max=finite(report.speed_max),
        acceleration_max=finite(report.acceleration_max),
        jerk_max=finite(largest_jerk(motion, node_bounds(motion).jerk)),
        followed=None if solution.followed is None else solution.followed.distance,
        passing=passing_class(motion),
        motion_sha256=checksum(motion_arrays(motion)),
        first=solution.effort.first_verified,
    )


def sample_times(scene: Scene, rate: int) -> NDArray[np.float64]:
    """Return the sample times of a motion [s], shape (n_steps,).

    Parameters
    ----------
    rate : samples a second [Hz]
    """
    return np.arange(math.ceil(scene.duration * rate - 1e-9) + 1) / rate


def stored(key: str, motion: CoordinatedMotion) -> StoredMotion:
    """Return a motion for the run database, with its centre's path."""
    return StoredMotion(
        key,
        zlib.compress(canonical(motion.scene.file)),
        packed(curve_arrays(motion)),
        center_path(motion, N_PATH).astype("<f4").tobytes(),
    )


def restored(kept: StoredMotion, folder: Path, store: Path) -> CoordinatedMotion:
    """Rebuild a motion from the run database.

    Parameters
    ----------
    folder : folder to which paths in the scene are relative
    store : path of the run database, for messages

    Raises
    ------
    ResultError
        If it was damaged.
    """
    try:
        contents = json.loads(zlib.decompress(kept.scene))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            scene = Scene.from_dict(contents, folder=folder)
        return rebuild(unpacked(kept.curve), scene)
    except (ValueError, KeyError, EOFError, zlib.error, zipfile.BadZipFile, InputError) as error:
        raise ResultError(
            f"the motion of the row '{kept.key[:12]}' cannot be rebuilt: {error}", file=store, way_out=DAMAGED
        ) from error


def packed(arrays: Mapping[str, Any]) -> bytes:
    """Return arrays as bytes of an NPZ archive, equal whenever made."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(arrays[name]), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy")
            archive.writestr(entry, member.getvalue(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def unpacked(content: bytes) -> dict[str, Any]:
    """Return the arrays of an NPZ archive without Python objects."""
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}
