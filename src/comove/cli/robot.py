"""`comove robot`: describe robots and make scenes for them. The verbs are `convert`, `new`, `check` and `scene`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli import export, run, send, simulate, solve
from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, former_verb_of, sub_application, verb_of
from comove.cli.texts import say
from comove.errors import OptionError, RobotError, SceneError

if TYPE_CHECKING:
    from comove.model import Scene
    from comove.robots import Arm, Robot
    from comove.robots.proposal import Examination

group = sub_application("robot", "Descriptions of robots: convert, new, check, scene.")
for former in (solve.solve, run.run, simulate.simulate, export.export, send.send):
    former_verb_of(group, former)

Described = Annotated[
    str, typer.Argument(metavar="ROBOT", help="A description (YAML), or a bundled robot's name.")
]
Obstacles = Annotated[
    Path | None,
    typer.Option(
        help="Obstacles that stand around the robot (YAML), such as `convert` writes, or a scene of them."
    ),
]


@verb_of(group)
def convert(
    model: Annotated[Path, typer.Argument(metavar="FILE", help="Model of MuJoCo's (MJCF).")],
    out: Annotated[Path, typer.Option(help="Folder for the URDF and its meshes; new or empty.")],
) -> int:
    """Convert a MuJoCo model to a URDF with meshes. A robot can be described from it."""
    from comove.cli.texts import in_rows
    from comove.io.folders import Contents, whole_folder
    from comove.sim.mjcf import MESHES, urdf_of

    found = urdf_of(model)
    with whole_folder(out, Contents("URDF with its meshes", error=RobotError)) as draft:
        (draft / f"{found.name}.urdf").write_text(found.urdf, encoding="utf-8")
        if found.srdf is not None:
            (draft / f"{found.name}.srdf").write_text(found.srdf, encoding="utf-8")
        if found.obstacles is not None:
            (draft / f"{found.name}-obstacles.yaml").write_text(found.obstacles, encoding="utf-8")
        (draft / MESHES).mkdir()
        for name, data in found.meshes.items():
            (draft / MESHES / name).write_bytes(data)
    say(f"{out / found.name}.urdf: to be checked:" if found.notes else f"{out / found.name}.urdf")
    for note in found.notes:
        say(f"  - {note}")
    if found.obstacles is not None:
        say(f"{out / found.name}-obstacles.yaml: floor and furniture, as obstacles of a scene")
    given = "" if found.obstacles is None else f" --obstacles {out / found.name}-obstacles.yaml"
    rows = [("next", f"comove robot new {out / found.name}.urdf{given} --out robot.yaml")]
    rows += [("then", f"comove robot scene robot.yaml{given}")]
    print(*in_rows(rows), sep="\n")
    return VERIFIED


@verb_of(group)
def new(
    urdfs: Annotated[
        list[str],
        typer.Argument(
            metavar="URDF...",
            help="Files, or package://NAME/...; several stand side by side, from left to right. The same twice "
            "is two robots of a kind.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Description to write (YAML); it must not be there yet.")] = Path(
        "robot.yaml"
    ),
    apart: Annotated[float, typer.Option(help="Distance between the bases of several models [m].")] = 0.8,
    obstacles: Obstacles = None,
    gripper: Annotated[
        str | None,
        typer.Option(
            metavar="URDF", help="Gripper for every arm without fingers: a file, or package://NAME/..."
        ),
    ] = None,
    srdf: Annotated[
        str | None,
        typer.Option(
            help="SRDF in place of one beside the URDF, as MoveIt has it; its groups name the arms."
        ),
    ] = None,
    home_state: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Group state of the SRDF that is home; searched unless given."),
    ] = None,
) -> int:
    """Propose a robot's description from its URDF; check and draw it. It holds arms, tools, home positions, and
    pairs of links that always touch."""
    from comove.io.files import require_target, whole_file
    from comove.robots.proposal import examine, propose

    if len(urdfs) > 4:
        raise OptionError(f"{len(urdfs)} models are given", key="URDF", way_out="give 1 to 4")
    if not 0 < apart < 100:
        raise OptionError(f"apart = {apart:g}", key="--apart", way_out="give metres above 0")
    _require_new(out)
    require_target(out, RobotError)
    around = None if obstacles is None else _around(obstacles)
    proposal = propose(
        urdfs, out, apart=apart, around=around, gripper=gripper, srdf=srdf, home_state=home_state
    )
    stems = [Path(urdf).stem for urdf in proposal.srdf]
    for k, (urdf, text) in enumerate(proposal.srdf.items()):
        again = f"-{k + 1}" * (stems.count(stems[k]) > 1)  # models of one name in several folders
        pairs = out.with_name(f"{out.stem}-{stems[k]}{again}.srdf")
        with whole_file(pairs, error=RobotError) as draft:
            draft.write(text.encode())
        for model in proposal.data["models"]:
            if model["urdf"] == urdf:
                model["srdf"] = pairs.name
    with whole_file(out, error=RobotError, replace=False) as draft:
        draft.write(proposal.text().encode())
    print(f"{out}: {len(proposal.robot.arms)} arm{'s' * (len(proposal.robot.arms) != 1)}; to be checked:")
    for note in proposal.notes:
        say(f"  - {note}")
    return _told(proposal.robot, examine(proposal.robot, around=around), out)


@verb_of(group)
def check(
    robot: Described,
    out: Annotated[
        Path | None, typer.Option(help="Picture to write (PNG); beside the description unless given.")
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(
            help="Scene (YAML) among whose obstacles it is at home, and whose load it has to be rated for; or such "
            "obstacles alone."
        ),
    ] = None,
) -> int:
    """Check and draw a robot's description. Print reach, shared workspace, and contacts at home."""
    from comove.robots import Robot, bundled_robots, find_description
    from comove.robots.proposal import examine
    from comove.robots.verification.bodies import warn_of_buried_links

    loaded = Robot.load(robot)
    around = None if scene is None else _around(scene)
    if around is not None:
        warn_of_buried_links(loaded, around)
    path = Path(loaded.name) if robot in bundled_robots() else find_description(robot)
    return _told(loaded, examine(loaded, around=around), path, out)


@verb_of(group)
def scene(
    robot: Described,
    out: Annotated[Path, typer.Option(help="Scene to write (YAML); it must not be there yet.")] = Path(
        "scene.yaml"
    ),
    obstacles: Obstacles = None,
    seed: o.Seed = 0,
) -> int:
    """Make and solve a first scene for a robot. Two end effectors lift a bar over a rail."""
    import os

    from comove.cli.texts import in_rows
    from comove.io.files import require_target, whole_file
    from comove.robots import Robot, bundled_robots, find_description
    from comove.robots.proposal import propose_scene

    _require_new(out)
    require_target(out, SceneError)
    loaded, named = Robot.load(robot), robot
    if robot not in bundled_robots():
        named = os.path.relpath(find_description(robot), out.absolute().parent)
    try:
        around = () if obstacles is None else _obstacles_in(obstacles, out)
        proposal = propose_scene(loaded, named, around=around, folder=out.absolute().parent, seed=seed)
    except RobotError as error:
        error.file = error.file or Path(robot)
        raise
    with whole_file(out, error=SceneError, replace=False) as draft:
        draft.write(proposal.text().encode())
    load, grasp, found = proposal.data["load"], proposal.data["grasp"], proposal.found
    hands = ", ".join(f"'{hand}' by {turn:g}" for hand, turn in grasp["offset_deg"].items())
    rows = [
        ("load", f"a bar, {load['length']:g} m long, {load['mass']:g} kg"),
        ("hands", f"{grasp['orientation']}, turned on it {hands} degrees"),
        *(
            (each["name"], f"from {each['start']} to {each['goal']} m")
            for each in proposal.data["manipulators"]
        ),
        ("solved", f"first verified motion after {found.effort.first_verified:.2g} s"),
        ("next", f"comove solve {out} --out carried"),
    ]
    if proposal.unreached:
        rows.append(
            ("without", f"approach and release, so export it with --no-transfers: {proposal.unreached}")
        )
    say(f"{out}: a scene for {loaded.name}")
    print(*in_rows(rows), sep="\n")
    return VERIFIED


def _around(file: Path) -> Scene:
    """Return a scene, or one of the obstacles in a file."""
    from comove.io.yaml_reader import read_yaml
    from comove.model import Scene
    from comove.robots.proposal import scene_of

    data, _ = read_yaml(file)
    if set(data) != {"obstacles"}:
        return Scene.load(file, check_ends=False)
    try:
        return scene_of(_listed(file), file.absolute().parent)
    except SceneError as error:
        error.file = error.file or file
        raise


def _listed(file: Path) -> list[dict[str, Any]]:
    """Return the obstacles in a file, which may be a scene."""
    from comove.io.yaml_reader import read_yaml

    found = read_yaml(file)[0].get("obstacles")
    if not isinstance(found, list) or not all(isinstance(x, dict) for x in found):
        raise SceneError(
            "it holds no list of obstacles", file=file, key="obstacles", way_out="write obstacles: [...]"
        )
    return found


def _obstacles_in(file: Path, scene: Path) -> list[dict[str, Any]]:
    """Return the obstacles of a file, with meshes relative to a scene."""
    import os

    found = _listed(file)
    beside, mesh = scene.absolute().parent, "file"
    return [
        entry | {mesh: os.path.relpath(file.absolute().parent / str(entry[mesh]), beside)}
        if mesh in entry
        else entry
        for entry in found
    ]


def _require_new(out: Path) -> None:
    if out.exists():
        raise OptionError(
            f"there is a file '{out}' already", key="--out", way_out="name another, or remove it"
        )


def _rated(arm: Arm) -> str:
    """Return an arm's rated payload in words; empty if unknown."""
    if arm.payload == float("inf"):
        return ""
    own = f", of which its hand takes {arm.hand:.3g} kg" if arm.hand else ""
    return f", rated for {arm.payload:g} kg{own}"


def _told(robot: Robot, found: Examination, file: Path, picture: Path | None = None) -> int:
    """Print and draw the findings; return the exit code."""
    import numpy as np

    from comove.cli.texts import in_rows
    from comove.view.figures import draw_robot, save

    say(f"{robot.name}: {'sound' if found.sound else 'NOT SOUND'}")
    rows = [
        (
            f"arm {arm.name}",
            f"{arm.n_joints} joints to '{arm.tip}', reach {arm.reach:.2f} m, at home "
            f"{np.rad2deg(arm.tilt):.0f} degrees from pointing down{_rated(robot.arm(arm.name))}",
        )
        for arm in found.arms
    ]
    rows += [
        (f"{a} and {b}", f"{share:.0%} of the places of the one's hand are in reach of the other's")
        for (a, b), share in found.shared.items()
    ]
    if np.isfinite(found.clearance):
        a, b = found.nearest
        rows.append(("at home", f"'{a}' and '{b}' are nearest: {1e3 * found.clearance:.0f} mm"))
        rows.append(("random joints", f"nothing touches in {found.free:.0%}"))
    rows += [("to be mended", fault) for fault in found.faults]
    rows += [("to be looked at", doubt) for doubt in found.doubts]
    picture = file.with_suffix(".png") if picture is None else picture
    save(draw_robot(robot, found), picture)
    rows.append(("picture", str(picture)))
    print(*in_rows(rows), sep="\n")
    return VERIFIED if found.sound else NOT_VERIFIED
