"""Verdicts follow from the numbers: what is broken in the runs is broken in the verdicts."""

from dataclasses import replace

import pytest

from comove.lab.paper import claims
from comove.lab.paper.claims import CLAIMS, ClaimVerdict, judge_all
from tests.lab.paper.ideal import carried, changed, ideal_runs, led, met

GOOD, REMARK, NOT, BUILT_IN = (
    ClaimVerdict.REPRODUCED,
    ClaimVerdict.REMARK,
    ClaimVerdict.NOT,
    ClaimVerdict.BUILT_IN,
)
FIG4 = {"scene": "narrow", "who": "paper"}
PAPER = {"who": "paper"}


@pytest.fixture(scope="module")
def ideal():
    return ideal_runs()


def test_where_all_goes_well_nothing_is_rejected_but_what_contradicts_itself(ideal):
    found = {claim.judge: finding.verdict for claim, finding in judge_all(ideal)}
    rejected = {judge for judge, verdict in found.items() if verdict is NOT}
    # No jumps where the objective falls steadily, no deformation where modulation is exact.
    assert rejected == {claims.jumps, claims.does_not_enforce}


def test_where_nothing_is_verified_no_result_is_reproduced(ideal):
    broken = ideal
    for purpose in {outcome.job.purpose for outcome in ideal.outcomes}:
        along = {"at_end": 0.5, "error": 0.1} if purpose == "figure 4" else None
        broken = changed(
            broken,
            purpose,
            along=along,
            **{"verified": False, "distance_error": 0.2, "clearance": -0.1, "turn": 0.0, "jerk": 1.0},
        )
    for method in (claims.NEAREST, "same matrix on all", "obstacles seen only"):
        broken = met(broken, method, clearance=-0.1, distance_error=0.2)
    broken = carried(broken, {}, verified=False, delivered=False, lag=None, end_error=None)
    for claim, finding in judge_all(broken):
        if claim.judge not in (claims.does_not_enforce, claims.roles_matter):
            assert finding.verdict in (NOT, ClaimVerdict.UNTESTED), claim.quote


@pytest.mark.parametrize(
    ("judge", "purpose", "asked", "changes", "along", "before", "after"),
    [
        (claims.built_from_one, "figure 4", {"who": "comove"}, {"verified": False}, None, GOOD, NOT),
        (
            claims.verifies_all_constraints,
            "printed",
            {"who": "printed"},
            {"verified": False},
            None,
            GOOD,
            NOT,
        ),
        (
            *(claims.verifies_all_constraints, "printed", {"who": "paper without schedules"}),
            *({"verified": False}, None, GOOD, GOOD),
        ),
        (claims.other_environment, "figure 4", FIG4, {"verified": False}, None, GOOD, REMARK),
        (claims.other_environment, "figure 4", {}, {"verified": False}, None, GOOD, NOT),
        (claims.one_phase, "given", {}, {"distance_error": 1e-6}, None, BUILT_IN, NOT),
        (claims.obstacles_either_way, "obstacles in the cost", {}, {"verified": False}, None, GOOD, REMARK),
        (claims.obstacles_either_way, "systems", {"who": "comove"}, {"verified": False}, None, GOOD, NOT),
        (claims.combined, "figure 3", {"scene": "complex"}, {"verified": False}, None, GOOD, NOT),
        (claims.combined, "straight", {"scene": "complex"}, {"verified": True}, None, GOOD, REMARK),
        (claims.navigates, "figure 3", {"scene": "wide"}, {"verified": False}, None, GOOD, NOT),
        (claims.more_than_two, "three hands", PAPER, {"verified": False}, None, GOOD, REMARK),
        (claims.more_than_two, "three hands", {}, {"verified": False}, None, GOOD, NOT),
        (claims.figure_4a, "story", {**PAPER, "scene": "wide"}, {"verified": False}, None, GOOD, REMARK),
        (claims.figure_4a, "story", {"scene": "wide"}, {"verified": False}, None, GOOD, NOT),
        (claims.adapts_while_ensured, "story", {"seed": 0, **FIG4}, {"verified": False}, None, GOOD, REMARK),
        (claims.less_smooth, "figure 4", FIG4, {"jerk": 11.0}, None, GOOD, REMARK),
        (claims.approaches, "figure 4", FIG4, {}, {"rise": 0.1}, GOOD, REMARK),
        (claims.approaches, "figure 4", FIG4, {}, {"at_end": 0.1}, GOOD, NOT),
        (claims.jumps, "figure 4", FIG4, {}, {"rise": 0.1, "rise_near": True}, NOT, REMARK),
        (claims.jumps, "figure 4", FIG4, {}, {"rise": 0.1, "rise_near": False}, NOT, NOT),
        (claims.small_violations, "figure 4", FIG4, {}, {"error_far": 1e-3}, GOOD, NOT),
        (claims.small_violations, "figure 4", FIG4, {}, {"error": 0.01}, GOOD, NOT),
        (
            claims.violated_without,
            "figure 6",
            {"scene": "narrow"},
            {"distance_error": 0.001},
            None,
            GOOD,
            NOT,
        ),
        (claims.violated_without, "joint", {}, {"verified": False}, None, GOOD, NOT),
        (claims.violated_without, "as taught", {}, {"verified": False}, None, GOOD, NOT),
        (claims.violated_without, "at once", {"scene": "narrow"}, {"distance_error": 0.001}, None, GOOD, NOT),
        (
            claims.leader_is_blind,
            "systems",
            {"who": "leader-follower [7]"},
            {"clearance": 0.01},
            None,
            BUILT_IN,
            NOT,
        ),
        (claims.leader_is_blind, "systems", {"who": "comove"}, {"verified": False}, None, BUILT_IN, NOT),
        (claims.almost_unchanged, "figure 4", FIG4, {"turn": 0.5}, None, REMARK, NOT),
        (claims.increasing_difficulty, "story", PAPER, {"verified": False}, None, GOOD, NOT),
        (claims.novel_scenarios, "movements", PAPER, {"verified": False}, None, GOOD, REMARK),
        (claims.novel_scenarios, "recordings", {"scene": "complex"}, {"verified": False}, None, GOOD, REMARK),
        (claims.novel_scenarios, "movements", {}, {"verified": False}, None, GOOD, NOT),
        (claims.more_than_two, "recordings", {"scene": "triangle"}, {"verified": False}, None, GOOD, REMARK),
        (claims.figure_6c, "recordings", {"scene": "complex"}, {"verified": False}, None, GOOD, REMARK),
        (claims.figure_6c, "recordings", {"scene": "wide"}, {"verified": False}, None, GOOD, GOOD),
        (claims.figure_6c, "story", {**PAPER, "scene": "complex"}, {"verified": False}, None, GOOD, REMARK),
        (claims.figure_6c, "story", {"scene": "complex"}, {"verified": False}, None, GOOD, NOT),
    ],
)
def test_a_verdict_turns_with_its_numbers(ideal, judge, purpose, asked, changes, along, before, after):
    assert judge(ideal).verdict is before
    assert judge(changed(ideal, purpose, asked, along, **changes)).verdict is after


@pytest.mark.parametrize(
    ("judge", "method", "changes", "before", "after"),
    [
        (claims.same_matrix, claims.NEAREST, {"distance_error": 0.01}, GOOD, REMARK),
        (claims.same_matrix, claims.NEAREST, {"clearance": -0.01}, GOOD, NOT),
        (claims.same_matrix, "same matrix on all", {"clearance": -0.01}, GOOD, GOOD),
        (claims.does_not_enforce, claims.NEAREST, {"distance_error": 0.01}, NOT, NOT),
        (claims.can_be_enforced, "obstacles seen only", {"arrived": False}, REMARK, NOT),
    ],
)
def test_verdicts_on_moving_obstacles(ideal, judge, method, changes, before, after):
    assert judge(ideal).verdict is before
    assert judge(met(ideal, method, **changes)).verdict is after


@pytest.mark.parametrize(
    ("judge", "asked", "changes", "before", "after"),
    [
        (claims.completes, {"who": "paper", "scene": "wide"}, {"delivered": False}, GOOD, REMARK),
        (claims.completes, {"scene": "narrow"}, {"verified": False}, GOOD, NOT),
        (claims.simulated_baxter, {"who": "paper"}, {"delivered": False}, REMARK, NOT),
        (claims.simulated_baxter, {"who": "comove"}, {"delivered": False}, REMARK, REMARK),
        (claims.almost_unchanged, {"scene": "wide"}, {"turn": 0.9}, REMARK, NOT),
    ],
)
def test_verdicts_on_the_robot(ideal, judge, asked, changes, before, after):
    assert judge(ideal).verdict is before
    assert judge(carried(ideal, asked, **changes)).verdict is after


def test_without_models_and_simulator_the_robot_is_not_tested(ideal):
    without = replace(ideal, transports=(), absent="a simulation needs more than the core")
    for judge in (claims.completes, claims.simulated_baxter):
        assert judge(without).verdict is ClaimVerdict.UNTESTED
    assert claims.almost_unchanged(without).verdict is REMARK  # in the plane


@pytest.mark.parametrize(("height", "verdict"), [(0.1, GOOD), (0.02, GOOD), (0.001, NOT)])
def test_roles_matter_where_hands_go_another_way(ideal, height, verdict):
    assert claims.roles_matter(led(ideal, "right hand leads", height)).verdict is verdict


def test_the_question_of_deformation_is_about_both_rules(ideal):
    both = met(met(ideal, claims.NEAREST, distance_error=0.01), "same matrix on all", distance_error=0.01)
    assert claims.does_not_enforce(both).verdict is GOOD


def test_every_verdict_has_its_rule(ideal):
    for claim, finding in judge_all(ideal):
        assert claim.rule.split(":")[0] in (
            "reproduced",
            "remark",
            "by construction",
            "the paper's rule",
        ) or (finding.verdict is ClaimVerdict.UNTESTED)


def test_every_finding_says_why_with_numbers(ideal):
    for claim, finding in judge_all(ideal):
        assert finding.why.endswith("."), claim.quote
        assert finding.verdict is ClaimVerdict.UNTESTED or any(c.isdigit() for c in finding.why)
    assert len({claim.quote for claim in CLAIMS}) == len(CLAIMS) >= 20
    assert {claim.where.split("-")[0].split(",")[0] for claim in CLAIMS} >= {"Abstract", "III", "IV", "V"}
