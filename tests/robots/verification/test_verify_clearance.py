"""Certified clearances against dense sampling by Pinocchio, which knows nothing of bounds."""

from dataclasses import replace
from functools import partial

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import OptionError
from comove.model import Scene
from comove.robots import JointMotion, verify_joints
from comove.robots.description import Uncertainty
from comove.robots.free_space import Room
from comove.robots.motion import JointCurve
from comove.robots.transfers import _Still
from comove.robots.verification import bodies
from comove.robots.verification.bodies import COAL_ERROR, LOAD, SCENE, SELF, bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import (
    CarryCourse,
    JointCertificateSettings,
    PairCells,
    are_clear,
    certify,
)
from comove.robots.verification.kinematics import Bases, Reaches
from comove.robots.verification.slabs import distances_of_balls
from tests.cases import examples
from tests.robots.known_carry import TABLE, baxter, known_carry, on_scene, posts, scene_data

TIGHT = JointCertificateSettings().tight
TAKEN = (
    1.2e-4  # m, that the verification takes from distances: coal's accuracy, and hands that are a little off
)


def world_of(motion):
    """The load's motion, and all bodies."""
    carried, robot = Carried(motion), baxter()
    hands = motion.hands(np.linspace(0, 1, 50))[0]
    return carried, bodies_of(Bases(robot, Uncertainty()), robot.arms, carried, hands, 1e-5)


def certified(motion, joints, slack=0.0):
    """Clearances by kind, and what is to be kept."""
    carried, world = world_of(motion)
    return certify(world, carried, joints.curve, slack), world.required


class Sampled:
    """Least distances by kind at many instants: of all pairs at 50 Hz, of those that are near at a higher rate."""

    def __init__(self, motion, joints):
        robot, self.motion, self.joints = baxter(), motion, joints
        self.model, self.data, self.geometry = robot.model, robot.model.createData(), robot.collision.copy()
        self.kinds = [SELF] * len(self.geometry.collisionPairs)
        links, wrists = range(self.geometry.ngeoms), ("left_w2", "right_w2")
        moved = [
            g for g in links if self.geometry.geometryObjects[g].parentJoint > 0
        ]  # others stand as obstacles do
        for k, obstacle in enumerate(motion.scene.file.obstacles):
            self._add(f"obstacle {k}", moved, SCENE, shape(obstacle), np.array(obstacle.center))
        load = motion.scene.file.load
        if load.shape == "bar":
            rod = coal.Capsule(load.radius, load.length + 2 * load.overhang)
        else:  # in the frame of a rod, whose z axis is along the line between the hands
            rod = coal.Box(load.size[2], load.size[1], load.size[0])
        free = [
            g for g in links if self.model.names[self.geometry.geometryObjects[g].parentJoint] not in wrists
        ]
        self.rod = self._add("load", free, LOAD, rod, np.zeros(3))
        self.placed = self.geometry.createData()

    def _add(self, name, links, kind, geometry, center):
        number = self.geometry.addGeometryObject(
            pin.GeometryObject(name, 0, pin.SE3(np.eye(3), center), geometry)
        )
        for link in links:
            self.geometry.addCollisionPair(pin.CollisionPair(link, number))
            self.kinds.append(kind)
        return number

    def least(self, rate):
        """By kind."""
        coarse = self._distances(50.0, range(len(self.kinds)))
        kinds = np.array(self.kinds)
        worst = np.array([coarse[kinds == kind].min() for kind in range(3)])
        near = np.flatnonzero(coarse < worst[kinds] + 0.03)  # m, further than anything goes in 10 ms
        fine = self._distances(rate, near)
        return np.array([fine[kinds[near] == kind].min() for kind in range(3)])

    def at(self, time, kind):
        """The least distance of one kind at one instant."""
        return self._distances_at(np.array([time]), np.flatnonzero(np.array(self.kinds) == kind)).min()

    def _distances(self, rate, pairs):
        time = np.linspace(0.0, self.joints.duration, int(rate * self.joints.duration) + 1)
        return self._distances_at(time, pairs)

    def _distances_at(self, time, pairs):
        hands = self.motion.hands(time / self.joints.duration)[0]
        least = np.full(len(pairs), np.inf)
        for q, (left, right) in zip(self.joints.curve(time), hands, strict=True):
            pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.placed, q)
            u, up = (left - right) / np.linalg.norm(left - right), np.array([0.0, 0.0, 1.0])
            turn = np.column_stack([up, np.cross(u, up), u])
            self.placed.oMg[self.rod] = pin.SE3(turn, 0.5 * (left + right))
            found = [
                pin.computeDistance(self.geometry, self.placed, int(pair)).min_distance for pair in pairs
            ]
            least = np.minimum(least, found)
        return least


def shape(obstacle):
    """An obstacle of the scene file as coal has it."""
    if obstacle.shape == "box":
        return coal.Box(*obstacle.size)
    return coal.Cylinder(obstacle.radius, obstacle.height)


def compare(motion, joints, rate=200.0):
    """Certified clearances are true, and not far from what sampling finds."""
    found, required = certified(motion, joints)
    for clearance, sampled, keep in zip(found, Sampled(motion, joints).least(rate), required, strict=True):
        assert clearance.lower <= sampled - 0.9e-4
        assert clearance.upper >= sampled - TAKEN - 0.2 / rate  # m, as far as things get between samples
        if sampled > keep + TAKEN:
            assert clearance.lower >= sampled - TAKEN - TIGHT - 1e-4
    return found


def test_what_was_met_on_the_way_is_a_distance_less_what_is_taken():
    motion, joints = known_carry()
    sampled = Sampled(motion, joints)
    for kind, clearance in enumerate(certified(motion, joints)[0]):
        distance = sampled.at(clearance.time, kind)
        assert clearance.upper <= distance - COAL_ERROR + 1e-6
        assert clearance.upper >= distance - TAKEN - 1e-6


def test_clearances_of_the_known_path_are_those_of_dense_sampling():
    motion, joints = known_carry()
    scene, load, own = compare(motion, joints, rate=1000.0)
    assert scene.lower == pytest.approx(0.0299, abs=1.1e-3)
    assert own.lower == pytest.approx(0.0854, abs=1.1e-3)
    assert load.lower == pytest.approx(0.1738, abs=1.1e-3)


@examples(3)
@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_clearances_of_other_motions_are_those_of_dense_sampling(seed):
    motion, joints = known_carry()
    rng = np.random.default_rng(seed)
    bumps = np.sin(np.pi * np.outer(joints.time / joints.duration, rng.integers(1, 6, 14))) ** 3
    position = joints.position + rng.uniform(-0.25, 0.25, 14) * bumps
    compare(motion, JointMotion(joints.time, joints.joint_names, position))


def test_bounds_with_slack_are_true_and_give_away_no_more_than_it_says():
    motion, joints = known_carry()
    tight, required = certified(motion, joints)
    for slack in (0.3, 0.9):
        loose, _ = certified(motion, joints, slack)
        for kind, keep in enumerate(required):
            spare = tight[kind].upper - keep
            assert keep <= loose[kind].lower <= tight[kind].upper + 1e-12
            assert (
                loose[kind].lower >= tight[kind].upper - max(TIGHT, slack * (loose[kind].upper - keep)) - 1e-9
            )
            assert spare > 0.01  # else this says nothing
    assert certified(motion, joints, 0.9)[0][LOAD].lower < tight[LOAD].lower - 0.01


def test_a_contact_is_a_contact_with_slack_too():
    motion, joints = known_carry()
    narrow = on_scene(motion, Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.15)))))
    for slack in (0.0, 0.5, 1.0):
        found, required = certified(narrow, joints, slack)
        assert found[SCENE].upper < required[SCENE]


@pytest.mark.parametrize("gap", [0.236, 0.25, 0.253, 0.26])
def test_whether_the_clearance_is_kept_does_not_depend_on_slack(gap):
    """On both sides of the gap at which it is just kept."""
    motion, joints = known_carry()
    narrow = on_scene(motion, Scene.from_dict(scene_data(obstacles=(TABLE, *posts(gap)))))
    tight, required = certified(narrow, joints)
    loose, _ = certified(narrow, joints, 1.0)
    verdicts = [
        all(found.lower >= keep for found, keep in zip(c, required, strict=True)) for c in (tight, loose)
    ]
    assert verdicts[0] == verdicts[1]
    assert verdicts[0] == (tight[SCENE].upper >= required[SCENE])
    assert all(rough.lower <= exact.upper + 1e-12 for rough, exact in zip(loose, tight, strict=True))


def test_a_search_hears_the_first_check_that_fails_and_a_user_all_of_them():
    motion, joints = known_carry()
    beyond = replace(joints, position=joints.position.copy())
    beyond.position[:, 0] += 3.0  # rad: beyond the joint's limits, and its hand off the load
    every, first = (verify_joints(baxter(), motion, beyond, slack=slack).reasons for slack in (0.0, 1.0))
    assert first
    assert first == every[: len(first)] != every


@pytest.mark.slow
def test_a_box_between_the_hands_is_kept_clear_of():
    motion, joints = known_carry()
    load = {"shape": "box", "size": [0.5, 0.3, 0.02]}
    scene = Scene.from_dict(scene_data(obstacles=(TABLE,), load=load))
    _, found, _ = compare(on_scene(motion, scene), joints)
    plain = certified(on_scene(motion, Scene.from_dict(scene_data(obstacles=(TABLE,)))), joints)[0][LOAD]
    assert found.lower < plain.lower - 0.02  # m: the box is wider than the bar


@pytest.mark.slow
@examples(2)
@given(st.integers(0, 2**32 - 1))
def test_obstacles_anywhere_are_kept_clear_of_as_sampling_says(seed):
    rng = np.random.default_rng(seed)
    centers = np.column_stack(
        [rng.uniform(0.2, 1.2, 4), rng.uniform(-1.0, 1.0, 4), rng.uniform(0.35, 1.0, 4)]
    )
    boxes = [
        {"shape": "box", "center": center.tolist(), "size": rng.uniform(0.02, 0.2, 3).tolist()}
        for center in centers
    ]
    motion, joints = known_carry()
    compare(on_scene(motion, Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.3), *boxes)))), joints)


def test_the_certificate_is_a_matter_of_the_path_and_not_of_its_pace():
    motion, joints = known_carry()
    slow = Scene.from_dict(scene_data(duration=40.0))
    one, _ = certified(motion, joints)
    other, _ = certified(on_scene(motion, slow), joints.stretched(40.0))
    for a, b in zip(one, other, strict=True):
        assert a.lower == pytest.approx(b.lower, abs=1e-6)
        assert 4 * a.time == pytest.approx(b.time, abs=1e-6)


def test_every_obstacle_shape_is_where_the_scene_has_it():
    """A link's distance to a ball is the same whichever shape describes the ball, and turned boxes turn."""
    motion, joints = known_carry()
    center = [0.75, 0.35, 0.62]
    lower = []
    for ball in (
        {"shape": "sphere", "radius": 0.05},
        {"shape": "ellipsoid", "radii": [0.05, 0.05, 0.05]},
        {"shape": "capsule", "radius": 0.05, "length": 1e-6},
    ):
        scene = Scene.from_dict(scene_data(obstacles=(ball | {"center": center},)))
        lower.append(certified(on_scene(motion, scene), joints)[0][SCENE].lower)
    assert np.ptp(lower) < TIGHT
    half = np.sqrt(0.5)
    upright = {"shape": "box", "center": center, "size": [0.02, 0.02, 0.3]}
    lying = {
        "shape": "box",
        "center": center,
        "size": [0.02, 0.3, 0.02],
        "quaternion_wxyz": [half, half, 0, 0],
    }
    both = [
        certified(on_scene(motion, Scene.from_dict(scene_data(obstacles=(box,)))), joints)[0][SCENE].lower
        for box in (upright, lying)
    ]
    assert both[0] == pytest.approx(both[1], abs=TIGHT)


@examples(20)
@given(st.integers(0, 2**32 - 1))
def test_no_joint_moves_a_link_faster_than_its_reach(seed):
    """Points of a link, moved a little by one joint, go no further than the joint's reach says."""
    robot, rng = baxter(), np.random.default_rng(seed)
    reaches, data = Reaches(robot), robot.model.createData()
    item = robot.collision.geometryObjects[int(rng.integers(5, robot.collision.ngeoms))]
    if item.parentJoint == 0:
        return
    item.geometry.computeLocalAABB()
    center = item.placement.act(np.array(item.geometry.aabb_center))
    radius = float(item.geometry.aabb_radius)
    reach, root, length = reaches.of_ball(item.parentJoint, center, radius)
    direction = rng.normal(size=3)
    point = center + radius * direction / np.linalg.norm(direction)
    q = rng.uniform(robot.lower, robot.upper)
    joint = int(rng.integers(14))
    step = np.zeros(14)
    step[joint] = 1e-6
    places = []
    for configuration in (q, q + step):
        pin.forwardKinematics(robot.model, data, configuration)
        places.append(data.oMi[item.parentJoint].act(point))
    assert np.linalg.norm(places[1] - places[0]) <= 1e-6 * reach[joint] * (1 + 1e-6) + 1e-15
    assert np.linalg.norm(places[0] - root) <= length + 1e-12


def test_a_rough_hull_is_never_further_away_than_its_mesh(monkeypatch):
    """Without hulls the certificate says the same."""
    motion, joints = known_carry()
    with_hulls, _ = certified(motion, joints)
    monkeypatch.setattr(bodies, "_hull_of", lambda _: (None, False))
    monkeypatch.setattr(bodies, "links_of", bodies.links_of.__wrapped__)
    without, _ = certified(motion, joints)
    for a, b in zip(with_hulls, without, strict=True):
        assert a.lower == pytest.approx(b.lower, abs=TIGHT)


def test_what_cannot_be_computed_within_the_limit_is_not_certified(monkeypatch):
    """The reason names the pair that has the bound, which need not be the nearest one."""
    from comove.robots.verification import checks

    few = partial(certify, settings=JointCertificateSettings(parts=1, most=100))
    monkeypatch.setattr(checks, "certify", few)
    motion, joints = known_carry()
    verdict = verify_joints(baxter(), motion, joints)
    assert verdict.verified is None
    carried, world = world_of(motion)
    bounds = few(world, carried, joints.curve)
    open_kinds = [kind for kind in range(3) if bounds[kind].lower < world.required[kind]]
    assert open_kinds and len(verdict.reasons) == len(open_kinds)
    for kind, reason in zip(open_kinds, verdict.reasons, strict=True):
        named = bounds[kind].weakest
        assert "could not be certified" in reason and f"of {world.name(named)} at" in reason
        once = JointCertificateSettings(parts=1, deepest=1)
        alone = certify(world.some(world.exact == named), carried, joints.curve, settings=once)
        assert alone[kind].lower == pytest.approx(bounds[kind].lower, rel=0.02)


def test_joints_that_jump_are_given_up_soon():
    """A path that turns hundreds of times needs more distances than are computed."""
    motion, joints = known_carry()
    wild = joints.position + 3.0 * np.sin(np.arange(1001) * 2.0)[:, None]
    found, required = certified(motion, replace(joints, position=wild))
    assert any(clearance.lower < keep for clearance, keep in zip(found, required, strict=True))


@pytest.mark.parametrize("room", [0.01, 0.0053])
def test_hands_that_glide_just_above_a_table_are_certified_with_few_distances(room, monkeypatch):
    """Their distance stays what it is for the whole motion, which bounds by speeds alone can hardly prove."""
    from comove.robots import verify_joints
    from comove.robots.verification import checks

    monkeypatch.setattr(checks, "certify", partial(certify, settings=JointCertificateSettings(most=20_000)))
    motion, joints = known_carry()
    top = 0.05 - 0.00515 - room  # m, that deep below the load fingers reach
    table = {"shape": "box", "center": [0.68, 0, top - 0.025], "size": [0.7, 1.6, 0.05]}
    thin = scene_data()["load"] | {"radius": 0.002}
    workspace = {"lower": [0.1, -1.2, -0.3], "upper": [1.3, 1.2, 1.0]}
    scene = Scene.from_dict(scene_data(obstacles=(table,), load=thin, workspace=workspace))
    verdict = verify_joints(baxter(), on_scene(motion, scene), joints)
    assert verdict.reasons == ()
    assert verdict.report.clearance_scene == pytest.approx(room, abs=1.2e-3)


def test_parts_of_cells_cover_the_same_pairs_at_the_same_times():
    world = world_of(known_carry()[0])[1]
    cells = PairCells.first(world, 6)
    chosen = np.flatnonzero(np.random.default_rng(0).random(len(cells.pair)) < 0.5)
    parts = cells.divided(chosen)
    assert (parts.number // 4 == np.repeat(cells.number[chosen], 4)).all()
    assert (parts.number % 4 == np.tile(range(4), len(chosen))).all()
    assert (parts.pair == np.repeat(cells.pair[chosen], 4)).all()


def test_intervals_meet_and_last_as_long_as_the_motion():
    motion, joints = known_carry()
    course = CarryCourse(world_of(motion)[1], Carried(motion), joints.curve)
    at, time = course.intervals(np.arange(6), 6)
    ends = time[at.knot]
    assert ends[0, 0] == 0.0 and ends[-1, -1] == joints.duration
    np.testing.assert_array_equal(ends[1:, 0], ends[:-1, -1])
    np.testing.assert_allclose(np.diff(ends, axis=1), at.half, rtol=1e-12)


def test_balls_about_bodies_are_never_further_apart_than_the_bodies():
    """All pairs of a known carry, by coal and by balls, with a load and obstacles."""
    motion, joints = known_carry()
    carried, world = world_of(motion)
    at, time = CarryCourse(world, carried, joints.curve).intervals(np.array([3]), 8)
    count = len(world.kind)
    rough = distances_of_balls(
        world.solids, world.pairs, at, np.zeros(count, dtype=np.int64), np.arange(count)
    )
    placed = world.placed_at(carried.nodes(time[1:2])[0], time[1])
    data, found = world.robot.model.createData(), placed.geometry.createData()
    pin.computeDistances(world.robot.model, data, placed.geometry, found, joints.curve(time[1]))
    exact = np.array([result.min_distance for result in found.distanceResults]) - world.taken
    assert count > 20
    assert (rough <= exact + 1e-9)[exact > 0].all()


@pytest.mark.parametrize(
    ("name", "value"), [("deepest", 0), ("parts", 0), ("tight", np.nan), ("loose", -1.0)]
)
def test_settings_that_would_let_the_certificate_say_nothing_are_refused(name, value):
    with pytest.raises(OptionError) as refused:
        JointCertificateSettings(**{name: value})
    assert refused.value.key == name


@pytest.mark.parametrize("link", ["collision_head_link_1_0", "left_lower_forearm_0", "right_upper_elbow_0"])
def test_a_load_put_down_in_a_link_is_met_there(link):
    """As in an approach, whose bodies have their places: coal, which measures what is in each other, finds it in one
    place only.
    """
    motion, joints = known_carry()
    carried, robot = Carried(motion), baxter()
    q, hands = joints.curve(0.0), motion.hands(np.linspace(0, 1, 50))[0]
    world = bodies_of(Bases(robot, Uncertainty()), robot.arms, carried, hands, 0.0, holding=())
    data, placed = robot.model.createData(), robot.collision.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.collision, placed, q)
    middle = placed.oMg[robot.collision.getGeometryId(link)].translation
    nodes = carried.nodes(np.zeros(1))[0]
    place = nodes - nodes.mean(axis=0) + middle
    stands = JointCurve.through(np.arange(2.0), np.stack([q, q]))
    there, moved = (certify(w, _Still(place), stands)[LOAD] for w in (world.placed_at(place), world))
    assert there == moved
    assert there.upper < -0.05
    assert world.name(there.pair).startswith(link.removesuffix("_0"))


def test_joints_are_clear_at_an_instant_where_coal_finds_no_pair_too_near():
    motion, joints = known_carry()
    _, world = world_of(motion)
    nodes, rng = motion.scene.nodes_at("start"), np.random.default_rng(7)
    room = Room(world.placed_at(nodes), baxter().arms, np.zeros(len(world.kind)))
    told = []
    for spread in np.repeat([0.0, 0.05, 0.15, 0.4], 8):
        q = joints.position[0] + spread * rng.standard_normal(joints.position.shape[1])
        told.append(are_clear(world, q, nodes, 0.0))
        assert told[-1] == (room.contact(q) == "")
    assert any(told) and not all(told)
