"""A result folder of the known movement of Baxter, in milliseconds and without a search."""

from comove.io.folders import whole_folder
from comove.planning.objective import Cost
from comove.planning.solution import SearchEffort, Solution
from comove.results import RESULT, write_solution
from comove.robots import Robot, verify_joints
from comove.robots.description import BUNDLED
from comove.robots.files import write_joints
from comove.verification.verify import verify
from tests.robots.known_carry import baxter, known_carry, on_scene


def solution_of(motion):
    verdict = verify(motion)
    return Solution(
        scene=motion.scene,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons,
        cost=Cost(0.0, 1.0, 0.0, 0.0),
        method="comove",
        seed=0,
        effort=SearchEffort(1, 0, 0.2, 0.0, 0.1),
    )


def write(folder, motion=None, joints=None, robot=None, source=None):
    """A result folder of the known movement, or of another one."""
    known_motion, known = known_carry()
    motion, joints, robot = motion or known_motion, joints or known, robot or baxter()
    verdict = verify_joints(robot, motion, joints)
    with whole_folder(folder, RESULT) as draft:
        write_solution(solution_of(motion), draft, wall_time_s=1.0)
        write_joints(draft, joints, verdict, robot, motion, source=source)
    return folder


def write_forged(folder, scene=None):
    """A folder that says verified of joints far too fast for Baxter, which a description of its own choice allows.

    The forger has written all checksums and measures by that description. Its scene still names Baxter.
    """
    description = folder.parent / "faster.yaml"
    limits = [
        f"  {name}: {{velocity: 200, effort: 5000}}" for name in baxter().joint_names if "finger" not in name
    ]
    text = (BUNDLED / "baxter.yaml").read_text(encoding="utf-8")
    text = text.replace("acceleration: 5.0", "acceleration: 5000.0")
    description.write_text("\n".join([text, "limits:", *limits, ""]), encoding="utf-8")
    motion, joints = known_carry(3.0)
    motion = motion if scene is None else on_scene(motion, scene)
    return write(folder, motion, joints, Robot.load(description), description)
