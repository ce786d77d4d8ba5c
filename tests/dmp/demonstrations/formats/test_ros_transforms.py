"""Movements of one frame in another, against rotations of SciPy and the rules of tf2."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from comove.dmp.demonstrations import Demonstration, read_rosbag
from comove.errors import DemonstrationError

pytest.importorskip("rosbags")

from tests.dmp.demonstrations.formats.advice import printed_options
from tests.dmp.demonstrations.formats.bags import TYPES, bag, make, point, pose_stamped

SECOND = 10**9
TF = "tf2_msgs/TFMessage"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bag"


def transform(parent, child, stamp, position=(0.0, 0.0, 0.0), rotation=None):
    x, y, z, w = (rotation or Rotation.identity()).as_quat().tolist()
    stamped = make("Header", stamp=make("Time", sec=stamp // SECOND, nanosec=stamp % SECOND), frame_id=parent)
    moved = make(
        "Transform",
        translation=point(*map(float, position), kind="Vector3"),
        rotation=make("Quaternion", x=x, y=y, z=z, w=w),
    )
    return make("TransformStamped", header=stamped, child_frame_id=child, transform=moved)


def tf(*transforms, static=False):
    """Messages of one transform each."""
    message = TYPES["tf2_msgs/msg/TFMessage"]
    return [
        ("/tf_static" if static else "/tf", TF, SECOND + k, message(transforms=[one]))
        for k, one in enumerate(transforms)
    ]


class Course:
    """Poses of a frame in its parent at stamps, as random walks."""

    def __init__(self, seed, stamps):
        rng = np.random.default_rng(seed)
        self.stamps = np.asarray(stamps)
        self.position = np.cumsum(rng.normal(scale=0.02, size=(len(stamps), 3)), axis=0)
        self.rotation = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.05, size=(len(stamps), 3)), axis=0))

    def messages(self, parent, child):
        return tf(
            *(
                transform(parent, child, int(stamp), place, turn)
                for stamp, place, turn in zip(self.stamps, self.position, self.rotation, strict=True)
            )
        )

    def at(self, stamps):
        """The matrices at stamps, shape (n, 4, 4), interpolated by SciPy."""
        matrices = np.tile(np.eye(4), (len(stamps), 1, 1))
        matrices[:, :3, 3] = np.stack(
            [np.interp(stamps, self.stamps, column) for column in self.position.T], axis=1
        )
        matrices[:, :3, :3] = Slerp(self.stamps, self.rotation)(stamps).as_matrix()
        return matrices


def near(demo, matrices, atol=1e-9):
    np.testing.assert_allclose(demo.position, matrices[:, :3, 3], atol=atol)
    turned = (
        Rotation.from_quat(demo.orientation[:, [1, 2, 3, 0]])
        * Rotation.from_matrix(matrices[:, :3, :3]).inv()
    )
    assert turned.magnitude().max() < 1e-7


STAMPS = SECOND + np.arange(40) * 25_000_000


def test_the_only_transform_that_moves_is_the_movement(path):
    course = Course(0, STAMPS)
    still = tf(transform("world", "table", SECOND, (1, 0, 0)), static=True)
    demo = Demonstration.load(bag(path, course.messages("table", "tool") + still))
    np.testing.assert_array_equal(demo.position, course.position)
    assert "tool in table" in demo.notes


@pytest.mark.parametrize("seed", range(4))
def test_chains_are_products_of_their_transforms(path, seed):
    """World -> base (constant) -> arm -> tool -> tip (constant), and a camera beside."""
    arm, tool, camera = (Course(10 * seed + i, STAMPS) for i in range(3))
    mount = Rotation.from_rotvec([0.3, -0.2, 1.0])
    constant = tf(
        transform("world", "base", 0, (0.1, 0.2, 0.3), mount),
        transform("tool", "tip", 0, (0, 0, 0.15)),
        static=True,
    )
    moving = arm.messages("base", "arm") + tool.messages("arm", "tool") + camera.messages("world", "camera")
    bag(path, constant + moving)
    base, tip = np.eye(4), np.eye(4)
    base[:3, :3], base[:3, 3], tip[:3, 3] = mount.as_matrix(), (0.1, 0.2, 0.3), (0, 0, 0.15)
    in_world = base @ arm.at(STAMPS) @ tool.at(STAMPS) @ tip
    near(Demonstration.load(path, topic="/tf:tip@world"), in_world)
    near(Demonstration.load(path, topic="/tf:tip"), in_world)
    near(Demonstration.load(path, topic="/tf:tip@camera"), np.linalg.inv(camera.at(STAMPS)) @ in_world)
    near(Demonstration.load(path, topic="/tf:base@tip"), np.linalg.inv(np.linalg.inv(base) @ in_world))


def test_refusals_name_movements_that_can_be_read(path):
    arms = [Course(i, STAMPS).messages("base", f"{side}_hand") for i, side in enumerate(("left", "right"))]
    bag(path, [*arms[0], *arms[1]])
    with pytest.raises(DemonstrationError) as caught:
        Demonstration.load(path)
    names = re.findall(r"/tf:[\w@]+", caught.value.way_out.partition("; run:")[0])
    assert names == ["/tf:left_hand@base", "/tf:right_hand@base"]
    for i, name in enumerate(names):
        np.testing.assert_array_equal(
            Demonstration.load(path, topic=name).position, Course(i, STAMPS).position
        )
    assert set(read_rosbag(path)) == set(names)
    with pytest.raises(DemonstrationError, match="there is no frame 'left_hnd'; did you mean 'left_hand'"):
        Demonstration.load(path, topic="/tf:left_hnd@base")
    with pytest.raises(DemonstrationError, match="'base' is the root of its tree"):
        Demonstration.load(path, topic="/tf:base")


def test_transforms_between_stamps_are_interpolated(path):
    """The transform with most stamps leads; the other runs at another rate, and begins later."""
    fast, slow = Course(1, STAMPS), Course(2, SECOND + 110_000_000 + np.arange(8) * 90_000_000)
    bag(path, fast.messages("base", "arm") + slow.messages("arm", "tool"))
    demo = Demonstration.load(path, topic="/tf:tool@base")
    common = STAMPS[np.clip(STAMPS, slow.stamps[0], slow.stamps[-1]) == STAMPS]
    np.testing.assert_allclose(demo.time, (common - common[0]) / SECOND, atol=1e-12)
    near(demo, fast.at(common) @ slow.at(common), atol=1e-6)
    assert any("interpolated as tf2 does, over 0.09 s at most" in note for note in demo.notes)


def test_frames_in_a_circle_are_told(path):
    courses = [Course(i, STAMPS) for i in range(3)]
    circle = [("a", "b"), ("b", "c"), ("c", "a")]
    bag(path, [m for course, pair in zip(courses, circle, strict=True) for m in course.messages(*pair)])
    with pytest.raises(DemonstrationError, match="frames go round in a circle") as caught:
        Demonstration.load(path)
    pair = printed_options(caught.value)["topic"]
    assert Demonstration.load(path, topic=pair).n_steps == len(STAMPS)


def test_a_frame_with_two_parents_is_told(path):
    bag(path, Course(0, STAMPS).messages("left", "cup") + Course(1, STAMPS).messages("right", "cup"))
    with pytest.raises(DemonstrationError, match="'cup' has 2 parents: left, right") as caught:
        Demonstration.load(path)
    pair = printed_options(caught.value)["topic"]
    np.testing.assert_array_equal(Demonstration.load(path, topic=pair).position, Course(0, STAMPS).position)


def test_frames_without_a_way_between_them_are_told(path):
    later = STAMPS + 10 * SECOND
    bag(path, Course(0, STAMPS).messages("a", "b") + Course(1, STAMPS).messages("c", "d"))
    with pytest.raises(DemonstrationError, match="no transforms lead from 'a' to 'd'"):
        Demonstration.load(path, topic="/tf:d@a")
    apart = bag(
        path.with_name("apart"), Course(0, STAMPS).messages("a", "b") + Course(1, later).messages("b", "c")
    )
    with pytest.raises(DemonstrationError, match="'a' and 'c' have no common time") as caught:
        Demonstration.load(apart, topic="/tf:c@a")
    pair = printed_options(caught.value)["topic"]
    Demonstration.load(apart, topic=pair)


def test_transforms_that_are_repeated_or_late_count_once_in_order(path):
    course = Course(0, STAMPS)
    messages = course.messages("base", "tool")
    shuffled = [messages[i] for i in [0, 2, 1, 1, *range(3, 40), 39]]
    received = [(topic, kind, SECOND + k, message) for k, (topic, kind, _, message) in enumerate(shuffled)]
    demo = Demonstration.load(bag(path, received))
    np.testing.assert_array_equal(demo.position, course.position)


def test_a_clock_of_transforms_that_is_set_back_leaves_that_of_the_bag(path):
    one, two = (m for m in (Course(0, STAMPS), Course(1, STAMPS)))
    messages = one.messages("base", "tool") + two.messages("base", "tool")
    received = [(topic, kind, k * 10**8, message) for k, (topic, kind, _, message) in enumerate(messages, 1)]
    demo = Demonstration.load(bag(path, received))
    assert demo.n_steps == 80
    np.testing.assert_allclose(np.diff(demo.time), 0.1)
    assert any("time is that of the bag" in note for note in demo.notes)


def test_transforms_do_not_hide_other_topics(path):
    hand = [
        ("/hand", "geometry_msgs/PoseStamped", k, pose_stamped(0.1 * k, (1 + k) * SECOND)) for k in range(4)
    ]
    arms = Course(0, STAMPS).messages("base", "left") + Course(1, STAMPS).messages("base", "right")
    assert Demonstration.load(bag(path, hand + arms)).n_steps == 4
    assert Demonstration.load(path, topic="/tf:left").n_steps == len(STAMPS)


def test_what_does_not_move_is_told(path):
    still = [transform("base", "tool", int(stamp), (1, 0, 0)) for stamp in STAMPS]
    with pytest.raises(DemonstrationError, match="none of its frames moves: tool in base"):
        Demonstration.load(bag(path, tf(*still)))


def test_quaternions_that_are_none_are_told_where_they_would_turn_others(path):
    bad = Course(0, STAMPS).messages("base", "arm")
    for _, _, _, message in bad:
        message.transforms[0].transform.rotation = make("Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
    bag(path, bad + Course(1, STAMPS).messages("arm", "tool"))
    with pytest.raises(
        DemonstrationError, match=r"from 'base' to 'arm' has the quaternion .* whose norm is not 1"
    ):
        Demonstration.load(path, topic="/tf:tool@base")
    assert Demonstration.load(path, topic="/tf:arm@base").orientation is None
