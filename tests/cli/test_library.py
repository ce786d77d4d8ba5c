"""`comove learn` and `comove library`: what is kept, what is said, and one clear message for bad input."""

import json
import os
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from comove.dmp import DMP, Library, Primitive, read_primitive, write_primitive
from comove.dmp.demonstrations import Demonstration, write_csv
from tests.cli.test_cli import SCENE, SWING
from tests.commands import invoke

VERBS = ("add", "combine", "find", "list", "remove", "show")


def good(*arguments, code=0):
    outcome = invoke(*arguments)
    assert outcome.exit_code == code, outcome.stderr
    return outcome


def refused(*arguments):
    """Bad input: 2, one message, no traceback, nothing on stdout, nothing written."""
    before = snapshot()
    outcome = invoke(*arguments)
    assert outcome.exit_code == 2
    assert outcome.stderr.startswith(("error: ", "Usage: "))
    assert "Traceback" not in outcome.stderr
    assert outcome.stdout == ""
    assert snapshot() == before
    return outcome.stderr


def snapshot():
    return {
        os.path.join(folder, name): os.stat(os.path.join(folder, name)).st_mtime_ns
        for folder, _, names in os.walk(".")
        for name in names
    }


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "swing.csv").write_text(SWING)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


@pytest.fixture
def filled():
    good("library", "add", "lasa:Angle", "lasa:Sine", "swing.csv")
    return Library("library")


# --- learn ---


def test_what_was_taken_is_told_and_drawn(folder):
    rows = "".join(f"{10 * i},{0.01 * i},{0.0001 * i * i},0\n" for i in range(60))
    (folder / "hand.csv").write_text("time,X [m],Y [m],gripper\n" + rows)
    outcome = good("learn", "hand.csv", "--out", "hand.json")
    assert "time from `time` [ms, after its size], position from X, Y [m]" in outcome.stdout
    assert "drawn as hand.png" in outcome.stdout
    assert (folder / "hand.png").read_bytes().startswith(b"\x89PNG")
    good("learn", "hand.csv", "--out", "again.json", "--picture", "fit.pdf")
    assert (folder / "fit.pdf").exists() and not (folder / "again.png").exists()
    assert "is no picture" in refused("learn", "hand.csv", "--out", "x.json", "--picture", "fit.doc")


def test_a_picture_of_somebody_else_is_left_alone(folder):
    (folder / "hand.png").write_bytes(b"\x89PNG a photograph")
    outcome = good("learn", "swing.csv", "--out", "hand.json")
    assert "drawn as" not in outcome.stdout
    assert (folder / "hand.png").read_bytes() == b"\x89PNG a photograph"
    good("learn", "swing.csv", "--out", "swing.json")
    before = (folder / "swing.png").stat().st_mtime_ns
    good("learn", "swing.csv", "--out", "swing.json")
    assert (folder / "swing.png").stat().st_mtime_ns != before


TABLES = {
    "no_names.csv": "n,u,v\n" + "".join(f"{i},{i / 100},{i * i / 1e4}\n" for i in range(60)),
    "frames.csv": "time,x,y\n" + "".join(f"{i},{i / 100},{i * i / 1e4}\n" for i in range(60)),
    "steps of 3.csv": "stamp,x,y\n" + "".join(f"{3 * i},{i / 100},{i * i / 1e4}\n" for i in range(60)),
    "mm.csv": "time,x,y\n" + "".join(f"{i / 50},{10 * i},{i * i / 10}\n" for i in range(60)),
    "deg.csv": "time,j1,j2\n" + "".join(f"{i / 50},{i},{i * i / 100}\n" for i in range(60)),
    "hands.csv": "time,l.x,l.y,r.x,r.y\n" + "".join(f"{i / 50},{i / 60},0,0,{i / 60}\n" for i in range(60)),
    "twice.csv": "time,x,y,X,Y\n" + "".join(f"{i / 50},{i / 60},0,0,{i / 60}\n" for i in range(60)),
    "lost.csv": "time,x,y\n" + "".join(f"{i / 50},{'' if i == 7 else i / 60},0\n" for i in range(60)),
    "clocks.csv": "t,stamp,x,y\n" + "".join(f"{i / 50},{i / 25},{i / 60},0\n" for i in range(60)),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.few(4)
def test_the_commands_that_refusals_print_work_as_they_are_printed(folder, name):
    (folder / name).write_text(TABLES[name])
    arguments, asked = ["learn", name, "--out", "out.json"], 0
    while (outcome := invoke(*arguments)).exit_code:
        assert outcome.exit_code == 2 and asked < 4
        (command,) = re.findall(r"; run: comove (.*) \(comove explain", outcome.stderr)
        for asked_for, told in (
            ("[UNIT]", "[ms]"),
            ("UNIT", "m"),
            ("HZ", "50"),
        ):  # which nothing in the file says
            command = command.replace(asked_for, told)
        arguments, asked = shlex.split(command), asked + 1
    assert asked and read_primitive(arguments[-1]).dmp.n_dims == 2


def test_a_recording_is_learned_and_its_error_told():
    outcome = good("learn", "swing.csv", "--out", "swing.json", "--n-basis", 8)
    primitive = read_primitive("swing.json")
    p = primitive.provenance
    assert primitive.name == "swing"
    assert (p.source, p.n_samples, p.n_basis) == ("swing.csv", 21, 8)
    assert f"{p.error_rms:.3g} m" in outcome.stdout and f"{p.error_max:.3g} m" in outcome.stdout
    assert np.array_equal(primitive.dmp.weights, DMP.fit(Demonstration.load("swing.csv"), n_basis=8).weights)


@pytest.mark.parametrize("demo", ["lasa:Sine", "lasa:Sine:0", "lasa:Sine:3"])
def test_handwriting(demo):
    outcome = good("learn", demo, "--out", "s.json", "--variant", "dmp++", "--phase", "linear")
    number = 3 if demo.endswith("3") else 0
    primitive = read_primitive("s.json")
    assert primitive.provenance.source == f"lasa:Sine:{number}"
    assert primitive.provenance.recording == f"Sine {number}"
    assert str(primitive.dmp.variant) == "dmp++"
    assert "LASA unit" in outcome.stdout


def test_one_of_several_manipulators():
    recording = Demonstration.load("swing.csv")
    write_csv("both.csv", {"left": recording, "right": recording})
    assert "manipulators" in refused("learn", "both.csv", "--out", "b.json")
    good("learn", "both.csv", "--out", "b.json", "--manipulator", "right")
    good("library", "add", "both.csv")
    assert Library("library").names == ("both.left", "both.right")


def test_a_primitive_is_replaced_and_nothing_else():
    good("learn", "lasa:Sine", "--out", "s.json")
    good("learn", "lasa:Angle", "--out", "s.json")
    assert read_primitive("s.json").provenance.source == "lasa:Angle:0"
    assert "no primitive" in refused("learn", "lasa:Angle", "--out", "swing.csv")
    assert "no folder" in refused("learn", "lasa:Angle", "--out", "no/s.json")


def test_rhythmic_and_poses():
    time = np.linspace(0, 9, 901)
    position = np.stack([np.sin(2.1 * time), np.cos(2.1 * time)], axis=1)
    half = 0.1 * time
    orientation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    write_csv("turn.csv", Demonstration(time, position, orientation=orientation))
    good("learn", "turn.csv", "--out", "cycle.json", "--variant", "rhythmic")
    assert read_primitive("cycle.json").dmp.duration == pytest.approx(2 * np.pi / 2.1, rel=1e-3)
    outcome = good("learn", "turn.csv", "--out", "pose.json", "--poses")
    assert read_primitive("pose.json").kind == "pose"
    assert "turn error" in outcome.stdout
    assert "holds no orientations" in refused("learn", "swing.csv", "--out", "x.json", "--poses")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("none.csv",), "none.csv: there is no such file"),
        (("lasa:Angel",), "did you mean 'Angle'"),
        (("lasa:Angle:7",), "choose 0 to 6"),
        (("lasa:Angle:x",), "'x' is no recording"),
        (("scene.yaml",), "its kind '.yaml' is not known"),
        (("swing.csv", "--n-basis", 0), "n_basis = 0"),
        (("swing.csv", "--variant", "clasic"), "did you mean 'classic'"),
        (("swing.csv", "--period", 1), "period = 1.0"),
        (("swing.csv", "--manipulator", "left"), "leave the manipulator out"),
        (("swing.csv", "--phase", "cubic"), "cubic"),
    ],
)
def test_what_cannot_be_learned(arguments, words):
    assert words in refused("learn", *arguments, "--out", "x.json").replace("\n", " ")


# --- library ---


def test_several_recordings_make_a_distribution(tmp_path):
    told = good("learn", "lasa:Sine:all", "--out", "sine.json", "--align", "warping").stdout
    assert "distribution" in told and "7 recordings" in told and "by warping" in told
    primitive = read_primitive("sine.json")
    assert primitive.kind == "distribution" and primitive.dmp.n_recordings == 7
    good("learn", "lasa:Sine:0", "lasa:Sine:3", "lasa:Sine:5", "lasa:Sine:6", "--out", "few.json")
    good("library", "add", "sine.json", "--folder", "kept")
    assert "distribution" in good("library", "list", "--folder", "kept").stdout
    good("library", "show", "sine", "--folder", "kept", "--out", "sine.png")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("lasa:Sine:0", "lasa:Sine:0"), "recordings 0 and 1 are one and the same"),
        (("lasa:Sine:all", "--poses"), "holds no orientations"),
        (("lasa:Sine:all", "--in-motion"), "--in-motion: several recordings"),
        (("lasa:Sine:all", "--variant", "classic"), "--variant: several recordings"),
        (("lasa:Sine:all", "--align", "warp"), "alignment = 'warp'"),
        (("lasa:Sine:0", "swing.csv"), "recording 1"),
        (("empty",), "it holds no recordings"),
    ],
)
def test_what_makes_no_distribution(arguments, words):
    os.mkdir("empty")
    write_csv("swing.csv", Demonstration(np.linspace(0, 1, 9), np.linspace(0, 1, 18).reshape(9, 2)))
    assert words in refused("learn", *arguments, "--out", "sine.json")


def test_adding_listing_removing(filled):
    assert filled.names == ("Angle-0", "Sine-0", "swing")
    outcome = good("library", "list")
    for name in filled.names:
        assert re.search(rf"^{name} ", outcome.stdout, re.MULTILINE)
    assert "holds 1 primitive\n" in good("library", "remove", "Sine-0", "swing").stdout
    assert filled.names == ("Angle-0",)


def test_primitives_are_added_under_their_name_or_another():
    good("learn", "lasa:Sine", "--out", "s.json")
    good("library", "add", "s.json", "--folder", "mine")
    good("library", "add", "s.json", "--folder", "mine", "--name", "wave")
    assert Library("mine").names == ("s", "wave")
    assert np.array_equal(Library("mine")["wave"].dmp.weights, read_primitive("s.json").dmp.weights)


def test_all_are_added_or_none(filled):
    assert "'Sine-0' already" in refused("library", "add", "lasa:Worm", "lasa:Sine")
    assert "Angel" in refused("library", "add", "lasa:Worm", "lasa:Angel")
    assert "two movements are called 'Worm-0'" in refused("library", "add", "lasa:Worm", "lasa:Worm:0")
    assert "cannot all be called" in refused("library", "add", "lasa:Worm", "lasa:Line", "--name", "x")
    assert "cannot name a primitive" in refused("library", "add", "lasa:Worm", "--name", "../x")
    assert len(filled) == 3
    good("library", "add", "lasa:Sine", "--replace", "--n-basis", 7)
    assert filled["Sine-0"].provenance.n_basis == 7


def test_json(filled):
    entries = json.loads(good("library", "list", "--json").stdout)
    assert [entry["name"] for entry in entries] == list(filled.names)
    assert entries[0]["provenance"]["source"] == "lasa:Angle:0"
    assert entries[0]["goal"] == filled["Angle-0"].dmp.goal.tolist()
    matches = json.loads(good("library", "find", "--like", "Sine-0", "--json").stdout)
    assert matches[0]["name"] == "Sine-0" and matches[0]["start"] is None
    assert json.loads(good("library", "list", "--json", "--folder", "none").stdout) == []


@pytest.mark.slow
def test_pictures(filled):
    for arguments in (("list",), ("show", "Sine-0"), ("show", "swing")):
        for name, begins in (("p.png", b"\x89PNG"), ("p.svg", b"<?xml"), ("p.pdf", b"%PDF")):
            assert invoke("library", *arguments, "--out", name, pictures=True).exit_code == 0
            assert os.path.getsize(name) > 1000
            with open(name, "rb") as file:
                assert file.read(5).startswith(begins)
    assert ".png, .pdf or .svg" in invoke("library", "show", "Sine-0", "--out", "p.txt").stderr
    assert invoke("library", "list", "--out", "no/p.png").exit_code == 2


def test_the_recording_is_drawn_where_it_is_the_same(filled):
    from comove.dmp.recordings import recording_of

    assert recording_of(filled["Sine-0"]).name == "Sine 0"
    assert recording_of(filled["swing"]).n_steps == 21
    with open("swing.csv", "a") as file:
        file.write("2.1,1.05,0.0\n")
    assert recording_of(filled["swing"]) is None
    os.remove("swing.csv")
    assert recording_of(filled["swing"]) is None


def test_show(filled):
    outcome = good("library", "show", "swing")
    assert "swing.csv, 21 samples" in outcome.stdout
    assert os.path.join("library", "swing.dmp.json") in outcome.stdout
    assert "did you mean 'swing'" in refused("library", "show", "swong")
    assert "did you mean 'swing'" in refused("library", "remove", "Sine-0", "swong")
    assert len(filled) == 3


def test_find(filled):
    first = good("library", "find", "--like", "lasa:Sine:4", "--limit", 1).stdout.splitlines()
    assert first[1].startswith("Sine-0") and len(first) == 2
    outcome = good("library", "find", "--start", "-44,-3", "--goal", "0,0", "--duration", 2.5)
    assert outcome.stdout.splitlines()[1].startswith("Angle-0")
    assert "start off by" in outcome.stdout and "shape" not in outcome.stdout
    assert "no movement of this dimension" in good("library", "find", "--start", "0,0,0").stdout
    for arguments, words in (
        ((), "nothing is asked for"),
        (("--start", "1,a"), "'1,a' are no coordinates"),
        (("--start", "nan,0"), "start ="),
        (("--like", "Sine"), "did you mean 'Sine-0'"),
        (("--like", "lasa:Sinus"), "'Sinus'"),
        (("--duration", "-1"), "duration = -1"),
        (("--duration", "1", "--limit", "0"), "limit = 0"),
    ):
        assert words in refused("library", "find", *arguments)


def test_damaged_and_foreign_files_are_named(filled):
    path = filled.path("Sine-0")
    path.write_bytes(path.read_bytes()[:-9])
    (filled.folder / "notes.txt").write_text("mine")
    outcome = invoke("library", "list")
    assert outcome.exit_code == 2
    assert "Angle-0" in outcome.stdout and "swing" in outcome.stdout
    assert f"error: {path}: " in outcome.stderr
    assert "left alone, no primitives: notes.txt" in outcome.stderr
    good("library", "remove", "Sine-0")
    assert invoke("library", "list").exit_code == 0


@pytest.mark.slow
def test_combine_and_solve_with_what_came_of_it(filled):
    good("library", "add", "lasa:Worm", "lasa:Trapezoid")
    outcome = good("library", "combine", "scene.yaml", "--out", "c.json", "--picture", "c.png")
    assert "verified in test" in outcome.stdout
    primitive = read_primitive("c.json")
    assert "verified" in primitive.notes[0] and len(primitive.notes) == 6
    good("library", "add", "c.json")
    outcome = good("solve", "scene.yaml", "--out", "out", "--library", "library", "--resemblance", 1)
    assert re.search(r"demonstration +c of library", outcome.stdout)
    good("verify", "scene.yaml", "out")
    with open("scene.yaml", "a") as file:
        file.write("demonstration: {library: c}\n")
    good("solve", "scene.yaml", "--out", "named", "--resemblance", 1)
    outcome = good("solve", "scene.yaml", "--out", "chain", "--library", "library", "--method", "paper")
    assert re.search(r"demonstration +a combination of .*c.* of library", outcome.stdout)
    assert "no primitive 'd'" in refused("library", "combine", "scene.yaml", "d", "--out", "d.json")
    assert "no primitive" in refused("library", "combine", "scene.yaml", "c", "--out", "scene.yaml")


def test_a_combination_that_does_not_pass_is_saved_and_labelled(filled):
    with open("scene.yaml") as file:
        closed = file.read().replace(
            "center: [0.5, 0.2], size: [0.1, 0.4]", "center: [0.5, 0.5], size: [0.1, 1.2]"
        )
    with open("closed.yaml", "w") as file:
        file.write(closed)
    outcome = invoke("library", "combine", "closed.yaml", "Sine-0", "--out", "c.json", "--budget", 1)
    assert outcome.exit_code == 1
    assert "NOT VERIFIED" in outcome.stdout and "obstacles[0]" in outcome.stderr
    assert "NOT VERIFIED" in read_primitive("c.json").notes[0]


def test_solve_with_an_unfit_library(filled):
    assert "none of the 0 movements" in refused("solve", "scene.yaml", "--out", "out", "--library", "none")
    cycle = DMP(np.ones((2, 5)), *np.zeros((4, 2)), 1.0, variant="rhythmic")
    write_primitive("cycle.json", Primitive("cycle", cycle))
    good("library", "add", "cycle.json", "--folder", "other")
    assert "none of the 1 movements" in refused("solve", "scene.yaml", "--out", "out", "--library", "other")


# --- Help ---


@pytest.mark.parametrize("arguments", [("learn",), ("library",), *(("library", verb) for verb in VERBS)])
@pytest.mark.few(3)
def test_help_is_there_and_quick(arguments):
    code = (
        "import sys; from comove.cli import main; sys.argv = ['comove', *sys.argv[1:]]\n"
        "try:\n    main()\nexcept SystemExit as end:\n"
        "    heavy = {'numpy', 'scipy', 'numba', 'matplotlib', 'yaml'} & set(sys.modules)\n"
        "    sys.exit(f'loaded {heavy}' if heavy else end.code)"
    )
    command = [sys.executable, "-c", code, *arguments, "--help"]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert outcome.returncode == 0, outcome.stderr
    assert "Usage: " in outcome.stdout
    if arguments == ("library",):
        for verb in VERBS:
            assert re.search(rf"^\s+{verb}\b", outcome.stdout, re.MULTILINE)
