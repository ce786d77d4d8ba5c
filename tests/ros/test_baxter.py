"""Baxter's playback file, read as the SDK reads it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from comove.ros import FORMATS, ExportError, export, parts_of
from comove.ros.tables import require_baxter
from tests.ros.playback import play, require_playable

BAXTER = FORMATS["baxter-csv"]


@pytest.fixture(scope="module")
def file(verified, tmp_path_factory):
    path, _ = export(verified, tmp_path_factory.mktemp("baxter"), BAXTER)
    return path


def measured(verified, off=0.1):
    return dict(zip(verified.joints.joint_names, verified.joints.position[0] + off, strict=True))


def test_the_sdk_plays_what_was_verified(verified, file):
    goals, delay = play(file, measured(verified))
    require_playable(goals)
    assert delay == pytest.approx(0.4)
    for side in ("left", "right"):
        time, position = zip(*goals[side].points[1:], strict=True)
        columns = [verified.joints.joint_names.index(name) for name in goals[side].names]
        exact = verified.joints.curve(np.array(time) - delay)[:, columns]
        assert np.abs(np.array(position) - exact).max() < 1e-12
        assert all(opening == [0.0] for _, opening in goals[f"{side}_gripper"].points)
    assert file.name == "baxter.csv"


def test_the_file_is_plain(file):
    text = file.read_text(encoding="ascii")
    assert text.splitlines()[0].startswith(
        "time,left_s0,left_s1,left_e0,left_e1,left_w0,left_w1,left_w2,left_gripper,"
    )
    assert " " not in text and "#" not in text and "\r" not in text and ",," not in text
    assert text.endswith("\n") and not text.endswith("\n\n")
    assert len(text.splitlines()) == 1002


def test_the_reader_of_these_tests_is_as_strict_as_the_sdk(verified, file, tmp_path):
    """What spoils a file on the robot spoils it here."""
    text = file.read_text(encoding="ascii")
    spoilt = {
        "comment": "# made for you\n" + text,
        "blank last line": text + "\n",
        "empty cell": text.replace("0.0", "", 3),
        "one gripper": text.replace("right_gripper", "gripper", 1),
    }
    for name, wrong in spoilt.items():
        path = tmp_path / name
        path.write_text(wrong, encoding="ascii")
        with pytest.raises((KeyError, TypeError, ValueError)):
            play(path, measured(verified))
    path.write_text(text.replace(",left_w2", ", left_w2", 1), encoding="ascii")
    with pytest.raises(AssertionError):
        require_playable(play(path, measured(verified))[0])


def test_provenance_stands_beside_the_file(verified, file):
    told = json.loads(file.with_name("baxter.csv.json").read_text(encoding="utf-8"))
    assert told["scene_sha256"] == verified.scene.sha256
    assert told["robot_sha256"] == verified.robot.sha256
    assert len(told["motion_sha256"]) == 64
    assert told["part"] == "carry" and told["rate_hz"] == 100.0 and told["duration_s"] == 10.0


@pytest.mark.parametrize(
    ("rename", "message"),
    [
        (("left_s0", "arm_1"), "has no joint 'left_s0'.*choose another format"),
        (None, "a joint 'torso' that a Baxter"),
    ],
)
def test_other_robots_are_refused(verified, rename, message):
    (part,) = parts_of(verified).values()
    names, position = list(part.joints.joint_names), part.joints.position
    if rename:
        names[names.index(rename[0])] = rename[1]
    else:
        names, position = [*names, "torso"], np.column_stack([position, position[:, 0]])
    joints = replace(part.joints, joint_names=tuple(names), position=position)
    with pytest.raises(ExportError, match=message):
        require_baxter(replace(part, joints=joints))


def test_approach_and_release_are_files_of_their_own(verified, transfers, tmp_path):
    paths = export(verified, tmp_path, BAXTER, transfers=transfers)
    assert [path.name for path in paths[:3]] == ["baxter.csv", "approach.csv", "release.csv"]
    joints = verified.joints.joint_names
    at = dict(zip(joints, verified.robot.home, strict=True))
    grippers = {}
    for name in ("approach", "baxter", "release"):
        goals, delay = play(tmp_path / f"{name}.csv", {joint: q + 1e-5 for joint, q in at.items()})
        require_playable(goals)
        assert delay == pytest.approx(1e-5 / 0.25), "one begins where the other ended"
        for side in ("left", "right"):
            at |= zip(goals[side].names, goals[side].points[-1][1], strict=True)
        grippers[name] = [opening for _, (opening,) in goals["left_gripper"].points]
    assert [at[name] for name in joints] == verified.robot.home.tolist()
    closed = [k for k, opening in enumerate(grippers["approach"]) if opening == 0.0]
    moving = np.abs(np.diff(transfers.approach.position, axis=0)).max(axis=1) > 0
    assert closed[0] >= np.flatnonzero(moving)[-1] + 1, "hands close when they are there"
    assert closed == list(range(closed[0], len(grippers["approach"])))
    assert len(closed) == 101
    assert set(grippers["baxter"]) == {0.0} and set(grippers["release"]) == {100.0}
    assert json.loads((tmp_path / "release.csv.json").read_text(encoding="utf-8"))["part"] == "release"
