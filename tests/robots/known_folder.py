"""A result folder of the known movement of Baxter, in milliseconds and without a search."""

from comove.io.folders import whole_folder
from comove.planning.objective import Cost
from comove.planning.solution import Solution
from comove.results import RESULT, write_solution
from comove.robots import verify_joints
from comove.robots.files import write_joints
from comove.verification.verify import verify
from tests.robots.known_carry import baxter, known_carry


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
        evaluations=1,
        generations=0,
        time_to_first_verified_s=0.1,
        solve_time_s=0.2,
    )


def write(folder, motion=None, joints=None):
    """A result folder of the known movement, or of another one."""
    known_motion, known = known_carry()
    motion, joints = motion or known_motion, joints or known
    verdict = verify_joints(baxter(), motion, joints)
    with whole_folder(folder, RESULT) as draft:
        write_solution(solution_of(motion), draft, wall_time_s=1.0)
        write_joints(draft, joints, verdict, baxter(), motion)
    return folder
