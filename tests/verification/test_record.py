"""The judge of executions finds what went wrong, between the steps too."""

from dataclasses import replace

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.model import Scene
from comove.verification.record import Record, RecordSamples, verify_execution

PERIOD, DURATION = 0.01, 2.0


def scene(*obstacles, **limits):
    hands = [{"name": n, "start": [0.2, y], "goal": [0.8, y]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "judged",
            "duration": DURATION,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "obstacles": list(obstacles),
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
            "limits": limits,
        }
    )


def record(around, turn=0.0):
    """From start to goal on a minimum-jerk straight line, with a turn and back on the way."""
    time = np.arange(round(DURATION / PERIOD) + 2) * PERIOD
    s = np.minimum(time / DURATION, 1.0)
    share = s**3 * (10 - 15 * s + 6 * s**2)
    center = np.zeros((len(time), 1, 3))
    center[:, 0, 0], center[:, 0, 1] = 0.2 + 0.6 * share, 0.5
    angle = np.pi / 2 + 0 * s + turn * np.sin(np.pi * share) ** 2
    own = np.arctan2(*(around.groups[0].start.rotation[[1, 0], 0]))
    angle = angle - np.pi / 2 + own
    quaternion = np.zeros((len(time), 1, 4))
    quaternion[:, 0, 0], quaternion[:, 0, 3] = np.cos(angle / 2), np.sin(angle / 2)
    obstacles = around.obstacles[:, 1:4] + around.offsets(time)
    return Record(around, time, center, quaternion, obstacles, around.obstacle_sagittas(time))


def test_what_is_as_it_should_be():
    report = verify_execution(record(scene(speed=1.0, acceleration=2.0), turn=0.5))
    assert report.reasons == ()
    assert report.end_error == pytest.approx(0.0, abs=1e-12)
    assert report.distance_error_max < 1e-12


def test_speeds_and_accelerations_are_those_of_minimum_jerk():
    """Flash and Hogan, 1985: 1.875 d/T and 5.77 d/T^2."""
    report = verify_execution(record(scene()))
    assert report.speed_max == pytest.approx(1.875 * 0.6 / DURATION, rel=1e-3)
    assert report.acceleration_max == pytest.approx(10 / np.sqrt(3) * 0.6 / DURATION**2, rel=1e-2)


def test_limits():
    (reason,) = verify_execution(record(scene(speed=0.5))).reasons
    assert "moves at 0.56" in reason
    (reason,) = verify_execution(record(scene(acceleration=0.8))).reasons
    assert "accelerates by 0.8" in reason


def test_a_contact_between_two_steps_is_found():
    """A disc that crosses the bar's way at 40 m/s, between two instants at which it is on either side."""
    shot = {"waypoints": [[0.5, 1.2], [0.5, 1.2], [0.5, 0.8], [0.5, 0.8]], "times": [0, 0.995, 1.005, 2]}
    away = {"shape": "circle", "center": [0.5, 1.2], "radius": 0.05, "motion": shot}
    assert verify_execution(record(scene(away))).reasons == ()
    shot = {**shot, "waypoints": [[0.5, 1.2], [0.5, 1.2], [0.5, -0.2], [0.5, -0.2]]}
    (reason,) = verify_execution(record(scene({**away, "motion": shot}))).reasons
    assert "obstacles[0] (sphere) at 0.99 s" in reason or "obstacles[0] (sphere) at 1.00 s" in reason


@pytest.mark.parametrize(("reach", "touches"), [(0.41, True), (0.38, False)])
def test_a_contact_of_a_beam_that_turns_between_two_steps_is_found(reach, touches):
    """A beam turns by 36 degrees a step, so that its tip is nearest to the bar's way between two of them only."""
    turn = {"rate_deg_per_s": 3600, "hinge": [0.0, 0.0]}
    beam = {"shape": "box", "center": [0.5, 1.0], "size": [2 * reach, 0.002], "motion": {"turn": turn}}
    executed = record(scene(beam))
    sampled = executed.scene.clearances(executed.nodes, executed.time)
    assert sampled.min() > 2e-3
    reasons = verify_execution(executed).reasons
    assert len(reasons) == touches and all("into obstacles[0] (box)" in reason for reason in reasons)


def test_clearance_that_is_asked_for():
    wall = {"shape": "box", "center": [0.5, 0.9], "size": [0.2, 0.5]}  # 5 cm above the upper hand
    assert verify_execution(record(scene(wall, clearance=0.04))).reasons == ()
    (reason,) = verify_execution(record(scene({**wall, "center": [0.5, 0.88]}, clearance=0.04))).reasons
    assert "0.04 m of clearance are asked for" in reason
    assert verify_execution(
        record(scene({**wall, "center": [0.5, 0.88]}, clearance=0.02))
    ).clearance_min == pytest.approx(0.03, abs=2e-4)


def test_a_goal_that_is_missed_names_what_was_in_the_way():
    done = record(scene())
    short = replace(
        done,
        **{k: getattr(done, k)[:150] for k in ("time", "center", "quaternion", "obstacles")},
        sagitta=done.sagitta[:149],
    )
    first, second = verify_execution(short, "the door is closed").reasons
    assert first.startswith("the goal is missed by")
    assert first.endswith("the door is closed")
    assert "still moves" in second


def test_a_record_that_begins_elsewhere():
    done = record(scene())
    first, *_ = verify_execution(replace(done, center=done.center - [0.01, 0.0, 0.0])).reasons
    assert first == "it begins 0.01 m from the start"


def test_obstacles_of_which_nobody_knows_where_they_were():
    done = record(scene({"shape": "circle", "center": [0.5, 0.1], "radius": 0.05}))
    (reason,) = verify_execution(replace(done, obstacles=np.full_like(done.obstacles, np.nan))).reasons
    assert reason == "nobody knows where obstacles[0] (sphere) really was: contact cannot be ruled out"


def test_a_load_that_must_stay_upright():
    around = scene()
    upright = Scene.from_dict(
        {**around.file.model_dump(exclude_none=True), "constraints": [{"type": "upright"}]}
    )
    assert verify_execution(record(upright)).reasons == ()
    tilted = verify_execution(record(upright, turn=0.3))
    assert tilted.tilt_max == pytest.approx(0.3, abs=0.01)
    assert any("tilts by up to 17" in reason for reason in tilted.reasons)


def apart(*gaps):
    """Two free hands, one of which goes straight past the other in one long step; gaps from it at the steps."""
    hands = [
        {"name": "a", "start": [0.5, 0.2], "goal": [0.5, 0.2]},
        {"name": "b", "start": [0.2, 0.4], "goal": [0.8, 0.4]},
    ]
    around = Scene.from_dict(
        {
            "name": "apart",
            "duration": 1.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "manipulators": hands,
            "constraints": [{"type": "separation", "between": ["a", "b"], "distance": 0.25}],
        }
    )
    time = np.arange(len(gaps)) * 0.5
    center = np.tile([[0.5, 0.2, 0.0], [0.0, 0.4, 0.0]], (len(gaps), 1, 1))
    center[:, 1, 0] = 0.5 + np.array(gaps)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (len(gaps), 2, 1))
    return Record(around, time, center, quaternion, np.zeros((len(gaps), 0, 3)), np.zeros((len(gaps) - 1, 0)))


def test_hands_that_come_too_near_between_two_steps():
    """0.2 m are between them when they pass, and 0.36 m before and after."""
    report = verify_execution(apart(-0.3, 0.3, 0.3))
    assert report.separation_spare_min == pytest.approx(0.2 - 0.25, abs=1e-9)
    assert any("'a' and 'b' come as near as 0.2 m" in reason for reason in report.reasons)


def test_poses_that_are_no_numbers():
    done = record(scene({"shape": "circle", "center": [0.5, 0.1], "radius": 0.05}))
    center = done.center.copy()
    center[7] = np.nan
    assert verify_execution(replace(done, center=center)).reasons


def samples(around, hands=None, n_steps=201):
    """Hands of the same straight line, or those given."""
    time = np.linspace(0.0, DURATION, n_steps)
    s = time / DURATION
    share = (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None]
    straight = around.start + share * (around.goal - around.start)
    return RecordSamples(around, time, straight if hands is None else hands(straight))


def test_samples_of_a_straight_line_are_as_they_should_be():
    report = verify_execution(samples(scene(speed=1.0, acceleration=2.0)))
    assert report.reasons == ()
    assert report.clearance_min == pytest.approx(0.2, abs=1e-4)  # of the hands from the border


def test_samples_of_a_solved_motion_are_accepted():
    wall = [{"shape": "box", "center": [0.5, y], "size": [0.1, 0.44]} for y in (0.22, 0.78)]
    solution = comove.solve(scene(*wall, speed=1.0), seed=0)
    s = np.linspace(0.0, 1.0, 2001)
    report = verify_execution(
        RecordSamples(solution.attempt.scene, s * DURATION, solution.attempt.hands(s)[0])
    )
    assert report.reasons == ()
    assert report.clearance_min == pytest.approx(solution.report.clearance_min, abs=1e-3)


def test_hands_pulled_apart_in_one_sample_are_found():
    def pulled(hands):
        hands[100, 1] += [0.0, 0.003]
        return hands

    report = verify_execution(samples(scene(), pulled))
    assert report.distance_error_max == pytest.approx(0.003, rel=1e-6)
    assert any("distance between 'a' and 'b' is off by up to 0.003 m" in reason for reason in report.reasons)


def test_hands_that_turn_between_two_samples_come_nearer_on_their_chords():
    """A bar that turns by 0.2 rad in one step is 0.2 m long at both ends of it, and cos(0.1) of that between."""

    def turned(hands):
        middle, along = hands.mean(axis=1, keepdims=True), np.array([[-0.1], [0.1]])
        angle = np.pi / 2 + np.where(np.arange(len(hands)) >= 100, 0.2, 0.0)
        return middle + along * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]

    assert verify_execution(samples(scene(), turned)).distance_error_max == pytest.approx(
        0.2 * (1 - np.cos(0.1)), rel=1e-3
    )


def test_a_thin_wall_between_two_samples_is_found():
    """1 mm thick, in steps of up to 11 mm; samples alone see nothing of it."""
    around = scene({"shape": "box", "center": [0.5037, 0.5], "size": [0.001, 0.05]})
    found = samples(around, n_steps=101)
    assert min(around.clearance_at(nodes)[0] for nodes in found.nodes) > 0.0
    (reason,) = verify_execution(found).reasons
    assert "obstacles[0] (box)" in reason


def test_loads_that_hands_do_not_tell_are_refused_in_words():
    around = scene()
    data = {**around.file.model_dump(exclude_none=True), "load": {"shape": "box", "size": [0.2, 0.02]}}
    with pytest.raises(OptionError, match="hands do not tell how this load is turned; take a bar or a frame"):
        samples(Scene.from_dict(data))


@pytest.mark.parametrize("shape", [(201, 2, 3), (201, 1, 2), (200, 2, 2), (201, 4)])
def test_samples_of_the_wrong_shape_are_refused(shape):
    with pytest.raises(OptionError, match="give 2 hands in 2 dimensions at every time"):
        samples(scene(), lambda hands: np.zeros(shape))


def test_two_samples_are_too_few():
    with pytest.raises(OptionError, match="3 or more"):
        samples(scene(), n_steps=2)


def test_what_turns_back_between_two_steps_is_seen_as_far_as_it_comes():
    """A disc comes within 0.3 mm of the upper hand's way and turns at once, between two steps."""
    near, half = 0.0003, 1.008  # m, s
    touching = record(scene(), turn=0.0).nodes[:, :2, :]
    top = float(touching[round(half / PERIOD), :, 1].max())
    x = float(touching[round(half / PERIOD), :, 0].mean())
    radius, far = 0.05, 0.4
    centers = [[x, top + radius + near + far], [x, top + radius + near], [x, top + radius + near + far]]
    ball = {"shape": "circle", "center": centers[0], "radius": radius}
    ball["motion"] = {"waypoints": centers, "times": [0, half, 2 * half]}
    report = verify_execution(record(scene(ball)))
    assert near - 2e-4 <= report.clearance_min <= near + 1e-4
