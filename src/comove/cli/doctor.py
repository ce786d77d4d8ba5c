"""`comove doctor`."""

from __future__ import annotations

import json
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove._version import __version__
from comove.cli.app import VERIFIED, verb
from comove.cli.texts import in_rows
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.ros.looking import RosFound

LIBRARIES = {
    "robots": ("pin", "coal"),
    "simulation": ("mujoco",),
    "data": ("pyarrow", "rosbags"),
    "pictures": ("matplotlib",),
    "workbench": ("viser",),
}
"""What comove uses where it is installed, by purpose."""


@verb
def doctor(
    ros: Annotated[
        int | None, typer.Option(metavar="2", help="Look at ROS 2: controllers, joint states, clocks.")
    ] = None,
    joint_states: Annotated[
        str | None,
        typer.Option(metavar="TOPIC", help="Topic of the joint states; /joint_states unless given."),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> int:
    """Tell what is installed here, and with --ros 2 which controllers answer. Nothing moves."""
    if ros is None and joint_states is not None:
        raise OptionError("nothing is looked at in ROS", key="--joint-states", way_out="give --ros 2 as well")
    if ros not in (None, 2):
        raise OptionError(f"it looks at ROS 2, not at ROS {ros}", key="--ros", way_out="give --ros 2")
    if ros is None:
        found: dict[str, Any] = {"comove": __version__} | {
            what: ", ".join(_installed(name) for name in names) for what, names in LIBRARIES.items()
        }
        rows = list(found.items())
    else:
        from comove.results.sealed import finite
        from comove.ros.looking import look

        seen = look(joint_states)
        found, rows = asdict(seen), _rows(seen)
        found["age"] = [finite(age) for age in seen.age]
    print(json.dumps(found, indent=2) if json_ else "\n".join(in_rows(rows)))
    return VERIFIED


def _installed(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"{name} is missing"


def _rows(seen: RosFound) -> list[tuple[str, str]]:
    """Return what was found in ROS, in words."""
    rows = [
        ("distribution", seen.distribution or "not named (ROS_DISTRO is not set)"),
        ("middleware", f"{seen.middleware}, domain {seen.domain}, Python {seen.python}"),
    ]
    for server in seen.servers:
        answered = "no answer" if server.answer is None else f"answers within {1e3 * server.answer:.1f} ms"
        rows.append(("controller", f"{server.action}: {answered}{', has a goal' if server.busy else ''}"))
    if not seen.servers:
        rows.append(("controller", "none: no action server of FollowJointTrajectory was found"))
    if not seen.joints:
        return [*rows, ("joint states", f"none on {seen.topic}")]
    rows.append(
        (
            "joint states",
            f"{len(seen.joints)} joints on {seen.topic}, {seen.rate:.0f} Hz, {', '.join(seen.nodes)}",
        )
    )
    rows.append(("joints", ", ".join(seen.joints)))
    median, worst = (1e3 * age for age in seen.age)
    rows.append(("age of joints", f"{median:.1f} ms, {worst:.1f} ms at most (clocks, and the way)"))
    if seen.conflict:
        rows.append(("conflict", f"the joint '{seen.conflict}' is told by several nodes"))
    return rows
