"""Recordings of other programs, learned by `comove learn`.

One movement is written in the layouts of trackers, simulators, ROS tools, spreadsheets and scripts. Each file is
given to `comove learn FILE --out OUT.json` without further options; where that is refused with a command, the command
is run as it was printed; `HZ` and `UNIT`, its placeholders for missing data, are replaced by the true
values. The learned movement is compared with an independent reading: the numbers that were written, or what
rosbags, pyarrow and h5py read.

- right: the numbers are those of the file, without options or with the printed command
- refused: the file has no movement that could be read, and the message says why
- asked: of a file of others, the command has `HZ` or `UNIT`, which only its documentation tells
- WRONG: other numbers, a movement where there is none, a refusal without a command that works, or a traceback

    python benchmarks/recordings.py [--only NAME ...] [--files FOLDER]

With `--files`, the files of a folder are learned instead. Of a text table, each coordinate is searched among the
columns of its numbers; of other files, the table shows the movement.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
from numpy.typing import NDArray
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from timing import on_one_thread, print_head, print_row
from typer.testing import CliRunner

from comove.cli.app import whole_application
from comove.cli.recordings import Reading
from comove.dmp import read_primitive
from comove.dmp.demonstrations import Demonstration
from comove.dmp.files import checksum
from comove.dmp.recordings import read_recording

Array = NDArray[np.float64]

N, RATE = 201, 100
T = np.arange(N) / RATE
S = T / T[-1]
P = np.column_stack([0.3 * S**3 * (10 - 15 * S + 6 * S**2), 0.1 * np.sin(np.pi * S), 0.2 + 0.05 * T])  # m
R = Rotation.from_rotvec(np.outer(0.4 * T, [0.2, 0.3, 0.9]))
J = np.column_stack([0.5 * S**2, -0.8 * S, 1.2 * S**3])  # rad
XYZW, WXYZ = R.as_quat(), R.as_quat()[:, [3, 0, 1, 2]]
MM, DEG = 1e3 * P, np.degrees(J)
FRAME, BEGIN = np.arange(N), 1_700_000_000_000_000_000
NS = BEGIN + 10_000_000 * FRAME
GRIPPER = np.where(T > 1.0, 0.04, 0.0)
MOST_COMMANDS = 4
BINARY = (".bag", ".db3", ".mcap")
NUMBER = re.compile(r"[-+]?[0-9]*\.?[0-9]+\.?([eE][-+]?[0-9]+)?")
KNOWN = {"HZ": str(RATE), "UNIT": "m"}
"""What somebody who recorded the layouts writes for these words; units of some files by their names."""


@dataclass(frozen=True)
class Movement:
    """Content of a file, read without comove. Joints have names, end effectors may have orientations."""

    position: Array = field(default_factory=lambda: P)
    turn: Rotation | None = None
    time: Array = field(default_factory=lambda: T)
    axes: tuple[str, ...] = ()


HAND, POSE, ARM = Movement(), Movement(turn=R), Movement(J, axes=("j1", "j2", "j3"))
Truth = Movement | str | Callable[[Path], Movement]
"""A movement, a function that reads it by other means, or what a refusal has to say."""
Write = str | bytes | Callable[[Path], None]
LAYOUTS: dict[str, tuple[Write, Truth]] = {}


def main() -> None:
    """Print a row for each layout, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", default=[])
    parser.add_argument("--files", metavar="FOLDER", type=Path)
    asked = parser.parse_args()
    on_one_thread()
    print_head(("recording", "verdict", "printed"))
    sums: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        for path, truth in own_files(asked.only) if asked.files is None else files_of(asked.files):
            verdict, printed = judged(path, truth, KNOWN if asked.files is None else {})
            sums[verdict.partition(":")[0]] += 1
            print_row((path.name, verdict, " ".join(printed.split()).replace("|", "\\|")))
    print(f"\n{sum(sums.values())} recordings: " + ", ".join(f"{n} {what}" for what, n in sums.items()))
    sys.exit(bool(sums["WRONG"]))


def own_files(only: Sequence[str]) -> Iterator[tuple[Path, Truth]]:
    """Write each layout; yield its file and content."""
    for name, (write, truth) in LAYOUTS.items():
        if only and name not in only:
            continue
        path = Path(name)
        if callable(write):
            write(path)
        else:
            path.write_bytes(write.encode() if isinstance(write, str) else write)
        yield path, truth


def files_of(folder: Path) -> Iterator[tuple[Path, Truth]]:
    """Yield the recordings of a folder, with independently read numbers."""
    for path in sorted(folder.iterdir()):
        if not path.name.startswith("."):
            yield path.resolve(), columns_of


# Learning as it is typed.


def judged(path: Path, truth: Truth, known: Mapping[str, str]) -> tuple[str, str]:
    """Return the result of a recording, and the last printed output. `known` holds the values of placeholders."""
    out = f"learned-{path.name}.json"
    words = ["comove", "learn", str(path), "--out", out]
    for n_commands in range(MOST_COMMANDS):
        result = CliRunner().invoke(whole_application(), words[1:])
        if result.exit_code not in (0, 2):
            return f"WRONG: exit code {result.exit_code}", result.output
        if result.exit_code == 0:
            fault = fault_of(path, words, truth)
            how = ("without options", "with the printed command", "with a second command")[min(n_commands, 2)]
            return (f"WRONG: {fault}" if fault else f"right {how}"), said(result.output, out)
        found = re.search(r"; run: (comove learn .*?)(?: \(comove explain \w+\))?\s*$", result.output)
        if isinstance(truth, str) and (found is None or n_commands or re.search(truth, result.output)):
            is_told = re.search(truth, result.output) is not None
            return ("refused" if is_told else f"WRONG: it does not say {truth!r}"), result.output
        if found is None:
            return ("refused" if truth is columns_of else "WRONG: refused without a command"), result.output
        words = shlex.split(found[1])
        unit = known.get(path.name, known.get("UNIT", "UNIT"))
        words = [{"HZ": known.get("HZ", "HZ"), "UNIT": unit}.get(word, word) for word in words]
        if "HZ" in words or any("UNIT" in re.split(r"\W", word) for word in words):
            return "asked", result.output
    return "WRONG: commands without end", result.output


def said(output: str, out: str) -> str:
    """Return the line on the chosen movement."""
    notes = re.findall(r"(?m)^ +(time (?:from|at) .*)$", output)
    return notes[0] if notes else output.replace(out, "")[-200:]


def fault_of(path: Path, words: Sequence[str], truth: Truth) -> str:
    """Return how the learned movement differs from the truth; else ""."""
    if isinstance(truth, str):
        return "there is no movement in it"
    options: dict[str, Any] = {}
    rest = iter(words[3:])
    for word in rest:
        key = word.removeprefix("--").replace("-", "_")
        options[key] = True if key in ("drop_missing", "clean") else next(rest)
    primitive = read_primitive(Path(options.pop("out")))
    if "rate" in options:
        options["rate"] = float(options["rate"])
    taken = read_recording(str(path), **Reading(**options).arguments).demonstration
    if primitive.provenance is None or primitive.provenance.sha256 != checksum(taken):
        return "the primitive was learned from other numbers"
    held = truth(path) if callable(truth) else truth
    return differences(taken, held)


def differences(taken: Demonstration, held: Movement) -> str:
    """Return how two movements differ beyond rounding; else ""."""
    if held.axes == ("any",):
        return unknown_columns(taken, held)
    if taken.is_joints != bool(held.axes):
        return f"{'joints' if taken.is_joints else 'a path'} in {taken.unit}"
    if taken.position.shape != held.position.shape:
        return f"shape {taken.position.shape} instead of {held.position.shape}"
    for what, one, other in (("time", taken.time, held.time), ("position", taken.position, held.position)):
        if not np.allclose(one, other, rtol=0, atol=2e-7):
            return f"{what} off by {np.abs(one - other).max():.3g}"
    if (taken.orientation is None) != (held.turn is None):
        return f"{'an' if held.turn is None else 'no'} orientation"
    if held.turn is not None and taken.rotation is not None:
        off = (taken.rotation * held.turn.inv()).magnitude().max()
        return f"turned by {off:.3g} rad" if off > 1e-6 else ""
    return ""


def columns_of(path: Path) -> Movement:
    """Return all columns of numbers of a text. Its lines are split at any mark; other files have none."""
    try:
        text = path.read_bytes().decode() if path.is_file() and path.suffix not in BINARY else ""
    except UnicodeDecodeError:
        text = ""
    rows = [re.split(r"\s*[;,\t]\s*|\s+", line.strip()) for line in text.splitlines()]
    width = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    cells = [row for row in rows if len(row) == width]
    numbers = []
    for column in zip(*cells, strict=True):
        numbers.append([float(cell) if NUMBER.fullmatch(cell) else np.nan for cell in column])
    return Movement(np.array(numbers).T.reshape(len(cells), len(numbers)), axes=("any",))


def unknown_columns(taken: Demonstration, held: Movement) -> str:
    """Return coordinates that are no column of a text in any unit. It is "" if all are, or it is no text."""
    for k, values in enumerate(taken.position.T):
        scales = (1.0, 0.1, 0.01, 1e-3, 1e-6, np.pi / 180)
        are_all = len(values) > len(held.position) - 5  # else rows were left out, or merged
        near = 1e-6 if are_all else 0.3 * np.ptp(values)
        ends = [column[np.isfinite(column)] for column in held.position.T]
        close = (
            abs(one.max() * scale - values.max()) < near and abs(one.min() * scale - values.min()) < near
            for one in ends
            if len(one) > 1
            for scale in scales
        )
        if held.position.size and not any(close):
            return f"coordinate {k} is no column"
    return ""


# Text tables.


def rows(*columns: Any, separator: str = ",", comma: bool = False, end: str = "\n") -> str:
    """Return rows of columns: arrays of numbers, or lists of texts."""
    cells: list[list[str]] = []
    for column in columns:
        table = np.asarray(column)
        if table.dtype.kind == "f":
            cells += [[f"{x:.12g}" for x in values] for values in np.atleast_2d(table.T)]
        else:
            cells.append([str(value) for value in column])
    text = "".join(separator.join(row) + end for row in zip(*cells, strict=True))
    return text.replace(".", ",") if comma else text


def line(*names: str, separator: str = ",") -> str:
    """Return a row of names, some of them of three axes. Examples are `pos_{xyz}` and `q{xyzw}`."""
    spelt = []
    for name in names:
        found = re.search(r"\{(\w+)\}", name)
        spelt += [name.replace(found[0], axis) for axis in found[1]] if found else [name]
    return separator.join(spelt) + "\n"


def clock(form: str, shift: float = 0.0) -> list[str]:
    """Return times of the day within a minute as text."""
    return [form.format(f"{second + shift:09.6f}") for second in T]


OWN = line("time", "{xyz}")
MOTIVE = (
    "Format Version,1.24,Take Name,reach,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,"
    "Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global\n\n"
)


def motive(*bodies: str) -> str:
    """Return the header of an OptiTrack Motive export with rigid bodies."""
    each = len(bodies)
    return MOTIVE + "".join(
        (
            line("", "Type", *["Rigid Body"] * 8 * each),
            line("", "Name", *(body for body in bodies for _ in range(8))),
            line("", "ID", *(f"{k:032X}" for k in range(each) for _ in range(8))),
            line("", "", *(["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]) * each),
            line("Frame", "Time (Seconds)", *[*"XYZWXYZ", ""] * each),
        )
    )


TRC = (
    "PathFileType\t4\t(X/Y/Z)\treach.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100.00\t100.00\t201\t1\tmm\t100.00\t1\t201\nFrame#\tTime\tHand\t\t\n\t\tX1\tY1\tZ1\n\n"
)
QTM = "NO_OF_FRAMES\t201\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t1\nFREQUENCY\t100\nMARKER_NAMES\thand\n"
QTM_6D = "NO_OF_FRAMES\t201\nNO_OF_BODIES\t1\nFREQUENCY\t100\nBODY_NAMES\thand\n"
STO = "reach\nversion=1\nnRows=201\nnColumns=4\ninDegrees=yes\nendheader\n"
MATRICES = np.concatenate([R.as_matrix(), P[:, :, None]], axis=2).reshape(N, 12)
FULL = np.concatenate([MATRICES, np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))], axis=1)
BY_COLUMNS = FULL.reshape(N, 4, 4).transpose(0, 2, 1).reshape(N, 16)
HEADER = line("%time", "field.header.seq", "field.header.stamp", "field.header.frame_id").strip()
LOST = [("" if 50 <= i < 60 else f"{x:.9g}") for i, x in enumerate(P[:, 0])]
KEPT = np.r_[:50, 60:N]

LAYOUTS |= {
    # Separators, decimals, encodings.
    "own.csv": (OWN + rows(T, P), HAND),
    "semicolons.csv": (OWN.replace(",", ";") + rows(T, P, separator=";"), HAND),
    "tabs.tsv": (OWN.replace(",", "\t") + rows(T, P, separator="\t"), HAND),
    "blanks.txt": (OWN.replace(",", "   ") + rows(T, P, separator="   "), HAND),
    "pipes.csv": (OWN.replace(",", " | ") + rows(T, P, separator=" | "), HAND),
    "german.csv": ("Zeit (s);X (mm);Y (mm);Z (mm)\n" + rows(T, MM, separator=";", comma=True), HAND),
    "commas-tabs.txt": ("t\tx\ty\tz\n" + rows(T, P, separator="\t", comma=True), HAND),
    "commas-blanks.txt": ("t x y z\n" + rows(T, P, separator=" ", comma=True), HAND),
    "excel.csv": ("sep=;\n" + OWN.replace(",", ";") + rows(T, P, separator=";", comma=True), HAND),
    "windows.csv": (("\ufeff" + OWN.strip() + "\r\n" + rows(T, P, end="\r\n")), HAND),
    "utf16.csv": ((OWN + rows(T, P)).encode("utf-16"), HAND),
    "latin1.csv": (("time,x,y,z,note\n" + rows(T, P, ["Größe"] * N)).encode("latin-1"), HAND),
    "quoted.csv": ('"time","x","y","z"\n' + rows(T, P), HAND),
    "trailing.csv": ("time,x,y,z,\n" + rows(T, P, end=",\n"), HAND),
    "upper.CSV": ("TIME,POS_X,POS_Y,POS_Z\n" + rows(T, P), HAND),
    "no-suffix.log": (OWN + rows(T, P), HAND),
    # Headers and preambles.
    "hash.txt": ("#time x y z\n" + rows(T, P, separator=" "), HAND),
    "hash-commas.csv": ("# time, x, y, z\n" + rows(T, P), HAND),
    "matlab.txt": ("% time [s]  x [cm]  y [cm]  z [cm]\n" + rows(T, 100 * P, separator=" "), HAND),
    "savetxt.txt": (rows(T, P, separator=" "), HAND),
    "savetxt-e.csv": ("".join(f"{','.join(f'{v:.18e}' for v in r)}\n" for r in np.c_[T, P]), HAND),
    "preamble.csv": ("recorded by us\nrate: 100 Hz\nunits: mm\n\nX,Y,Z\n" + rows(MM), HAND),
    "hash-preamble.csv": ("# robot: arm\n# rate: 100\n# length unit: mm\n" + OWN + rows(T, MM), HAND),
    "pandas.csv": (",time,x,y,z\n" + rows(FRAME, T, P), HAND),
    "pandas-levels.csv": (",pos,pos,pos\n,x,y,z\ntime,,,\n" + rows(T, P), HAND),
    "units-row.csv": ("t,x,y,z\ns,mm,mm,mm\n" + rows(T, MM), HAND),
    "units-differ.csv": (
        "t (ms),x [mm],y [m],z [cm]\n" + rows(1e3 * T, MM[:, 0], P[:, 1], 100 * P[:, 2]),
        HAND,
    ),
    "units-inch.csv": (line("time (s)", "{XYZ} (in)") + rows(T, P / 0.0254), HAND),
    # Times.
    "seconds.csv": ("Time (Seconds),X (Meters),Y (Meters),Z (Meters)\n" + rows(T, P), HAND),
    "time_ms.csv": ("time_ms,x,y,z\n" + rows(10 * FRAME, P), HAND),
    "t_s.csv": ("t_s,x_m,y_m,z_m\n" + rows(T, P), HAND),
    "elapsed.csv": ("elapsed (µs),x,y,z\n" + rows(10_000 * FRAME, P), HAND),
    "ms.csv": (OWN + rows(10 * FRAME, P), HAND),
    "ns.csv": ("timestamp,x,y,z\n" + rows(10_000_000 * FRAME, P), HAND),
    "epoch.csv": (OWN + rows([f"{ns // 10**9}.{ns % 10**9:09d}" for ns in NS], P), HAND),
    "epoch-ms.csv": ("stamp,x,y,z\n" + rows(NS // 10**6, P), HAND),
    "epoch-ns.csv": ("timestamp,x,y,z\n" + rows(NS, P), HAND),
    "secs.csv": ("secs,nsecs,x,y,z\n" + rows(NS // 10**9, NS % 10**9, P), HAND),
    "usec.csv": ("sec,usec,x,y,z\n" + rows(NS // 10**9, NS % 10**9 // 1000, P), HAND),
    "stamp_ns.csv": ("stamp_s,stamp_ns,x,y,z\n" + rows(NS // 10**9, NS % 10**9, P), HAND),
    "index.csv": (",x,y,z\n" + rows(T, P), HAND),
    "minutes.csv": (OWN + rows([text[3:] for text in clock("10:00:{}")], P), HAND),
    "iso.csv": (OWN + rows(clock("2024-05-01 10:00:{}"), P), HAND),
    "iso-z.csv": (OWN + rows(clock("2024-05-01T10:00:{}Z"), P), HAND),
    "iso-zone.csv": (OWN + rows(clock("2024-05-01T10:00:{}+02:00"), P), HAND),
    "day.csv": (OWN + rows(clock("23:59:{}", 56.5), P), HAND),
    "slashes.csv": (OWN + rows(clock("05/01/2024 10:00:{}"), P), HAND),
    "frames-only.csv": ("Frame,X,Y,Z\n" + rows(FRAME, P), HAND),
    "frames-as-time.csv": (OWN + rows(FRAME, P), HAND),
    "no-time.csv": (line("{xyz}") + rows(P), HAND),
    "two-times.csv": ("t,stamp,x,y,z\n" + rows(T, NS, P), HAND),
    "two-clocks.csv": ("t,stamp,x,y,z\n" + rows(T, 2 * T, P), HAND),
    # Programs.
    "tum.txt": ("# timestamp tx ty tz qx qy qz qw\n" + rows(T + 5, P, XYZW, separator=" "), POSE),
    "tum-bare.txt": (rows([f"{ns // 10**9}.{ns % 10**9:09d}" for ns in NS], P, XYZW, separator=" "), POSE),
    "euroc.csv": (
        line("#timestamp [ns]", "p_RS_R_{xyz} [m]", "q_RS_{wxyz} []", "v_RS_R_{xyz} [m s^-1]")
        + rows(NS, P, WXYZ, P),
        POSE,
    ),
    "euroc-bare.csv": (rows(NS, P, WXYZ), POSE),
    "kitti.txt": (rows(MATRICES, separator=" "), POSE),
    "rostopic.csv": (
        HEADER
        + line("", "field.pose.position.{xyz}", "field.pose.orientation.{xyzw}")
        + rows(NS, FRAME, NS, ["base"] * N, P, XYZW),
        POSE,
    ),
    "rostopic-pose.csv": (
        line("%time", "field.position.{xyz}", "field.orientation.{xyzw}") + rows(NS, P, XYZW),
        POSE,
    ),
    "rostopic-odom.csv": (
        HEADER
        + line(
            "",
            "field.child_frame_id",
            "field.pose.pose.position.{xyz}",
            "field.pose.pose.orientation.{xyzw}",
            "field.pose.covariance0",
            "field.twist.twist.linear.{xyz}",
            "field.twist.twist.angular.{xyz}",
        )
        + rows(NS, FRAME, NS, ["odom"] * N, ["base"] * N, P, XYZW, 0 * T, P, P),
        POSE,
    ),
    "rostopic-joints.csv": (
        HEADER
        + line("", *(f"field.{what}{k}" for what in ("name", "position", "velocity") for k in range(3)))
        + rows(NS, FRAME, NS, [""] * N, *([f"j{k}"] * N for k in (1, 2, 3)), J, J),
        ARM,
    ),
    "ros2-echo.csv": (rows(NS // 10**9, NS % 10**9, ["base"] * N, P, XYZW), POSE),
    "plotjuggler.csv": (
        line("__time", "/ee/pose/position/{xyz}", "/ee/pose/orientation/{xyzw}") + rows(T, P, XYZW),
        POSE,
    ),
    "motive.csv": (motive("Hand") + rows(FRAME, T, XYZW, MM, 0 * T), POSE),
    "motive-two.csv": (
        motive("Left", "Right") + rows(FRAME, T, XYZW, MM, 0 * T, XYZW, MM + 150, 0 * T),
        POSE,
    ),
    "vicon.csv": (
        "Objects\n100\n,,Global Angle (Quaternion) Hand:Hand,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n"
        ",,,,,,mm,mm,mm\n" + rows(FRAME + 1, 0 * FRAME, XYZW, MM),
        POSE,
    ),
    "vicon-markers.csv": (
        "Trajectories\n100\n,,hand:M1,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
        + rows(FRAME + 1, 0 * FRAME, MM),
        HAND,
    ),
    "qtm.tsv": (QTM + "Frame\tTime\thand X\thand Y\thand Z\n" + rows(FRAME, T, MM, separator="\t"), HAND),
    "qtm-bare.tsv": (QTM + rows(MM, separator="\t"), HAND),
    "qtm-6d.tsv": (
        QTM_6D
        + line(
            "Frame",
            "Time",
            "hand {XYZ}",
            "Roll",
            "Pitch",
            "Yaw",
            "Residual",
            "Rot[{012345678}]",
            separator="\t",
        )
        + rows(
            FRAME,
            T,
            MM,
            R.as_euler("xyz", degrees=True),
            0 * T,
            R.as_matrix().transpose(0, 2, 1).reshape(N, 9),
            separator="\t",
        ),
        POSE,
    ),
    "opensim.trc": (TRC + rows(FRAME + 1, T, MM, separator="\t"), HAND),
    "opensim.mot": (STO + "time\telbow_flex\twrist_flex\tarm_rot\n" + rows(T, DEG, separator="\t"), ARM),
    "ur.csv": (
        line("timestamp", "actual_TCP_pose_{012345}", "actual_q_{012345}", separator=" ")
        + rows(T, P, R.as_rotvec(), np.zeros((N, 6)), separator=" "),
        POSE,
    ),
    "franka.csv": (line("time", *(f"O_T_EE[{k}]" for k in range(16))) + rows(T, BY_COLUMNS), POSE),
    "vive.csv": (line("timestamp", "{xyz}", "q{wxyz}", "trigger") + rows(T, P, WXYZ, GRIPPER), POSE),
    "unity.csv": (line("Timestamp", "HandPos{XYZ}", "HandRot{XYZW}") + rows(T, P, XYZW), POSE),
    "phone.csv": (line("t", "t{xyz}", "q{xyzw}") + rows(T, P, XYZW), POSE),
    # What stands beside positions.
    "rpy.csv": (line("time", "{xyz}", "roll", "pitch", "yaw") + rows(T, P, R.as_euler("xyz")), POSE),
    "rpy-deg.csv": (
        line("time", "{xyz}", "roll [deg]", "pitch [deg]", "yaw [deg]") + rows(T, P, R.as_euler("xyz", True)),
        POSE,
    ),
    "rotvec.csv": (line("time", "{xyz}", "r{xyz}") + rows(T, P, R.as_rotvec()), POSE),
    "oxe.csv": (line("t", "{xyz}", "r{xyzw}", "gripper") + rows(T, P, XYZW, GRIPPER), POSE),
    "gripper.csv": (line("time", "{xyz}", "gripper") + rows(T, P, GRIPPER), HAND),
    "forces.csv": (line("time", "{xyz}", "F{xyz} [N]", "v{xyz} [m/s]") + rows(T, P, 9 * P, 2 * P), HAND),
    "two-arms.csv": (line("time", "left_{xyz}", "right_{xyz}") + rows(T, P, P + 0.2), HAND),
    "two-arms-x_left.csv": (line("time", "{xyz}_left", "{xyz}_right") + rows(T, P, P + 0.2), HAND),
    "unnamed.csv": ("time,u,v,h\n" + rows(T, P), HAND),
    "mm.csv": (OWN + rows(T, 20 * MM), Movement(20 * P)),
    "lost.csv": (OWN + rows(T, LOST, P[:, 1:]), Movement(P[KEPT], time=T[KEPT])),
    # Joints.
    "joints-rad.csv": ("time,j1 [rad],j2 [rad],j3 [rad]\n" + rows(T, J), ARM),
    "joints-deg.csv": ("time,j1 [deg],j2 [deg],j3 [deg]\n" + rows(T, DEG), ARM),
    "joints-q.csv": ("time,q[0],q[1],q[2]\n" + rows(T, J), ARM),
    "joints-large.csv": (line("time", "joint_{123}") + rows(T, 20 * DEG), Movement(20 * J, axes=ARM.axes)),
    "joints-and-gripper.csv": (
        "time,shoulder.pos,elbow.pos,wrist.pos,gripper.pos\n" + rows(T, J, GRIPPER),
        ARM,
    ),
}


# Arrays, HDF5, LeRobot, ROS: written by their libraries, and read by them again.


def archive(**arrays: Any) -> Callable[[Path], None]:
    """Return a function that writes a NumPy archive."""
    return lambda path: np.savez(path, **arrays)


def hdf5(datasets: Mapping[str, Any], **attributes: Any) -> Callable[[Path], None]:
    """Return a function that writes datasets. Attributes belong to the file, `env_args` to the group `data`."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for key, value in datasets.items():
                file[key] = value
            for key, value in attributes.items():
                (file["data"] if key == "env_args" else file).attrs[key] = value

    return write


def of_hdf5(key: str, turn: Callable[[h5py.File], Rotation] | None = None, rate: float = 20) -> Truth:
    """Return a function that reads the first three columns of a dataset."""

    def read(path: Path) -> Movement:
        with h5py.File(path) as file:
            position = file[key][:, :3]
            return Movement(position, None if turn is None else turn(file), np.arange(len(position)) / rate)

    return read


def lerobot(values: Array, names: Any, feature: str = "observation.state") -> Callable[[Path], None]:
    """Return a function that writes an episode's dataset at 50 Hz."""

    def write(path: Path) -> None:
        n, width = values.shape
        one = {"dtype": "float32", "shape": [width], "names": names}
        info = {
            "codebase_version": "v2.1", "robot_type": "arm", "total_episodes": 1, "total_frames": n, "fps": 50,
            "chunks_size": 1000, "features": {feature: one},
            "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        }  # fmt: skip
        columns = {
            feature: pyarrow.array(values.astype(np.float32).tolist(), pyarrow.list_(pyarrow.float32())),
            "timestamp": pyarrow.array((np.arange(n) / 50).astype(np.float32)),
            "frame_index": pyarrow.array(np.arange(n)),
            "episode_index": pyarrow.array(np.zeros(n, int)),
        }
        (path / "meta").mkdir(parents=True)
        (path / "data/chunk-000").mkdir(parents=True)
        (path / "meta/info.json").write_text(json.dumps(info))
        (path / "meta/episodes.jsonl").write_text(
            json.dumps({"episode_index": 0, "tasks": ["t"], "length": n})
        )
        pyarrow.parquet.write_table(pyarrow.table(columns), path / "data/chunk-000/episode_000000.parquet")

    return write


def of_parquet(n: int, order: Sequence[int] = (), axes: tuple[str, ...] = (), scale: float = 1.0) -> Truth:
    """Return a function that reads the first `n` columns. Four others are quaternions x y z w."""

    def read(path: Path) -> Movement:
        table = pyarrow.parquet.read_table(path / "data/chunk-000/episode_000000.parquet")
        values = np.array(table.column(0).to_pylist())
        turn = Rotation.from_quat(values[:, order]) if order else None
        return Movement(scale * values[:, :n], turn, np.arange(len(values)) / 50, axes)

    return read


ROS2 = get_typestore(Stores.ROS2_HUMBLE)


def message(kind: str, **fields: Any) -> Any:
    """Return a message of ROS 2."""
    return ROS2.types[kind.replace("/", "/msg/")](**fields)


def header(stamp: int, frame: str = "base") -> Any:
    """Return a header with a stamp [ns]."""
    sec, nanosec = divmod(int(stamp), 10**9)
    return message(
        "std_msgs/Header", stamp=message("builtin_interfaces/Time", sec=sec, nanosec=nanosec), frame_id=frame
    )


def pose(i: int) -> Any:
    """Return the pose at a sample."""
    point = message("geometry_msgs/Point", **dict(zip("xyz", P[i], strict=True)))
    turned = message("geometry_msgs/Quaternion", **dict(zip("xyzw", XYZW[i], strict=True)))
    return message("geometry_msgs/Pose", position=point, orientation=turned)


def stamped(i: int) -> Any:
    """Return the pose at a sample with its stamp."""
    return message("geometry_msgs/PoseStamped", header=header(NS[i]), pose=pose(i))


def covariance(i: int) -> Any:
    """Return the pose at a sample with a covariance."""
    return message("geometry_msgs/PoseWithCovariance", pose=pose(i), covariance=np.zeros(36))


def transform(i: int, child: str = "tool0", parent: str = "base", stamp: int | None = None) -> Any:
    """Return a message of one transform."""
    one = message(
        "geometry_msgs/TransformStamped",
        header=header(NS[i] if stamp is None else stamp, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/Transform",
            translation=message("geometry_msgs/Vector3", **dict(zip("xyz", P[i], strict=True))),
            rotation=pose(i).orientation,
        ),
    )
    return message("tf2_msgs/TFMessage", transforms=[one])


def odometry(i: int) -> Any:
    """Return the pose at a sample as odometry."""
    nothing = message("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
    twist = message("geometry_msgs/Twist", linear=nothing, angular=nothing)
    return message(
        "nav_msgs/Odometry",
        header=header(NS[i], "odom"),
        child_frame_id="tool0",
        pose=covariance(i),
        twist=message("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def joints(i: int) -> Any:
    """Return the joints at a sample, every second one reordered."""
    order = [0, 1, 2] if i % 2 == 0 else [1, 0, 2]
    none = np.empty(0)
    return message(
        "sensor_msgs/JointState",
        header=header(NS[i]),
        name=[f"j{k + 1}" for k in order],
        position=J[i, order],
        velocity=none,
        effort=none,
    )


def bag(**topics: tuple[str, Callable[[int], Any]]) -> Callable[[Path], None]:
    """Return a function that writes a bag: a folder, or a file `.mcap` or `.db3`."""

    def write(path: Path) -> None:
        plugin = rosbag2.StoragePlugin.SQLITE3 if path.suffix == ".db3" else rosbag2.StoragePlugin.MCAP
        folder = path.with_name(f"folder-{path.name}") if path.suffix else path
        with rosbag2.Writer(folder, version=8, storage_plugin=plugin) as writer:
            for topic, (kind, make) in topics.items():
                kind = kind.replace("/", "/msg/")
                connection = writer.add_connection(f"/{topic}", kind, typestore=ROS2)
                for i in range(N):
                    writer.write(connection, int(NS[i]) + 1_000_000, ROS2.serialize_cdr(make(i), kind))
        for file in folder.glob(f"*{path.suffix}") if path.suffix else ():
            file.rename(path)

    return write


def ros1(path: Path) -> None:
    """Write poses as a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/PoseStamped"
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/ee_pose", kind, typestore=store)
        for i in range(N):
            sec, nanosec = divmod(int(NS[i]), 10**9)
            stamp = store.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
            head = store.types["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="base")
            raw = store.serialize_ros1(store.types[kind](header=head, pose=pose(i)), kind)
            writer.write(connection, int(NS[i]), raw)


def of_bag(pick: Callable[[Any], Any]) -> Truth:
    """Return a function that reads a bag's poses by rosbags."""

    def read(path: Path) -> Movement:
        stamps, found = [], []
        with AnyReader([path]) as reader:
            for connection, received, raw in reader.messages():
                one = reader.deserialize(raw, connection.msgtype)
                of = pick(one)
                p = getattr(of, "position", None) or of.translation
                q = getattr(of, "orientation", None) or of.rotation
                found.append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
                own = getattr(one, "header", None) or getattr(of, "header", None)
                stamps.append(received if own is None else own.stamp.sec * 10**9 + own.stamp.nanosec)
        values, time = np.array(found), np.array(stamps)
        return Movement(values[:, :3], Rotation.from_quat(values[:, 3:]), (time - time[0]) / 1e9)

    return read


def json_mcap(path: Path) -> None:
    """Write poses as JSON messages of Foxglove's schemas."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.PoseInFrame", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", "json", schema)
        for i in range(N):
            sec, nsec = divmod(int(NS[i]), 10**9)
            content = {
                "timestamp": {"sec": sec, "nsec": nsec},
                "frame_id": "base",
                "pose": {
                    "position": dict(zip("xyz", P[i].tolist(), strict=True)),
                    "orientation": dict(zip("xyzw", XYZW[i].tolist(), strict=True)),
                },
            }
            writer.add_message(channel, int(NS[i]), json.dumps(content).encode(), int(NS[i]))
        writer.finish()


def external(path: Path) -> None:
    """Write a file whose positions are a link into another file."""
    with h5py.File("elsewhere.hdf5", "w") as file:
        file["p"] = P
    with h5py.File(path, "w") as file:
        file["data/demo_0/obs/robot0_eef_pos"] = h5py.ExternalLink("elsewhere.hdf5", "p")


ROBOMIMIC = "data/demo_0/obs/"
T7 = np.c_[J, J, GRIPPER]

LAYOUTS |= {
    "own.npz": (archive(time=T, position=P), HAND),
    "ms.npz": (archive(time=10 * FRAME, position=P), HAND),
    "hands.npz": (
        archive(time=T, position=np.stack([P, P + 1], axis=1), manipulators=["left", "right"]),
        HAND,
    ),
    "robomimic.hdf5": (
        hdf5(
            {f"{ROBOMIMIC}robot0_eef_pos": P, f"{ROBOMIMIC}robot0_eef_quat": XYZW},
            env_args=json.dumps({"env_kwargs": {"control_freq": 50}}),
        ),
        of_hdf5(
            f"{ROBOMIMIC}robot0_eef_pos",
            lambda f: Rotation.from_quat(f[f"{ROBOMIMIC}robot0_eef_quat"][:]),
            50,
        ),
    ),
    "robosuite-two.hdf5": (
        hdf5({f"{ROBOMIMIC}robot0_right_eef_pos": P, f"{ROBOMIMIC}robot0_left_eef_pos": P + 1}),
        of_hdf5(f"{ROBOMIMIC}robot0_left_eef_pos"),
    ),
    "libero.hdf5": (
        hdf5({f"{ROBOMIMIC}ee_pos": P, f"{ROBOMIMIC}ee_ori": R.as_rotvec(), f"{ROBOMIMIC}joint_states": T7}),
        of_hdf5(f"{ROBOMIMIC}ee_pos", lambda f: Rotation.from_rotvec(f[f"{ROBOMIMIC}ee_ori"][:])),
    ),
    "maniskill.h5": (
        hdf5({"traj_0/obs/extra/tcp_pose": np.c_[P, WXYZ], "traj_0/obs/agent/qpos": T7}),
        of_hdf5(
            "traj_0/obs/extra/tcp_pose",
            lambda f: Rotation.from_quat(f["traj_0/obs/extra/tcp_pose"][:][:, [4, 5, 6, 3]]),
        ),
    ),
    "aloha.hdf5": (
        hdf5({"observations/qpos": np.c_[T7, T7 + 0.1]}),
        Movement(T7, time=FRAME / 50, axes=("7",)),
    ),
    "plain.h5": (hdf5({"time": T, "position": P}), HAND),
    "named.h5": (hdf5({"log/hand": P, "log/stamp": T}), HAND),
    "linked.hdf5": (external, "link into another file"),
    "lerobot-xyz": (lerobot(P, ["x", "y", "z"]), of_parquet(3)),
    "lerobot-pose": (
        lerobot(np.c_[P, WXYZ, GRIPPER], ["x", "y", "z", "qw", "qx", "qy", "qz", "gripper"]),
        of_parquet(3, (4, 5, 6, 3)),
    ),
    "lerobot-unnamed": (lerobot(np.c_[P, GRIPPER], ["state"]), of_parquet(3)),
    "lerobot-joints": (
        lerobot(np.c_[J, GRIPPER], {"motors": ["joint_0", "joint_1", "joint_2", "gripper"]}),
        of_parquet(4, axes=("j",)),
    ),
    "lerobot-two": (
        lerobot(np.c_[P, P + 1], line("left_{xyz}", "right_{xyz}").strip().split(",")),
        of_parquet(3),
    ),
    "poses.mcap": (bag(ee_pose=("geometry_msgs/PoseStamped", stamped)), of_bag(lambda m: m.pose)),
    "poses.db3": (bag(ee_pose=("geometry_msgs/PoseStamped", stamped)), POSE),
    "poses.bag": (ros1, of_bag(lambda m: m.pose)),
    "pose-unstamped": (bag(pose=("geometry_msgs/Pose", pose)), of_bag(lambda m: m)),
    "odometry": (bag(odom=("nav_msgs/Odometry", odometry)), of_bag(lambda m: m.pose.pose)),
    "covariance": (
        bag(
            pose=(
                "geometry_msgs/PoseWithCovarianceStamped",
                lambda i: message(
                    "geometry_msgs/PoseWithCovarianceStamped", header=header(NS[i]), pose=covariance(i)
                ),
            )
        ),
        of_bag(lambda m: m.pose.pose),
    ),
    "tf": (bag(tf=("tf2_msgs/TFMessage", transform)), of_bag(lambda m: m.transforms[0].transform)),
    "joint_states": (bag(joint_states=("sensor_msgs/JointState", joints)), ARM),
    "two-topics": (
        bag(ee_pose=("geometry_msgs/PoseStamped", stamped), joint_states=("sensor_msgs/JointState", joints)),
        POSE,
    ),
    "json.mcap": (json_mcap, POSE),
    # What cannot be read.
    "circle": (
        bag(tf=("tf2_msgs/TFMessage", lambda i: transform(i, *(("a", "b"), ("b", "a"))[i % 2]))),
        "circle|cycle|itself|parent",
    ),
    "forces.txt": (
        "Devices\n1000\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n" + rows(FRAME, 0 * FRAME, P),
        "no positions",
    ),
    "reach.bvh": (
        "HIERARCHY\nMOTION\nFrame Time: 0.01\n" + rows(DEG, separator=" "),
        "kind '.bvh' is not known",
    ),
    "commas.csv": (OWN + rows(T, P, comma=True), "decimal commas"),
    "empty.csv": ("", "empty"),
    "header.csv": (OWN, "no rows"),
    "one-sample.csv": (OWN + "0,0.1,0.2,0.3\n", "two|one"),
    "pointer.csv": (
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
        "git lfs pull",
    ),
    "swapped.csv": (
        OWN + rows(T[:100], P[:100]) + "time,z,y,x\n" + rows(T[100:], P[100:, ::-1]),
        "another order",
    ),
    "two-takes.csv": (OWN + rows(T, P) + OWN + rows(T, P), "stand there again"),
    "reset.csv": (OWN + rows(T, P) + rows(T, P), "back"),
    "picture.csv": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(256)), "no text"),
    "text.txt": ("Dear diary,\nnothing was recorded today.\n", "no table"),
    "one-column.txt": (rows(P[:, 0]), "single column"),
    "thousands.csv": (
        "time;x;y;z\n" + rows(T, [f"1.2{k % 100:02d},5" for k in FRAME], P[:, 1:], separator=";"),
        "1.2",
    ),
}


if __name__ == "__main__":
    main()
