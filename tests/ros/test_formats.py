"""What all formats have in common: whole or not at all, nothing unverified, nothing overwritten, not too coarse."""

import os
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from comove.errors import ComoveError
from comove.robots import verify_joints, write_joints
from comove.ros import FORMATS, ExportError, check_export, export, parts_of, usual_format
from comove.ros.parts import PARTS, sampling_errors


def test_the_usual_format_is_one_that_the_robot_can_play(brief, monkeypatch):
    assert usual_format(brief) is FORMATS["baxter-csv"]
    monkeypatch.setattr("comove.ros.tables.ARMS", {"left": ("another_joint",), "right": ()})
    assert usual_format(brief) is FORMATS["csv"]


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.few(2)
def test_nothing_is_overwritten(verified, tmp_path, name):
    written = export(verified, tmp_path, FORMATS[name])
    assert sorted(tmp_path.iterdir()) == sorted(written)
    before = {path: path.stat().st_mtime_ns for path in written}
    with pytest.raises(ExportError, match="there already; name another folder"):
        export(verified, tmp_path, FORMATS[name])
    assert {path: path.stat().st_mtime_ns for path in written} == before


@pytest.mark.parametrize("name", FORMATS)
def test_nothing_is_left_half_written(verified, tmp_path, name):
    def full(path: Path, part, rate):
        FORMATS[name].write(path, part, rate)
        raise OSError(28, "No space left on device")

    with pytest.raises(ComoveError, match="cannot be written: the disk is full"):
        export(verified, tmp_path, replace(FORMATS[name], write=full))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.few(2)
def test_when_the_last_file_fails_none_stays(verified, transfers, tmp_path, monkeypatch, name):
    """Files get their names one by one when the disk holds them; one of them it does not hold."""
    folder, held, (sync, rename) = tmp_path / "new" / "files", [], (os.fsync, os.replace)

    def hold(what):
        held.append(what)
        if len(held) > 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", lambda number: (hold(number), sync(number)))

    def named(draft, path):
        if Path(path).parent == folder:
            hold(path)
        rename(draft, path)

    if name == "rosbag2":  # folders get their names without that
        monkeypatch.setattr(os, "replace", named)
    with pytest.raises(ComoveError, match="the disk is full"):
        export(verified, folder, FORMATS[name], transfers=transfers)
    assert len(held) > 2
    assert not folder.exists()


def test_a_file_that_somebody_else_made_meanwhile_stays(verified, tmp_path):
    theirs = tmp_path / "motion.npz"

    def late(path: Path, part, rate):
        FORMATS["npz"].write(path, part, rate)
        theirs.write_text("theirs")

    with pytest.raises(ExportError, match="there already"):
        export(verified, tmp_path, replace(FORMATS["npz"], write=late))
    assert theirs.read_text() == "theirs"


def test_a_full_disk_is_told_whatever_tells_of_it(verified, tmp_path, monkeypatch):
    """SQLite has errors of its own."""
    from comove.ros import bags

    def full(*_):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(bags, "_write", full)
    with pytest.raises(ComoveError, match="cannot be written: database or disk is full"):
        export(verified, tmp_path, FORMATS["rosbag2"])
    assert not list(tmp_path.iterdir())


def test_what_would_be_refused_is_told_before_transfers_are_planned(verified, tmp_path):
    check_export(verified, tmp_path / "new", rate=20, parts=PARTS)
    assert not (tmp_path / "new").exists()
    with pytest.raises(ExportError, match="20 Hz or more"):
        check_export(verified, tmp_path, rate=5)
    (tmp_path / "release.csv").write_text("theirs")
    check_export(verified, tmp_path)
    with pytest.raises(ExportError, match=r"release.csv: it is there already"):
        check_export(verified, tmp_path, parts=PARTS)


def test_numbers_of_numpy_are_rates(verified, tmp_path):
    export(verified, tmp_path, FORMATS["npz"], rate=np.int64(50))


@pytest.mark.parametrize("name", FORMATS)
def test_the_unverified_is_refused(verified, tmp_path, name):
    with pytest.raises(ExportError, match="JointMotion, not a verified one of joints"):
        export(verified.joints, tmp_path, FORMATS[name])
    assert not list(tmp_path.iterdir())


def test_coarse_rates_are_refused_with_what_they_would_do(verified, tmp_path):
    told = r"at 2 Hz .* up to 0\.\d+ mm \(cubic .* or 2\.\d+ mm \(linear\).*20 Hz or more"
    with pytest.raises(ExportError, match=told):
        export(verified, tmp_path, rate=2)
    for rate in (0, -1.0, float("nan"), float("inf"), 1e6, "100"):
        with pytest.raises(ExportError, match="between 20 and 1000 Hz"):
            export(verified, tmp_path, rate=rate)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("steps", "cubic", "linear"), [(200, 1e-3, 0.03), (50, 7e-3, 0.43), (20, 0.54, 2.5)])
def test_sampling_errors_are_those_that_were_measured(verified, steps, cubic, linear):
    """The table of shared/robots.md: steps over 10 s, change of the stick's length [mm]."""
    found = [1e3 * error for error in sampling_errors(verified, steps / 10)]
    assert found[0] < 3 * cubic and linear / 3 < found[1] < 3 * linear


def test_samples_are_even_and_rest_at_both_ends(verified):
    (part,) = parts_of(verified).values()
    for rate in (20.0, 33.0, 100.0, 1000.0):
        samples = part.samples(rate)
        assert (np.diff(samples.nanoseconds) > 0).all() and np.ptp(np.diff(samples.nanoseconds)) <= 1
        assert np.diff(samples.time).max() <= 1 / rate + 1e-9
        assert samples.time[-1] == part.joints.duration
        assert not samples.velocity[[0, -1]].any()
        assert (samples.position[[0, -1]] == part.joints.position[[0, -1]]).all()


@pytest.mark.parametrize("name", FORMATS)
def test_approach_and_release_come_with_every_format(verified, transfers, tmp_path, name):
    written = export(verified, tmp_path, FORMATS[name], transfers=transfers)
    assert sorted(tmp_path.iterdir()) == sorted(written)
    assert len(written) == (6 if FORMATS[name].sidecar else 3)


def test_checksums_are_those_of_the_result(verified, tmp_path):
    carry = verify_joints(verified.robot, verified.motion, verified.joints)
    summary = write_joints(tmp_path, verified.joints, carry, verified.robot, verified.motion.motion)
    told = parts_of(verified)["carry"].provenance.asdict()
    for name in ("scene_sha256", "robot_sha256", "motion_sha256", "joints_sha256"):
        assert told[name] == summary[name]


def test_transfers_of_another_motion_are_refused(brief, transfers, tmp_path):
    with pytest.raises(ExportError, match="not those of this motion; plan them for it"):
        export(brief, tmp_path, transfers=transfers)
    with pytest.raises(ExportError, match="not those of this motion"):
        export(brief, tmp_path, transfers=brief.joints)
    assert not list(tmp_path.iterdir())
