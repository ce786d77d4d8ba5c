"""Formats of robot files: each reader says what a file is, and the command that makes of it what is wanted."""

import shlex

import pytest

pytest.importorskip("pinocchio")

from comove.errors import RobotError
from comove.robots import Robot
from comove.robots.proposal import propose
from comove.sim.mjcf import urdf_of
from tests.commands import invoke

LINKS = '<link name="base"/><link name="hand"/>'
JOINT = '<joint name="j" type="revolute"><parent link="base"/><child link="hand"/>{}</joint>'
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="1"/>'
TURNED = '<origin rpy="${pi/2} 0 0"/>'
XACRO = "http://www.ros.org/wiki/xacro"
TEXTS = {
    "a URDF": f'<robot name="r">{LINKS}{JOINT.format(LIMIT)}</robot>',
    "a xacro (<xacro:include>)": f'<robot xmlns:xacro="{XACRO}"><xacro:include filename="a"/></robot>',
    'a xacro (rpy="${pi/2} 0 0")': f"<robot>{LINKS}{JOINT.format(TURNED)}</robot>",
    "a model of MuJoCo's (MJCF)": '<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>',
    "an SRDF": '<robot name="r"><disable_collisions link1="a" link2="b" reason="Never"/></robot>',
    "an SDF": '<sdf version="1.9"/>',
    "a robot description (YAML)": "name: r\n",
}
READERS = {
    "a URDF": lambda path: propose([str(path)], path.with_name("new.yaml")),
    "a model of MuJoCo's (MJCF)": urdf_of,
    "a robot description (YAML)": Robot.load,
}


def written(folder, kind):
    """A file of a format, called as such files are not, but for YAML."""
    path = folder / ("robot.yaml" if "YAML" in kind else "robot.txt")
    path.write_text(TEXTS[kind], encoding="utf-8")
    return path


@pytest.mark.parametrize("wanted", READERS)
@pytest.mark.parametrize("kind", TEXTS)
def test_every_reader_says_what_a_file_is(kind, wanted, tmp_path):
    if kind == wanted:
        return
    if (kind, wanted) == ("a robot description (YAML)", "a model of MuJoCo's (MJCF)"):
        return  # MuJoCo tells
    path = written(tmp_path, kind)
    with pytest.raises(RobotError) as caught:
        READERS[wanted](path)
    assert caught.value.message == f"it is {kind}, not {wanted}"
    assert caught.value.file == path
    assert caught.value.way_out


@pytest.mark.parametrize("kind", ["a URDF", "a model of MuJoCo's (MJCF)", "a robot description (YAML)"])
def test_the_advice_is_a_command_that_takes_the_file(kind, tmp_path, monkeypatch):
    """It gets beyond the reading of the file: what it says then is about what the file holds, or nothing."""
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, kind)
    wanted = next(wanted for wanted in READERS if wanted != kind)
    with pytest.raises(RobotError) as caught:
        READERS[wanted](path)
    _, _, rest = caught.value.way_out.partition("comove ")
    result = invoke(*shlex.split(rest.partition(",")[0].replace("FOLDER", "converted")))
    assert result.exit_code in (0, 2)
    assert "it is " not in result.output


def test_a_file_that_neither_reader_knows_is_told_alike(tmp_path):
    """Those who describe a robot and those who load it hear the same of a URDF."""
    for text in ("", "<svg/>", "<robot/>", f"<robot>{LINKS}</robot>", f"<robot>{LINKS}{LINKS}</robot>"):
        (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
        (tmp_path / "r.yaml").write_text(
            "name: r\nmodels: [{urdf: r.urdf}]\narms: {left: {tip: hand}}\n", encoding="utf-8"
        )
        told = []
        for read in (
            lambda: Robot.load(tmp_path / "r.yaml"),
            lambda: propose([str(tmp_path / "r.urdf")], tmp_path / "n.yaml"),
        ):
            with pytest.raises(RobotError) as caught:
                read()
            told.append((caught.value.message, caught.value.file, caught.value.way_out))
        assert told[0] == told[1]
