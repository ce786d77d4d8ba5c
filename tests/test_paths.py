"""Whatever a path leads to, who reads or writes there answers in one sentence of his own, and soon."""

import os
import signal
import warnings
from contextlib import contextmanager
from functools import partial

import pytest

from comove.dmp import DMP, Library, Primitive, read_primitive, write_primitive
from comove.dmp.demonstrations import (
    Demonstration,
    read_csv,
    read_hdf5,
    read_lerobot,
    read_npz,
    read_rosbag,
    write_csv,
    write_lerobot,
    write_npz,
    write_rosbag,
)
from comove.dmp.demonstrations.formats import hdf5, lerobot
from comove.errors import ComoveError
from comove.io.folders import check_target
from comove.lab.bench.store import RunStore
from comove.model import Scene
from comove.results import RESULT, read_result
from comove.robots import Robot, read_joints
from comove.sim import SIMULATION

KINDS = ("", ".csv", ".npz", ".hdf5", ".bag", ".mcap", ".db3", ".json", ".yaml", ".dmp.json", ".sqlite")
DEMO = Demonstration([0.0, 1.0, 2.0], [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]])
PRIMITIVE = Primitive("p", DMP.fit(DEMO, n_basis=2))


def add_to_library(path):
    Library(path).add(PRIMITIVE)


def show_library(path):
    Library(path).get("p")


READERS = [
    Demonstration.load,
    Demonstration.load_all,
    read_csv,
    read_npz,
    read_hdf5,
    read_rosbag,
    read_lerobot,
]
READERS += [
    hdf5.episodes,
    lerobot.episodes,
    Scene.load,
    read_primitive,
    show_library,
    read_result,
    read_joints,
]
READERS += [SIMULATION.read, Robot.load, RunStore.open]
WRITERS = {
    "csv": lambda path: write_csv(path, DEMO),
    "npz": lambda path: write_npz(path, DEMO),
    "bag": lambda path: write_rosbag(path, Demonstration([0, 1], [[0, 0, 0], [1, 1, 1]])),
    "lerobot": lambda path: write_lerobot(path, Demonstration([0, 1], [[0, 0, 0], [1, 1, 1]])),
    "primitive": lambda path: write_primitive(path, PRIMITIVE),
    "library": add_to_library,
    "folder": partial(check_target, contents=RESULT),
    "store": RunStore.create,
}
# What a path may lead to, that no reader can use.
MAKERS = {
    "nothing": lambda path: None,
    "a folder": os.mkdir,
    "a pipe": os.mkfifo,
    "a link to itself": lambda path: os.symlink(path.name, path),
    "a link to nowhere": lambda path: os.symlink("nowhere", path),
    "a link to zeros": lambda path: os.symlink("/dev/zero", path),
    "an empty file": lambda path: path.write_bytes(b""),
    "zeros": lambda path: path.write_bytes(b"\0" * 3000),
    "byte order marks": lambda path: path.write_bytes(b"\xef\xbb\xbf" * 2 + b"{}"),
    "bytes": lambda path: path.write_bytes(bytes(range(256)) * 20),
    "half an archive": lambda path: path.write_bytes(b"PK\x03\x04" + bytes(range(200))),
    "depth": lambda path: path.write_text("[" * 100_000),
    "one line": lambda path: path.write_text("1," * 600_000),
}
NAMES = [
    "x" * 300,
    "x" * 5000,
    "a/" * 3000,
    "a\0b",
    "a\nb",
    os.fsdecode(b"caf\xe9"),
    "\ud800",
    "",
    ".",
    "..",
    "/",
    "~",
]


@contextmanager
def answered(seconds=10, wait=120):
    """The block ends by itself, or by an error of ours that can be read.

    It has so many seconds of processor time, and longer on the wall, as other programs may have the processor.
    """

    def ring(*_):
        pytest.fail(f"no answer in {seconds} s of processor time, or {wait} s")

    before = [signal.signal(number, ring) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(wait)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except ComoveError as error:
        assert str(error)
        assert len(str(error)) < 2000
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.alarm(0)
        for number, handler in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, handler)


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__qualname__)
def test_whatever_there_is(tmp_path, read, make):
    for kind in KINDS:
        path = tmp_path / f"a{kind}"
        make(path)
        with answered():
            read(path)
            pytest.fail(f"{path.name} was read")


@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__qualname__)
def test_whatever_it_is_called(tmp_path, monkeypatch, read):
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        for kind in ("", ".csv", ".npz", ".yaml"):
            with answered():
                read(name + kind)
                pytest.fail(f"{name} was read")


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_whatever_is_in_the_way(tmp_path, write, make):
    for kind in ("", ".csv", ".bag"):
        path = tmp_path / f"a{kind}"
        make(path)
        with answered():
            write(path)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_whatever_is_to_be_written(tmp_path, monkeypatch, write):
    monkeypatch.chdir(tmp_path)
    for name in ("x" * 300, "x" * 5000, "a/" * 3000, "a\0b", "a\nb", os.fsdecode(b"caf\xe9"), "\ud800"):
        for kind in ("", ".csv", ".bag"):
            with answered():
                write(name + kind)
    for path in tmp_path.rglob("*"):
        assert not path.name.endswith(".part")
