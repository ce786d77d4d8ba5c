"""Coordination of arms with clients that are not there, on a clock that does not run by itself."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from comove.errors import OptionError
from comove.robots import verify_joints
from comove.ros import ExportError, SendError, Tolerances, parts_of, send
from comove.ros.send import ArmState, RobotState, Status
from tests.robots.known_carry import baxter, known_carry, uncertain_baxter

STEP = 0.01  # s, that a look at the state takes
TOLERANCES = Tolerances()


@dataclass
class Fake:
    """A robot that follows exactly, with faults: each changes the state from an instant on, by ROS's clock."""

    motion: object
    faults: list = field(default_factory=list)  # (time since the common start [s], function of the state)
    now: float = 0.0
    start: float = np.inf
    goals: dict = field(default_factory=dict)
    calls: list = field(default_factory=list)
    stubborn: bool = False
    joints: object = None
    has_grippers: bool = False
    grips: list = field(default_factory=list)  # (time since the common start [s], whether closed)
    lasting: float = 0.3  # s, of a motion of the grippers
    tolerances: object = None

    def clock(self):
        return self.now

    def connect(self, arms, timeout):
        self.arms = arms
        self.calls.append("connect")

    def send(self, goals, delay, tolerances):
        self.goals, self.start, self.tolerances = goals, self.now + delay, tolerances
        self.calls.append("send")

    def grip(self, closed):
        self.grips.append((self.now - self.start, closed))
        self.gripped = self.now
        self.calls.append("grip")

    def cancel(self):
        self.calls.append(("cancel", round(self.now - self.start, 3)))

    def state(self, wait):
        self.now += min(STEP, wait)
        time, joints = self.now - self.start, self.joints or self.motion.joints
        arms = {}
        for arm in self.arms:
            status = Status.NONE if not self.goals else Status.ACTIVE
            if time > joints.duration and self.goals:
                status = Status.SUCCEEDED
            if any(call[0] == "cancel" for call in self.calls) and not self.stubborn:
                status = Status.PREEMPTED
            arms[arm] = ArmState(status, "", joints.duration if status is Status.SUCCEEDED else None)
        at = joints.curve(np.clip(time, 0.0, joints.duration))
        position = dict(zip(joints.joint_names, at.tolist(), strict=True))
        state = RobotState(arms, position, time if self.goals else None, silence=0.0)
        if self.grips:
            done = self.now - self.gripped > self.lasting
            moved = ArmState(Status.SUCCEEDED if done else Status.ACTIVE)
            state = replace(state, grippers=dict.fromkeys(self.arms, moved))
        for begin, change in self.faults:
            if time >= begin:
                state = change(state)
        return state


def says(arm, status, text=""):
    """A fault: the controller of an arm says something else."""
    return lambda state: replace(state, arms={**state.arms, arm: ArmState(status, text)})


def shifted(joint, by):
    """A fault: a joint is elsewhere."""
    return lambda state: replace(state, position={**state.position, joint: state.position[joint] + by})


def without(joint):
    return lambda state: replace(state, position={k: v for k, v in state.position.items() if k != joint})


ALWAYS = -np.inf


def test_all_goes_well(verified):
    fake = Fake(verified)
    outcome = send(fake, verified, clock=fake.clock)
    assert fake.calls == ["connect", "send"]
    assert outcome.apart == 0.0 and outcome.deviation < 1e-9 and not outcome.reason
    for arm in verified.robot.arms:
        goal, columns = fake.goals[arm.name], arm.columns
        assert goal.joint_names == tuple(verified.robot.joint_names[c] for c in columns)
        samples = parts_of(verified)["carry"].samples(100.0)
        assert (goal.position == samples.position[:, columns]).all()
        assert (np.diff(goal.nanoseconds) > 0).all()
        assert not goal.velocity[[0, -1]].any()


@pytest.mark.parametrize(
    ("status", "message"),
    [
        (Status.ABORTED, "'left' gave up: why"),
        (Status.REJECTED, "'left' refused the goal: why"),
        (Status.LOST, "'left' is gone: why"),
        (Status.PREEMPTED, "'left' was stopped by somebody else: why"),
        (Status.RECALLED, "'left' was called back by somebody else: why"),
    ],
)
def test_when_one_arm_fails_all_are_stopped_at_once(verified, status, message):
    fake = Fake(verified, [(4.0, says("left", status, "why"))])
    with pytest.raises(SendError, match=message) as caught:
        send(fake, verified, clock=fake.clock)
    (stopped,) = {call[1] for call in fake.calls if call[0] == "cancel"} & {4.0, 4.01}
    assert stopped - 4.0 <= STEP + 1e-9
    assert caught.value.outcome.reason and caught.value.outcome.arms["right"].status is Status.PREEMPTED


def test_a_joint_that_leaves_the_motion_stops_all(verified):
    fake = Fake(verified, [(3.0, shifted("right_w0", 0.15)), (5.0, shifted("right_w0", 0.15))])
    with pytest.raises(SendError, match=r"'right_w0' is 0\.3 rad off the motion \(0\.2 allowed\)") as caught:
        send(fake, verified, clock=fake.clock)
    assert ("cancel", 5.0) in fake.calls or ("cancel", 5.01) in fake.calls
    assert caught.value.outcome.deviation == pytest.approx(0.3)


def test_an_arm_that_does_not_begin_stops_all(verified):
    fake = Fake(verified, [(ALWAYS, says("right", Status.PENDING))])
    with pytest.raises(SendError, match="'right' had not taken its goal when all were to begin"):
        send(fake, verified, clock=fake.clock)
    assert 0.1 < next(call[1] for call in fake.calls if call[0] == "cancel") < 0.13


def test_joints_that_fall_silent_stop_all(verified):
    fake = Fake(verified, [(2.0, lambda state: replace(state, silence=fake.now - fake.start - 2.0))])
    with pytest.raises(SendError, match="joints have said nothing for 0"):
        send(fake, verified, clock=fake.clock)


def test_a_position_that_is_no_number_stops_all(verified):
    fake = Fake(verified, [(1.0, shifted("left_s0", np.nan))])
    with pytest.raises(SendError, match="'left_s0' is inf rad off"):
        send(fake, verified, clock=fake.clock)


@pytest.mark.parametrize("stubborn", [False, True])
def test_an_arm_that_does_not_end_is_stopped(verified, stubborn):
    fake = Fake(verified, [(0.0, says("right", Status.ACTIVE))], stubborn=stubborn)
    with pytest.raises(SendError, match="'right' was not done 3 s after the end of the motion"):
        send(fake, verified, clock=fake.clock)
    assert any(call[0] == "cancel" for call in fake.calls)
    assert fake.now < 10.0 + 3.0 + 2.0


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (
            shifted("left_e1", 0.05),
            r"'left_e1' is at .* 0\.05 rad away \(0\.01 allowed\).*bring the robot there",
        ),
        (shifted("left_e1", -0.011), r"0\.011 rad away"),
        (shifted("left_e1", np.nan), "'left_e1' is at nan rad"),
        (
            without("right_s1"),
            "says nothing of a joint 'right_s1'; send it to the robot it was made for, 'baxter'",
        ),
        (
            lambda state: replace(state, age=-2.5),
            r"stamps -2\.5 s old \(0\.1 s allowed\).*by the same time server",
        ),
        (
            lambda state: replace(state, busy=frozenset({"right"})),
            "controller of the arm 'right' has a goal of another client; wait for its end",
        ),
        (
            lambda state: replace(state, conflict=("left_s0", ("/a", "/b"))),
            "the joint 'left_s0' is told by several nodes: /a, /b; end all but",
        ),
        (
            lambda state: replace(state, position={n: np.degrees(q) for n, q in state.position.items()}),
            "seems to tell degrees: have it tell its joints in rad",
        ),
        (lambda state: replace(state, position={}), "joints have said nothing for 10 s; switch the robot on"),
    ],
)
def test_a_robot_that_is_not_at_the_start_is_not_moved(verified, fault, message):
    fake = Fake(verified, [(ALWAYS, fault)])
    with pytest.raises(SendError, match=message):
        send(fake, verified, clock=fake.clock)
    assert "send" not in fake.calls
    assert fake.now < TOLERANCES.connect + 1.0


def test_another_clients_goal_stops_all(verified):
    fake = Fake(verified, [(2.0, lambda state: replace(state, busy=frozenset({"left"})))])
    with pytest.raises(SendError, match="another client has sent the controller of the arm 'left' a goal"):
        send(fake, verified, clock=fake.clock)
    assert ("cancel", 2.0) in fake.calls or ("cancel", 2.01) in fake.calls


def test_grippers_open_before_the_approach_and_close_while_it_waits(verified, transfers):
    fake = Fake(verified, joints=transfers.approach, has_grippers=True)
    send(fake, verified, part="approach", transfers=transfers, clock=fake.clock)
    (before, opened), (time, closed) = fake.grips
    assert before == -np.inf and not opened and closed
    assert fake.calls == ["connect", "grip", "send", "grip"]
    stood = transfers.approach.duration - transfers.grip_time
    assert stood <= time <= stood + 2 * STEP


def test_grippers_open_at_the_beginning_of_the_release(verified, transfers):
    fake = Fake(verified, joints=transfers.release, has_grippers=True)
    send(fake, verified, part="release", transfers=transfers, clock=fake.clock)
    ((time, closed),) = fake.grips
    assert 0.0 <= time <= 2 * STEP and not closed


def test_arms_do_not_leave_what_a_gripper_still_holds(verified, transfers):
    fake = Fake(verified, joints=transfers.release, has_grippers=True, lasting=1e9)
    with pytest.raises(SendError, match="the gripper of 'left' was not open when its arm was to leave"):
        send(fake, verified, part="release", transfers=transfers, clock=fake.clock)
    cancelled = min(call[1] for call in fake.calls if call[0] == "cancel")
    assert transfers.grip_time <= cancelled <= transfers.grip_time + 2 * STEP


def test_grippers_hold_in_the_carry(verified):
    fake = Fake(verified, has_grippers=True)
    send(fake, verified, clock=fake.clock)
    assert not fake.grips


def test_grippers_that_do_not_open_keep_the_arms_where_they_are(verified, transfers):
    fake = Fake(verified, joints=transfers.approach, has_grippers=True, lasting=1e9)
    with pytest.raises(SendError, match="the grippers were not done after 10 s"):
        send(fake, verified, part="approach", transfers=transfers, clock=fake.clock)
    assert "send" not in fake.calls


def test_a_small_difference_at_the_start_is_allowed(verified):
    fake = Fake(verified, [(ALWAYS, shifted("left_e1", 0.009))])
    assert send(fake, verified, clock=fake.clock).deviation == pytest.approx(0.009)


def test_an_interruption_stops_all(verified):
    fake = Fake(verified)

    def interrupt(state):
        raise KeyboardInterrupt

    fake.faults.append((2.0, interrupt))
    with pytest.raises(KeyboardInterrupt):
        send(fake, verified, clock=fake.clock)
    assert fake.calls[-1][0] == "cancel"


def test_the_unverified_is_not_sent(verified):
    fake = Fake(verified)
    with pytest.raises(ExportError, match="not a verified one of joints"):
        send(fake, verified.joints, clock=fake.clock)
    with pytest.raises(ExportError, match="20 Hz or more"):
        send(fake, verified, rate=5.0, clock=fake.clock)
    assert not fake.calls


def test_approach_and_release_are_sent_too(verified, transfers):
    for part in ("approach", "release"):
        fake = Fake(verified, joints=getattr(transfers, part))
        assert send(fake, verified, part=part, transfers=transfers, clock=fake.clock).deviation < 1e-9
    with pytest.raises(OptionError, match="no part 'aproach'; did you mean 'approach'"):
        send(fake, verified, part="aproach", transfers=transfers, clock=fake.clock)


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["start", "path", "connect"])
def test_a_tolerance_that_would_never_stop_an_arm_is_refused(name, value):
    with pytest.raises(OptionError, match=name):
        Tolerances(**{name: value})


E = 0.004  # rad, by which joints may deviate, and twice that for those of the right arm


@pytest.fixture(scope="module")
def certified():
    stated = {name: 2 * E if name.startswith("right") else E for name in baxter().joint_names}
    return verify_joints(uncertain_baxter(joints=stated), *known_carry()).verified


def test_tolerances_are_the_certified_deviations(certified):
    """By joint, for the controllers and for the watch; a start farther away than a hundredth is refused as ever."""
    fake = Fake(certified)
    send(fake, certified, clock=fake.clock)
    for joint in certified.robot.joint_names:
        own = 2 * E if joint.startswith("right") else E
        assert fake.tolerances.of("path", [joint]) == fake.tolerances.of("end", [joint]) == [own]
        assert fake.tolerances.of("start", [joint]) == [own]


@pytest.mark.parametrize(("joint", "allowed"), [("left_w0", E), ("right_w0", 2 * E)])
def test_a_joint_that_deviates_more_than_certified_stops_all(certified, joint, allowed):
    within = Fake(certified, [(3.0, shifted(joint, 0.99 * allowed))])
    assert send(within, certified, clock=within.clock).deviation == pytest.approx(0.99 * allowed)
    beyond = Fake(certified, [(3.0, shifted(joint, 1.01 * allowed))])
    with pytest.raises(SendError, match=rf"'{joint}' is .* off the motion \({allowed:g} allowed\)"):
        send(beyond, certified, clock=beyond.clock)


def test_narrower_tolerances_are_taken(certified):
    fake = Fake(certified, [(3.0, shifted("right_w0", 0.0021))])
    with pytest.raises(SendError, match=r"off the motion \(0\.002 allowed\)"):
        send(fake, certified, tolerances=Tolerances(path=0.002), clock=fake.clock)
    assert fake.tolerances.of("path", ["right_w0"]) == [0.002]


@pytest.mark.parametrize("name", ["start", "path", "end"])
@pytest.mark.parametrize("wide", [1.01 * E, {"left_w0": 1.01 * E}])
def test_wider_tolerances_are_refused_before_anything_is_sent(certified, name, wide):
    given = wide if isinstance(wide, float) else dict.fromkeys(certified.robot.joint_names, E) | wide
    fake = Fake(certified)
    with pytest.raises(
        OptionError, match=rf"tolerances\.{name}: 0\.00404 is wider than 0\.004.*give at most 0\.004"
    ):
        send(fake, certified, tolerances=Tolerances(**{name: given}), clock=fake.clock)
    assert not fake.calls


def test_tolerances_by_name_are_those_of_all_joints(certified):
    with pytest.raises(
        OptionError, match=r"tolerances\.path: '\w+' has none; give all joints', or one number"
    ):
        Tolerances(path={"left_w0": E}).certified(certified)


def test_without_certified_deviations_tolerances_are_the_usual_ones(verified):
    fake = Fake(verified)
    send(fake, verified, clock=fake.clock)
    assert [fake.tolerances.of(name, ["left_w0"]) for name in ("start", "path", "end")] == [
        [0.01],
        [0.2],
        [0.0],
    ]
