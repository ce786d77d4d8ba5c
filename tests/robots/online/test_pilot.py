"""The roadmap, references and the pilot: ways hold the load and keep clear, by Pinocchio and the search's links."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from comove.control.safety.qp_workspace import Sighting
from comove.geometry.distances import CENTER
from comove.model import Scene
from comove.model.coordinates import load_coordinates
from comove.planning.configurations import span
from comove.robots.carrying import RobotCarrier
from comove.robots.online.course_finder import CourseFinder, FinderSettings
from comove.robots.online.courses import CourseSettings
from comove.robots.online.link_rows import LinkNeeds, clearances_along
from comove.robots.online.pilot import Pilot, PilotSettings
from comove.robots.online.reference import MotionReference, Stop
from comove.robots.online.roadmap import RoadmapSettings, Way, nearby, nearest
from tests.robots.known_carry import TABLE, scene_data
from tests.robots.small_robots import robot

FINDER = FinderSettings(roadmap=RoadmapSettings(n_nodes=40), courses=CourseSettings(n_slots=60))
SETTINGS = PilotSettings(finder=FINDER)


@lru_cache(maxsize=1)
def stands():
    """A pilot that stands at the start of the known carry, and its carrier; for tests that ask it nothing."""
    return at_start()


def at_start():
    """A pilot of one's own that stands at the start of the known carry, and its carrier."""
    scene = Scene.from_dict(scene_data(obstacles=(TABLE,)))
    carrier, coordinates = RobotCarrier(robot("baxter"), scene), load_coordinates(scene)
    q = np.concatenate([starts[0] for starts in carrier.starts])
    here = Way(coordinates.boundary()[:1], q[None])
    full = scene.clearance
    needs = LinkNeeds(np.full(len(scene.obstacles), 0.5 * full), 0.0, 0.0, 0.3)
    plan = MotionReference.standing(here)
    finder = CourseFinder(scene, carrier.arms, coordinates, plan, needs, seed=1, settings=FINDER)
    return Pilot(finder, SETTINGS), carrier


def nothing():
    """A sighting of nothing that moves."""
    return ball([0.0, 0.0, 5.0], [0.0, 0.0, 0.0])


def ball(center, velocity):
    """A sighting of a ball."""
    data = scene_data(obstacles=({"shape": "sphere", "center": list(center), "radius": 0.08},))
    return Sighting.still(Scene.from_dict(data))._replace(velocity=np.array([velocity]))


def test_ways_hold_the_load_and_keep_clear_of_what_stands():
    pilot, carrier = stands()
    roadmap, scene = pilot.finder.growth.roadmap, carrier.scene
    assert len(roadmap.nodes) > 20
    nodes = pilot.finder.coordinates.nodes(roadmap.configurations.T[None])[0]
    turns = scene.grasp.hand_rotations(nodes[:, :2])
    for k in range(0, len(nodes), 7):
        whole = carrier.robot.home
        whole[np.concatenate([arm.columns for arm in carrier.holders])] = roadmap.joints[k]
        for i, arm in enumerate(carrier.holders):
            pose = carrier.robot.tool_pose(whole, arm)
            np.testing.assert_allclose(pose[:3, 3], nodes[k, i], atol=0.02)  # where redundant joints turn
            np.testing.assert_allclose(pose[:3, :3], turns[k, i], atol=0.1)
        assert scene.clearance_at(nodes[k])[0] >= scene.clearance - 1e-3
    at = roadmap.nodes
    joints, placed = np.ascontiguousarray(roadmap.joints[at]), np.ascontiguousarray(nodes[at])
    keep, *others = clearances_along(
        pilot.finder.ground.arms, joints, placed, scene.obstacles, scene.clearance
    )
    assert (keep >= pilot.finder.ground.needs.obstacle - 1e-9).all()
    assert min(others) >= -1e-9


def test_a_way_is_gone_in_both_directions_slot_by_slot():
    pilot, _ = stands()
    roadmap, half = pilot.finder.growth.roadmap, len(pilot.finder.growth.roadmap.source) // 2
    most = pilot.finder.ground.most * (1 + FINDER.roadmap.turning) + 1e-9
    for e in range(0, half, 5):
        there = _samples(roadmap, e)
        np.testing.assert_array_equal(there, _samples(roadmap, e + half)[::-1])
        assert len(there) == roadmap.slots[e] + 1
        assert (np.abs(np.diff(roadmap.joints[there], axis=0)) <= most).all()


def _samples(roadmap, e):
    inside = roadmap.begin[e] + roadmap.stride[e] * np.arange(roadmap.slots[e] - 1)
    return np.concatenate([roadmap.nodes[roadmap.source[[e]]], inside, roadmap.nodes[roadmap.target[[e]]]])


def test_the_nearest_configurations_are_chosen_but_not_two_at_one_place():
    pilot, _ = stands()
    space, there = pilot.finder.ground.space, pilot.finder.growth.roadmap.configurations
    for q in there[::9]:
        away = np.array([span(space, other, q) for other in there])
        expected = []
        for i in np.argsort(away, kind="stable"):
            alone = all(span(space, there[i], there[k]) > 0.1 for k in expected)
            if 1e-9 < away[i] <= 0.4 and alone and len(expected) < 4:
                expected.append(i)
        assert nearby(space, there, q, (0.4, 0.1), 4).tolist() == expected
        assert away[nearest(space, there, q)] == away.min()


def test_a_reference_is_left_without_a_jump_and_ends_at_rest():
    rng = np.random.default_rng(0)
    time = np.linspace(0, 4, 201)
    wave = np.stack([np.sin(time), np.cos(time)], axis=1)
    first = MotionReference(time, Way(wave, 2 * wave))
    begin = first.at(1.65)[:2]  # where it stands after 0.2 s at its pace and 0.5 s of braking
    course = Way(*(np.cumsum(np.vstack([q, 0.02 * rng.normal(size=(20, 2))]), axis=0) for q in begin))
    other = first.spliced(1.2, Stop(0.2, 0.5), course, 0.1, 3.0)
    for mine, theirs in zip(first.at(1.2), other.at(0.0), strict=True):
        np.testing.assert_allclose(theirs, mine, atol=5e-3)
    np.testing.assert_allclose(other.at(0.15)[0], first.at(1.35)[0], atol=0.02)
    np.testing.assert_allclose(other.at(other.duration)[0], course.configurations[-1], atol=1e-12)
    assert np.abs(other.at(other.duration - 0.05)[2]).max() < 0.02
    assert other.left == 3.0


def test_the_reference_is_clear_where_nothing_is_touched_within_a_second():
    pilot, _ = at_start()
    start = pilot.reference.at(0.0)[0]
    nodes = pilot.finder.coordinates.nodes(start[None, :, None])[0, 0]
    middle = 0.5 * (nodes[0] + nodes[1])
    for k, (away, clear) in enumerate(((1.6, True), (0.3, False), (0.9, True))):
        seen = ball(middle + [0.0, away, 0.0], [0.0, -0.4, 0.0])
        pilot.looks_on(100.0 + k, seen, 0.0)
        assert pilot.is_clear is clear


@pytest.mark.parametrize(
    ("gap", "met", "clear"), [(0.03, False, True), (0.007, True, True), (-0.01, True, False)]
)
def test_a_close_shave_is_met_but_clear(gap, met, clear):
    pilot, carrier = stands()
    nodes = pilot.finder.coordinates.nodes(pilot.reference.at(0.0)[0][None, :, None])[0, 0]
    seen, away = nothing(), 0.08 + carrier.scene.body.radii.max() + gap
    seen.table[0, CENTER : CENTER + 3] = 0.5 * (nodes[0] + nodes[1]) - [0.0, 0.0, away]
    ahead = pilot._ahead(pilot.reference, 0.0, seen)
    assert (ahead.max() >= FINDER.courses.costs.meeting) == met
    assert pilot._is_clear(ahead) is clear


def test_the_roadmap_grows_where_a_course_could_turn_aside_before_it_meets_something():
    pilot, carrier = stands()
    first, last = pilot.finder.coordinates.boundary()[[0, 2]]
    joints = np.concatenate([starts[0] for starts in carrier.starts])
    share = np.linspace(0.0, 1.0, 31)[:, None]
    way = Way(first + share * (last - first), np.repeat(joints[None], 31, axis=0))
    bars = pilot.finder.coordinates.nodes(way.configurations.T[None])[0]
    middle = bars[-1, :2].mean(axis=0)
    points = bars[:, None, 0] + np.linspace(0, 1, 100)[:, None] * (bars[:, None, 1] - bars[:, None, 0])
    apart = np.linalg.norm(points - middle, axis=-1).min(axis=-1) - 0.08 - carrier.scene.body.radii.max()
    met = int(np.argmax(apart < carrier.scene.clearance + FINDER.courses.costs.met))
    assert 10 < met < 30
    seen = nothing()
    seen.table[0, CENTER : CENTER + 3] = middle
    found = pilot.finder._before_meeting(way, seen, 0.0)
    np.testing.assert_array_equal(found, way.configurations[[met - 10, met - 5, met]])


@pytest.mark.slow
def test_who_stands_in_the_way_goes_out_of_it_in_time():
    pilot, _ = at_start()
    start = pilot.reference.at(0.0)
    nodes = pilot.finder.coordinates.nodes(start[0][None, :, None])[0, 0]
    middle = 0.5 * (nodes[0] + nodes[1])
    seen = ball(middle + [0.0, 1.6, 0.0], [0.0, -0.4, 0.0])
    assert not pilot.looks_on(0.0, nothing(), 0.0)
    assert pilot.looks_on(1.0, seen, 0.0)
    assert pilot.choose(1.0, seen, Way(start[0][None], start[1][None]), 0.0, 0.0)
    times = np.arange(0.0, 6.0, 0.05)
    configurations = pilot.reference.at(times)[0]
    placed = pilot.finder.coordinates.nodes(configurations.T[None])[0]
    share = np.linspace(0, 1, 40)[:, None]
    bar = placed[:, None, 0] + share * (placed[:, None, 1] - placed[:, None, 0])
    center = middle + np.array([0.0, 1.6, 0.0]) + times[:, None] * [0.0, -0.4, 0.0]
    stays = nodes[0] + share * (nodes[1] - nodes[0])
    assert np.linalg.norm(stays - center[:, None], axis=-1).min() < 0.08  # it would have been met
    assert np.linalg.norm(bar - center[:, None], axis=-1).min() > 0.08 + 0.012 + 0.01


@pytest.mark.slow
def test_arms_that_were_driven_off_the_roadmap_are_planned_for_once_they_stand():
    """The roadmap is no wider than some centimetres about the goal, and the arms stand at the start."""
    _, carrier = stands()
    scene, coordinates = carrier.scene, load_coordinates(carrier.scene)
    ends = [
        Way(q[None], np.concatenate([joints[0] for joints in found])[None])
        for q, found in zip(coordinates.boundary()[[0, 2]], (carrier.starts, carrier.goals), strict=True)
    ]
    needs = LinkNeeds(np.full(len(scene.obstacles), 0.5 * scene.clearance), 0.0, 0.0, 0.3)
    few = replace(FINDER, roadmap=RoadmapSettings(n_nodes=1, n_more=1, reach=0.02))
    plan = MotionReference.standing(ends[1])
    finder = CourseFinder(scene, carrier.arms, coordinates, plan, needs, seed=1, settings=few)
    pilot = Pilot(finder, replace(SETTINGS, finder=few))
    off = float(np.linalg.norm(scene.nodes_at("goal") - scene.nodes_at("start"), axis=1).max())
    pilot.looks_on(0.0, nothing(), 0.0)
    assert not pilot.choose(0.0, nothing(), ends[0], off, 0.0)
    assert pilot.reference is plan
    assert pilot.choose(2.0, nothing(), ends[0], off, 2.0)
    configurations, joints, rates = pilot.reference.at(np.linspace(0.0, pilot.reference.duration, 200))
    for end, k in zip(ends, (0, -1), strict=True):
        np.testing.assert_allclose(configurations[k], end.configurations[0], atol=1e-9)
    assert (np.abs(rates) <= carrier.arms.chains.velocity).all()
    nodes = coordinates.nodes(configurations.T[None])[0]
    keep, *others = clearances_along(
        pilot.finder.ground.arms, np.ascontiguousarray(joints), nodes, scene.obstacles, scene.clearance
    )
    assert keep.min() > 0.0 and min(others) > 0.0
    whole = carrier.robot.home
    for q, hands in zip(joints, nodes, strict=True):
        whole[np.concatenate([arm.columns for arm in carrier.holders])] = q
        for i, arm in enumerate(carrier.holders):  # hold the load where corners are rounded, too
            np.testing.assert_allclose(carrier.robot.tool_pose(whole, arm)[:3, 3], hands[i], atol=0.02)
