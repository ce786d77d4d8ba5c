"""Whatever file a reader is given, it answers soon and within a gigabyte, by a recording or by a sentence."""

import gzip
import json
import os
import random
import sqlite3
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from comove.dmp.demonstrations import write_lerobot, write_rosbag

h5py = pytest.importorskip("h5py")
pytest.importorskip("pyarrow")
pytest.importorskip("rosbags")
lz4 = pytest.importorskip("lz4.frame")

SECONDS, BYTES = 5, 2**30
READ = f"""
import resource, sys
from comove.dmp.demonstrations import Demonstration
from comove.errors import DemonstrationError
import h5py, lz4.frame, numpy, pyarrow.parquet, rosbags.rosbag1, rosbags.rosbag2
status = open("/proc/self/status").read()
own = 1024 * int(status.partition("VmData:")[2].split()[0])
resource.setrlimit(resource.RLIMIT_DATA, (own + {BYTES},) * 2)
resource.setrlimit(resource.RLIMIT_CPU, (int(sum(resource.getrusage(resource.RUSAGE_SELF)[:2])) + {SECONDS},) * 2)
try:
    print(len(Demonstration.load_all(sys.argv[1])), "read")
except DemonstrationError as error:
    print("told:", error)
print(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
"""


def zeros(path):
    with open(path, "wb") as file:
        file.truncate(2**28)


def endless(path):
    path.write_bytes(b"1" * 50_000_000)


def packed(path):
    path.write_bytes(gzip.compress(bytes(10**8)))


def noise(path):
    path.write_bytes(random.Random(0).randbytes(10**6))


def bomb_npz(path):
    """1 MB that unpacks to 1.6 GB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time", "position"):
            with archive.open(f"{name}.npy", "w") as file:
                header = {"descr": "<f8", "fortran_order": False, "shape": (10**8,)}
                np.lib.format.write_array_header_1_0(file, header)
                for _ in range(80):
                    file.write(bytes(10**7))


def chunk_hdf5(path):
    """Ten rows in a chunk of 1.7 GB."""
    with h5py.File(path, "w") as root:
        root.create_dataset(
            "observations/qpos", (10, 14), "f8", maxshape=(None, 14), chunks=(15_000_000, 14), compression=1
        )


def loop_hdf5(path):
    with h5py.File(path, "w") as root:
        root["data"] = h5py.SoftLink("/data")


def digits_hdf5(path):
    with h5py.File(path, "w") as root:
        root["data/demo_0/obs/robot0_eef_pos"] = np.ones((3, 3))
        root["data"].attrs.create("env_args", '{"env_kwargs": {"control_freq": 1' + "0" * 20_000 + "}}")


def bomb_mcap(path):
    """A chunk that unpacks to 4 GB."""

    def record(kind, body):
        return bytes([kind]) + struct.pack("<Q", len(body)) + body

    def text(words):
        return struct.pack("<I", len(words)) + words

    packer = lz4.LZ4FrameCompressor()
    data = packer.begin() + b"".join(packer.compress(bytes(10**7)) for _ in range(400)) + packer.flush()
    chunk = struct.pack("<QQQI", 0, 1, 4 * 10**9, 0) + text(b"lz4") + struct.pack("<Q", len(data)) + data
    parts = [
        record(1, text(b"ros2") + text(b"x")),
        record(6, chunk),
        record(15, bytes(4)),
        record(2, bytes(20)),
    ]
    magic = b"\x89MCAP0\r\n"
    path.write_bytes(magic + b"".join(parts) + magic)


ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x AS id"
VIEWS = {
    "messages": f"{ENDLESS}, 1 AS topic_id, x AS timestamp, zeroblob(100) AS data FROM c",
    "topics": f"{ENDLESS}, 't' AS name, 'a' AS type, 'cdr' AS serialization_format, "
    "'' AS offered_qos_profiles FROM c",
}


def view_db3(table):
    """A table that is a view without end."""

    def make(path, hand):
        write_rosbag(path, hand())
        with sqlite3.connect(path) as connection:
            connection.execute(f"ALTER TABLE {table} RENAME TO other")
            connection.execute(f"CREATE VIEW {table} AS {VIEWS[table]}")
        connection.close()

    return make


def aliases_folder(path, hand):
    """YAML that would grow to 9^9 entries."""
    write_rosbag(path, hand())
    lists = "a: &a [x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{', '.join([f'*{chr(97 + i)}'] * 9)}]\n" for i in range(9)
    )
    file = path / "metadata.yaml"
    file.write_text(lists + file.read_text())


def deep_dataset(path, hand):
    write_lerobot(path, [hand()])
    (path / "meta/info.json").write_text("[" * 1_000_000)


def pipe_dataset(path, hand):
    write_lerobot(path, [hand()])
    os.mkfifo(path / "pipe.parquet")
    file = path / "meta/info.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"data_path": "pipe.parquet"}))


HOSTILE = {
    **{f"{make.__name__}.{kind}": make for make in (zeros, endless, packed, noise)
       for kind in ("csv", "npz", "hdf5", "bag", "mcap", "db3")},
    "bomb.npz": bomb_npz,
    "chunk.hdf5": chunk_hdf5, "loop.hdf5": loop_hdf5, "digits.hdf5": digits_hdf5,
    "bomb.mcap": bomb_mcap,
    "messages.db3": view_db3("messages"), "topics.db3": view_db3("topics"),
    "aliases": aliases_folder, "deep": deep_dataset, "pipe": pipe_dataset,
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="the limits are Linux's")
@pytest.mark.few(4)
def test_every_reader_answers_soon_and_within_bounds(name, tmp_path, hand):
    make = HOSTILE[name]
    make(*(tmp_path / name, hand)[: make.__code__.co_argcount])
    done = subprocess.run(
        [sys.executable, "-c", READ, tmp_path / name], capture_output=True, text=True, timeout=600
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr[-500:]
    *answer, peak = done.stdout.splitlines()
    if name == "aliases":  # which share what they name: nothing grows
        assert answer == ["1 read"]
    else:
        assert answer[0].startswith("told: ") and len(done.stdout) < 1000
    assert int(peak) < 2 * BYTES / 1024
