"""CSV and NPZ, read by readers that know nothing of comove."""

import csv
import json

import numpy as np

from comove.ros import FORMATS, export, parts_of


def test_csv_reads_back_bit_by_bit(verified, tmp_path):
    path, sidecar = export(verified, tmp_path, FORMATS["csv"], rate=50.0)
    with open(path, encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    samples = parts_of(verified)["carry"].samples(50.0)
    assert len(rows) == 501 and [float(row["time"]) for row in rows] == samples.time.tolist()
    for kind in ("position", "velocity", "acceleration"):
        table = [[float(row[f"{joint}.{kind}"]) for joint in verified.robot.joint_names] for row in rows]
        assert (np.array(table) == getattr(samples, kind)).all()
    assert json.loads(sidecar.read_text(encoding="utf-8"))["scene_sha256"] == verified.scene.sha256


def test_npz_reads_back_bit_by_bit(verified, tmp_path):
    (path,) = export(verified, tmp_path, FORMATS["npz"])
    samples = parts_of(verified)["carry"].samples(100.0)
    with np.load(path, allow_pickle=False) as arrays:
        for kind in ("time", "position", "velocity", "acceleration"):
            assert (arrays[kind] == getattr(samples, kind)).all()
        assert tuple(arrays["joint_names"]) == verified.robot.joint_names
        assert str(arrays["robot_sha256"]) == verified.robot.sha256
        assert str(arrays["comove"])
