"""Tables of the page, as Markdown."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from comove.lab.paper.baxter import WITH_JOINTS
from comove.lab.paper.claims import Claim, ClaimFinding
from comove.lab.paper.figures import failures, median_of, share_of, verdict
from comove.lab.paper.jobs import CONTENDERS, title_of
from comove.lab.paper.measures import Measures, count_verified
from comove.lab.paper.runs import (
    AT_ONCE_SCENES,
    MOVEMENT_CONTENDERS,
    OTHER_SYSTEMS,
    RECORDED,
    RECORDING_SEEDS,
    ROLES,
    SCENES,
    SENSITIVITY,
    Runs,
    recordings,
)
from comove.lab.summaries import Interval, table

PLAIN: dict[str, Any] = {"who": "paper", "tolerance": None, "gap": None, "velocity": 0.01}
DISTANCE = "the distance between"
"""How reasons about a distance begin."""
EPOCHS = (1, 2, 4, 8, 20)
AT_ONCE_TITLES = {"open": "nothing in the way"}


def claims_table(findings: Sequence[tuple[Claim, ClaimFinding]]) -> str:
    """Return the table of claims, findings and reasons."""
    rows = [
        [claim.where, f"“{claim.quote}”", f"**{finding.verdict.value}**", finding.why, claim.rule]
        for claim, finding in findings
    ]
    return table(["where", "the paper says", "verdict", "this run", "rule"], rows)


def story_table(runs: Runs, scene: str) -> str:
    """Return the table of every method on a scene. It holds the share verified, and medians with intervals."""
    head = [
        *("method", "runs", "verified [%]", "distance error [m]", "clearance [mm]", "J"),
        *("acceleration [m/s²]", "squared jerk [m²/s⁵]", "first [s]", "all [s]"),
    ]
    rows = []
    for who in CONTENDERS:
        found = runs.measures("story", scene=scene, who=who)
        rows.append(
            [
                *(who, str(len(found)), interval_text(share_of(found, 100.0), 3)),
                interval_text(median_of(found, "distance_error"), 2),
                interval_text(median_of(found, "clearance", 1e3)),
                *(interval_text(median_of(found, name)) for name in ("cost", "acceleration", "jerk")),
                *(interval_text(median_of(found, name), 2) for name in ("first", "total")),
            ]
        )
    return table(head, rows)


def systems_table(runs: Runs) -> str:
    """Return the table of systems and scenes, by initial movement."""
    rows = []
    for who in (*OTHER_SYSTEMS, "comove"):
        cells = [_broken(runs.measures("story", scene=scene, who=who)) for scene in SCENES]
        rows.append([who, *cells, _broken(runs.measures("systems", who=who))])
    return table(["method", *SCENES, "narrow, from straight lines"], rows)


def roles_table(runs: Runs) -> str:
    """Return the table of RMS distance errors by epoch and leader."""
    rows = []
    for who, title in ROLES.items():
        outcome = runs.one("leaders", who=who)
        rms = outcome.log["epoch_error_rms_m"]
        shown = [f"{1e3 * rms[i - 1]:.3g}" if i <= len(rms) else "none" for i in EPOCHS]
        rows.append([title, *shown, verdict(outcome.measures)])
    return table(["roles", *(f"epoch {i} [mm]" for i in EPOCHS), "in the end"], rows)


def movements_table(runs: Runs) -> str:
    """Return the table of verified runs and median J by movement. Scenes and methods are listed apart."""
    rows = []
    for movement in RECORDED:
        for who in MOVEMENT_CONTENDERS:
            found = [runs.measures("movements", scene=scene, who=who, movement=movement) for scene in SCENES]
            cells = [_cost(cell) for cell in found]
            rows.append([movement, who, *cells])
    return table(["movement", "method", *SCENES], rows)


def at_once_table(runs: Runs) -> str:
    """Return the table of [22] from simultaneous recordings, by scene."""
    taught = runs.measures("as taught")
    rows = [["as taught", count_verified(taught), *_at_worst(taught)]]
    for scene in AT_ONCE_SCENES:
        found = runs.measures("at once", scene=scene)
        rows.append([AT_ONCE_TITLES.get(scene, scene), count_verified(found), *_at_worst(found)])
    head = ["", "verified", "distance off, median [mm]", "at most [mm]", "clearance, least [mm]"]
    return table(head, rows)


def _at_worst(found: Sequence[Measures]) -> list[str]:
    off = 1e3 * np.array([m.distance_error for m in found])
    return [f"{np.median(off):.2f}", f"{off.max():.2f}", f"{1e3 * min(m.clearance for m in found):.1f}"]


def with_joints_table(runs: Runs) -> str:
    """Return the table of [5] with Baxter's joints. It is by passage and initial movement."""
    rows = []
    for t in runs.transports:
        if t.passage.who == WITH_JOINTS:
            rows.append(
                [
                    *(t.passage.scene, t.passage.start, "yes" if t.verified else "no: " + t.reasons[0]),
                    *(f"{1e3 * t.end_missed:.0f}", f"{1e3 * t.log['relative_error_max_m']:.2g}"),
                    *(f"{1e3 * t.log['turn_error_max_rad']:.2g}", f"{t.log['slack_max_m_per_s']:.2g}"),
                    *("yes" if t.delivered else "no",),
                ]
            )
    head = ["passage", "begins with", "verified", "from its goal [mm]", "distance off as controlled [mm]"]
    return table([*head, "hands turned off [mrad]", "L0 gives way [m/s]", "delivered"], rows)


def transports_table(runs: Runs) -> str:
    """Return the table of Baxter's transports by passage and method."""
    rows = []
    for t in runs.transports:
        if t.passage.who == WITH_JOINTS:
            continue
        simulated = (
            "-" if t.lag is None else f"{1e3 * t.lag:.1f}",
            "-" if t.end_error is None else f"{1e3 * t.end_error:.1f}",
        )
        rows.append(
            [
                *(t.passage.scene, title_of(t.passage.who), str(t.passage.seed)),
                *("yes" if t.verified else "no", f"{np.rad2deg(t.turn):.0f}"),
                *(f"{t.distance_error:.2g}", f"{1e3 * t.clearance:.1f}", f"{t.seconds:.1f}"),
                *("yes" if t.delivered else "no", *simulated),
            ]
        )
    head = [
        "passage",
        "method",
        "seed",
        "verified",
        "stick turns [°]",
        "distance error [m]",
        "clearance [mm]",
        "search [s]",
    ]
    return table([*head, "delivered", "behind its plan [mm]", "from its goal [mm]"], rows)


def sensitivity_table(runs: Runs) -> str:
    """Return the table of the paper's method with single changed settings. The scene is the narrow passage."""
    rows = []
    for what, values in SENSITIVITY.items():
        for value, changes in values.items():
            asked = PLAIN | changes
            found = runs.measures("sensitivity", **asked)
            rows.append(
                [what, value, count_verified(found), *(_median(found, n) for n in ("first", "cost", "jerk"))]
            )
    return table(["what", "value", "verified", "first [s]", "J", "squared jerk [m²/s⁵]"], rows)


def recordings_table(runs: Runs) -> str:
    """Return the table of the paper's method from ten recordings."""
    rows = [
        [
            shape,
            *(_cost(runs.measures("recordings", movement=shape, scene=scene)) for scene in RECORDING_SEEDS),
        ]
        for shape in recordings()
    ]
    found = [runs.measures("recordings", scene=scene) for scene in RECORDING_SEEDS]
    return table(["recording", *RECORDING_SEEDS], [*rows, ["all", *map(count_verified, found)]])


def failures_table(runs: Runs, scene: str) -> str:
    """Return the table of failed attempts from recordings on a scene. It names the constraints and their errors."""
    rows = [
        [o.job.movement, str(o.job.seed), what_failed(o.measures), str(o.measures.generations)]
        for o in failures(runs, scene)
    ]
    return table(["recording", "seed", "what failed", "generations"], rows)


def what_failed(m: Measures) -> str:
    """Return the violated constraints and their errors; of distances the worst."""
    others = [reason for reason in m.reasons if not reason.startswith(DISTANCE)]
    if len(others) < len(m.reasons):
        others.insert(0, f"a distance is off by up to {m.distance_error:.3g} m")
    return "; ".join(others)


def encounters_table(runs: Runs) -> str:
    """Return the table of all methods against the moving obstacle."""
    rows = [
        [
            e.method,
            f"{e.distance_error:.2g}",
            f"{1e3 * e.clearance:.1f}",
            "yes" if e.arrived else "no",
        ]
        for e in runs.compared
    ]
    return table(["method", "distance error [m]", "clearance [mm]", "arrives"], rows)


def all_runs(runs: Runs) -> str:
    """Return every run as CSV, one per line."""
    text = io.StringIO()
    names = [
        *("purpose", "scene", "who", "movement", "seed"),
        *("tolerance", "acceleration", "velocity", "gap", "resemblance", "obstacles"),
    ]
    figures = [name for name in asdict(runs.outcomes[0].measures) if name != "reasons"]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*names, *figures])
    for outcome in runs.outcomes:
        values = [getattr(outcome.measures, name) for name in figures]
        writer.writerow([*(getattr(outcome.job, name) for name in names), *map(_plain, values)])
    return text.getvalue()


def interval_text(interval: Interval, digits: int = 3) -> str:
    """Return a value and, if it has one, its interval as text."""
    if np.isnan(interval.value):
        return "none"
    value, low, high = (f"{x:.{digits}g}" for x in interval)
    return value if low == high else f"{value} ({low} to {high})"


def _broken(found: Sequence[Measures]) -> str:
    """Return the first run's result and the number of verified runs. The first run has the lowest seed."""
    verified = sum(m.verified for m in found)
    words = verdict(found[0])
    if len(found) == 1:
        return words
    if verified == len(found):
        return f"{verified} of {len(found)} verified"
    return f"{verified} of {len(found)} verified; first seed: {words}"


def _cost(found: Sequence[Measures]) -> str:
    verified = [m for m in found if m.verified]
    count = f"{len(verified)} of {len(found)}"
    return f"{count}, J {np.median([m.cost for m in verified]):.3f}" if verified else count


def _median(found: Sequence[Measures], name: str) -> str:
    """Return the median over verified runs as text, else "none"."""
    values = [getattr(m, name) for m in found if m.verified]
    return f"{np.median(values):.3g}" if values else "none"


def _plain(value: object) -> object:
    return f"{value:.6g}" if isinstance(value, float) else value
