"""Rules of trajectory controllers: interpolation, refusals, replacement, tolerances and their error codes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from comove.ros.trajectory_control import (
    GOAL_TOLERANCE_VIOLATED,
    INVALID_GOAL,
    NANO,
    PATH_TOLERANCE_VIOLATED,
    ControlState,
    ControlTolerances,
    GoalTrajectory,
    TrajectoryController,
    TrajectoryGoal,
    Waypoint,
    goal_error,
    interpolated,
)

JOINTS = ("shoulder", "elbow")
PERIOD = NANO // 500
NOW = 1_700_000_000 * NANO
AT_REST = ControlState(np.zeros(2), np.zeros(2))
values = arrays(float, 2, elements=st.floats(-3.0, 3.0))
spans = st.floats(0.01, 10.0)
DEGREES = ["linear", "cubic", "quintic"]


def state(drawn, degree):
    """A state with the fields that a segment of a degree has."""
    fields = {"linear": 1, "cubic": 2, "quintic": 3}[degree]
    return ControlState(*drawn[:fields])


def goal(*times, joints=JOINTS, stamp=0, to=1.0, **more):
    """A goal that leads all joints to a position in equal steps, with velocities that are 0 at its end."""
    shares = np.arange(1, len(times) + 1) / max(len(times), 1)
    points = tuple(
        Waypoint(round(t * NANO), [share * to] * len(joints), [0.1 * (share < 1.0)] * len(joints))
        for t, share in zip(times, shares, strict=True)
    )
    return TrajectoryGoal("a goal", tuple(joints), stamp, points, **more)


def follow(controller, seconds, *, lag=0.0, begin=NOW, until_end=True):
    """Update a controller whose joints are behind its desired ones by a lag [rad]; return times and ends."""
    told, commands, now = [], [], begin
    present = ControlState(controller.desired.position - lag, np.zeros(2))
    while now < begin + round(seconds * NANO):
        command, ends = controller.update(now, present)
        told += [((now - begin) / NANO, end) for end in ends]
        commands.append(command.position.copy())
        if ends and until_end:
            break
        now += PERIOD
        present = ControlState(command.position - lag, np.zeros(2))
    return told, np.array(commands)


@pytest.mark.parametrize("degree", DEGREES)
@given(first=st.tuples(values, values, values), last=st.tuples(values, values, values), span=spans)
def test_interpolation_meets_both_points_in_all_their_fields(degree, first, last, span):
    begin, end = state(first, degree), state(last, degree)
    for at, point in ((0.0, begin), (span, end)):
        found = interpolated(begin, end, span, at)
        for got, wanted in zip(found, point, strict=True):
            if wanted is not None:
                scale = 1.0 + np.abs([*first, *last]).max() * max(1.0, 1.0 / span**2)
                np.testing.assert_allclose(got, wanted, atol=1e-9 * scale)


@pytest.mark.parametrize("degree", DEGREES)
@given(
    first=st.tuples(values, values, values),
    last=st.tuples(values, values, values),
    span=spans,
    share=st.floats(0.05, 0.95),
)
def test_velocity_and_acceleration_are_the_derivatives_of_position(degree, first, last, span, share):
    begin, end, step = state(first, degree), state(last, degree), 1e-4 * span
    before, at, after = (interpolated(begin, end, span, share * span + k * step) for k in (-1, 0, 1))
    scale = 1.0 + np.abs([*first, *last]).max() * (span + 1.0 / span) ** 2
    assert np.abs((after.position - before.position) / (2 * step) - at.velocity).max() < 1e-4 * scale
    assert np.abs((after.velocity - before.velocity) / (2 * step) - at.acceleration).max() < 1e-3 * scale


@given(
    coefficients=arrays(float, (4, 2), elements=st.floats(-2.0, 2.0)), span=spans, share=st.floats(0.0, 1.0)
)
def test_cubics_and_quintics_reproduce_cubics(coefficients, span, share):
    """A cubic is the only one through its ends, and the quintic through its ends is the cubic itself."""

    def exact(t):
        c0, c1, c2, c3 = coefficients
        return ControlState(
            c0 + c1 * t + c2 * t**2 + c3 * t**3, c1 + 2 * c2 * t + 3 * c3 * t**2, 2 * c2 + 6 * c3 * t
        )

    begin, end, at = exact(0.0), exact(span), exact(share * span)
    scale = 1.0 + np.abs(end.position).max()
    for degree in ("cubic", "quintic"):
        found = interpolated(state(begin, degree), state(end, degree), span, share * span)
        np.testing.assert_allclose(found.position, at.position, atol=1e-9 * scale)
        np.testing.assert_allclose(found.velocity, at.velocity, atol=1e-8 * scale / span)


@given(first=values, last=values, velocity=values, span=spans, share=st.floats(0.0, 1.0))
def test_a_field_that_one_point_lacks_is_not_used(first, last, velocity, span, share):
    bare, moving = ControlState(first), ControlState(last, velocity, velocity)
    both = interpolated(bare, moving, span, share * span)
    assert (both.position == interpolated(bare, ControlState(last), span, share * span).position).all()


@given(
    steps=st.lists(st.integers(NANO // 100, NANO), min_size=1, max_size=6),
    data=st.data(),
    degree=st.sampled_from(DEGREES),
    ahead=st.integers(0, NANO),
)
def test_a_trajectory_goes_through_all_its_points_without_leaps(steps, data, degree, ahead):
    times = np.cumsum(steps).tolist()
    drawn = [data.draw(st.tuples(values, values, values)) for _ in times]
    fields = {"linear": 1, "cubic": 2, "quintic": 3}[degree]
    points = tuple(
        Waypoint(time, *(x.tolist() for x in fields_of[:fields]))
        for time, fields_of in zip(times, drawn, strict=True)
    )
    begin = ControlState(data.draw(values), data.draw(values))
    trajectory = GoalTrajectory(TrajectoryGoal("a", JOINTS, NOW + ahead, points), JOINTS, NOW, begin)
    np.testing.assert_allclose(trajectory.at(NOW).position, begin.position, atol=1e-9)
    for time, (position, *_) in zip(times, drawn, strict=True):
        due = NOW + ahead + time
        np.testing.assert_allclose(trajectory.at(due).position, position, atol=1e-9)
        np.testing.assert_allclose(trajectory.at(due - 1).position, position, atol=1e-5)
    assert not trajectory.is_over(NOW + ahead + times[-1] - 1) and trajectory.is_over(NOW + ahead + times[-1])


def test_joints_are_taken_by_their_names():
    swapped = TrajectoryGoal("a", JOINTS[::-1], 0, (Waypoint(NANO, [1.0, 2.0]),))
    assert GoalTrajectory(swapped, JOINTS, NOW, AT_REST).at(NOW + NANO).position.tolist() == [2.0, 1.0]


def with_point(number, **changes):
    """A goal of three points, one of which is changed."""
    changed = list(goal(1.0, 2.0, 3.0).points)
    changed[number] = changed[number]._replace(**changes)
    return replace(goal(1.0), points=tuple(changed))


REFUSED = {
    "foreign": (goal(1.0, joints=("shoulder", "wrist")), "'wrist' is not one of the controller"),
    "missing": (goal(1.0, joints=("shoulder",)), "lacks elbow"),
    "double": (goal(1.0, joints=("shoulder", "elbow", "elbow")), "names elbow twice"),
    "no joints": (goal(1.0, joints=()), "names no joints"),
    "empty": (goal(), "trajectory is empty"),
    "equal times": (with_point(1, time=NANO), "times must rise: point 0 is at 1 s, the next one at 1 s"),
    "falling times": (with_point(2, time=NANO), "times must rise: point 1 is at 2 s, the next one at 1 s"),
    "moving end": (with_point(2, velocities=[0.0, 2e-7]), "velocity of 'elbow' at the last point is 2e-07"),
    "too few": (with_point(1, positions=[0.0]), "point 1 has 1 positions for 2 joints"),
    "no positions": (with_point(1, positions=[]), "point 1 has 0 positions"),
    "velocities": (with_point(0, velocities=[0.0] * 3), "point 0 has 3 velocities for 2 joints"),
    "accelerations": (with_point(0, accelerations=[0.0]), "point 0 has 1 accelerations for 2 joints"),
    "alone": (with_point(0, velocities=[], accelerations=[0.0] * 2), "accelerations without velocities"),
    "efforts": (with_point(0, effort=[1.0] * 2), "efforts, which controllers of positions do not take"),
    "not finite": (with_point(0, positions=[np.nan, 0.0]), "point 0 has positions that are not finite"),
    "past": (goal(1.0, 2.0, stamp=NOW - 3 * NANO), "it ended 1 s ago by its stamp"),
}


@pytest.mark.parametrize(("wrong", "reason"), REFUSED.values(), ids=REFUSED)
def test_goals_are_refused_with_a_reason(wrong, reason):
    assert reason in goal_error(wrong, JOINTS, NOW)


@pytest.mark.parametrize(
    "right",
    [
        goal(1.0),
        goal(0.0, 1.0),
        goal(1.0, 2.0, joints=JOINTS[::-1]),
        goal(1.0, 2.0, stamp=NOW - 2 * NANO),
        goal(1.0, stamp=NOW + NANO),
        with_point(2, velocities=[0.0, 1e-7]),
        with_point(1, velocities=[]),
    ],
)
def test_other_goals_are_accepted(right):
    assert not goal_error(right, JOINTS, NOW)


def test_a_moving_end_may_be_allowed():
    assert not goal_error(REFUSED["moving end"][0], JOINTS, NOW, moving_end=True)


def test_a_goal_without_a_stamp_begins_at_once_and_ends_when_its_last_point_is_due():
    controller = TrajectoryController(JOINTS, np.zeros(2), PERIOD)
    assert controller.accept(goal(0.5, 1.0), NOW, AT_REST) == []
    ((time, end),), commands = follow(controller, 2.0)
    assert time == pytest.approx(1.0, abs=PERIOD / NANO) and (end.status, end.code) == ("SUCCEEDED", 0)
    assert np.abs(np.diff(commands, axis=0)).max() < 0.01
    assert controller.desired.position.tolist() == [1.0, 1.0] and not controller.desired.velocity.any()


def test_a_goal_with_a_stamp_waits_for_its_points():
    controller = TrajectoryController(JOINTS, np.zeros(2), PERIOD)
    controller.accept(goal(0.0, 1.0, stamp=NOW + NANO // 2, to=0.0), NOW, AT_REST)
    ((time, _),), commands = follow(controller, 3.0)
    assert time == pytest.approx(1.5, abs=PERIOD / NANO)
    assert np.abs(commands[:200]).max() < 0.05


def test_a_new_goal_replaces_the_present_one_from_where_the_joints_are():
    controller = TrajectoryController(JOINTS, np.zeros(2), PERIOD)
    controller.accept(goal(1.0), NOW, AT_REST)
    follow(controller, 0.5)
    measured = ControlState(controller.desired.position - 0.01, np.zeros(2))
    begin = NOW + NANO // 2
    (replaced,) = controller.accept(replace(goal(1.0, to=0.2), number="new"), begin, measured)
    assert (replaced.number, replaced.status, replaced.code) == ("a goal", "ABORTED", INVALID_GOAL)
    command, ends = controller.update(begin, measured)
    assert not ends and np.abs(command.position - measured.position).max() < 1e-3
    ((time, end),), _ = follow(controller, 2.0, begin=begin)
    assert end.number == "new" and time == pytest.approx(1.0, abs=PERIOD / NANO)
    np.testing.assert_allclose(controller.desired.position, 0.2)


def test_a_cancelled_goal_leaves_the_joints_where_they_are():
    controller = TrajectoryController(JOINTS, np.zeros(2), PERIOD)
    controller.accept(goal(1.0), NOW, AT_REST)
    follow(controller, 0.5)
    measured = ControlState(controller.desired.position - 0.01, np.ones(2))
    assert controller.cancel("another goal", measured) == []
    (end,) = controller.cancel("a goal", measured)
    assert end.status == "CANCELED"
    told, commands = follow(controller, 0.5, begin=NOW + NANO)
    assert not told and (commands == measured.position).all()


LATE = {"late": 0.2}
ALLOWED = {"shoulder": (0.02, 0.0, 0.0), "elbow": (0.02, 0.0, 0.0)}


def ended(lag, own=None, seconds=3.0, **tolerances):
    """How a goal of a second ends whose joints lag behind; None if it has not ended in time."""
    controller = TrajectoryController(JOINTS, np.zeros(2), PERIOD, tolerances=own)
    wanted = goal(0.5, 1.0, **tolerances)
    controller.accept(wanted, NOW, ControlState(np.full(2, -lag), np.zeros(2)))
    told, commands = follow(controller, seconds, lag=lag)
    return (told[0][0], told[0][1].code, controller, commands) if told else None


def test_a_joint_off_the_path_aborts_the_goal_and_holds():
    time, code, controller, _ = ended(0.05, path=ALLOWED)
    assert code == PATH_TOLERANCE_VIOLATED and time < 0.9
    held = controller.update(NOW + NANO, AT_REST)[0].position
    assert (held < 0.96).all() and (controller.update(NOW + 2 * NANO, AT_REST)[0].position == held).all()


def test_a_joint_off_the_goal_aborts_it_after_the_goal_time():
    time, code, _, _ = ended(0.05, end=ALLOWED, late=0.2)
    assert code == GOAL_TOLERANCE_VIOLATED and time == pytest.approx(1.2, abs=2 * PERIOD / NANO)


def test_without_a_goal_time_the_controller_waits_for_ever():
    assert ended(0.05, end=ALLOWED, seconds=20.0) is None


@pytest.mark.parametrize("tolerances", [{}, {"path": ALLOWED}, {"end": ALLOWED, "late": 0.2}])
def test_joints_within_their_tolerances_reach_the_goal(tolerances):
    time, code, _, _ = ended(0.019, **tolerances)
    assert code == 0 and time == pytest.approx(1.0, abs=2 * PERIOD / NANO)


def test_without_tolerances_a_goal_ends_anywhere():
    assert ended(0.5)[1] == 0


OWN = ControlTolerances(np.full(2, 0.02), np.full(2, 0.02), 0.2)
ERASED = {"shoulder": (-1.0, 0.0, 0.0), "elbow": (-1.0, 0.0, 0.0)}
ONE = {"shoulder": (0.1, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("tolerances", "code"),
    [
        ({}, PATH_TOLERANCE_VIOLATED),
        ({"path": {"shoulder": (0.0, 0.0, 0.0)}}, PATH_TOLERANCE_VIOLATED),
        ({"path": ERASED}, GOAL_TOLERANCE_VIOLATED),
        ({"path": ERASED, "end": ERASED}, 0),
        ({"path": ONE, "end": ERASED}, PATH_TOLERANCE_VIOLATED),
        ({"path": {**ONE, "elbow": (0.1, 0.0, 0.0)}, "end": ERASED}, 0),
        ({"path": {**ERASED, "wrist": (0.1, 0.0, 0.0)}, "end": ERASED}, PATH_TOLERANCE_VIOLATED),
        ({"path": {**ERASED, "elbow": (-1.0, -2.0, 0.0)}, "end": ERASED}, PATH_TOLERANCE_VIOLATED),
        ({"path": ERASED, "late": -3.0}, PATH_TOLERANCE_VIOLATED),
    ],
)
def test_a_goal_changes_the_controllers_own_tolerances(tolerances, code):
    """0 leaves one as it is, -1 erases it; one that makes no sense leaves all of them."""
    assert ended(0.05, OWN, **tolerances)[1] == code


@given(lag=st.floats(0.0, 0.1), path=st.floats(0.001, 0.1), end=st.floats(0.001, 0.1))
def test_the_code_tells_which_tolerance_is_violated(lag, path, end):
    """The lag is the error at all times."""
    allowed = {
        kind: {name: (most, 0.0, 0.0) for name in JOINTS} for kind, most in (("path", path), ("end", end))
    }
    controller = TrajectoryController(JOINTS, np.zeros(2), NANO // 50)
    controller.accept(
        replace(goal(0.2, to=0.1), late=0.1, **allowed), NOW, ControlState(np.full(2, -lag), np.zeros(2))
    )
    now, ends = NOW, []
    while not ends:
        desired = controller._trajectory.at(now)
        _, ends = controller.update(now, ControlState(desired.position - lag, np.zeros(2)))
        now += controller.period
    wanted = (
        PATH_TOLERANCE_VIOLATED if lag > path + 1e-9 else GOAL_TOLERANCE_VIOLATED if lag > end + 1e-9 else 0
    )
    if min(abs(lag - path), abs(lag - end)) > 1e-6:
        assert ends[0].code == wanted
