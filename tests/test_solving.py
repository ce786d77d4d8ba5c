"""One call with a robot and without: `comove.solve`, `verify`, `Executor`; and the names that there are."""

import gc
import re
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Barrier, Thread

import numpy as np
import pytest

import comove
from comove._doors import uncollected
from comove.control import Executor as FreeExecutor
from comove.errors import OptionError
from comove.model import CoordinatedMotion
from comove.model.files.keys import canonical
from comove.planning import Budget, SceneKind, Solution, load_kernels
from comove.robots import JointVerdict, carry
from comove.robots.online.executor import JointExecutor
from comove.stored import ResultPart
from comove.verification import Verdict
from tests.robots.known_carry import known_carry
from tests.robots.known_folder import write
from tests.robots.small_robots import gantry_scene, robot
from tests.solved import example

DOCS = Path(__file__).parents[1] / "docs"
WORK = Budget(work=5.0)


@pytest.fixture(scope="module")
def carried():
    return comove.solve(gantry_scene(), robot=robot("gantry"), budget=WORK)


def test_a_robot_adds_joints_to_the_same_solution(carried):
    assert isinstance(carried, Solution) and carried.verified
    joints = carried.joints
    assert joints.verified and joints.motion.motion.motion is carried.attempt
    alone = comove.solve(gantry_scene(), robot=False, budget=WORK)
    assert alone.verified and alone.joints is None
    arms = [joints.robot.arm(name) for name in carried.scene.manipulators]
    for share in (0.0, 0.5, 1.0):
        q = joints.attempt.at(share * joints.attempt.duration)[0]
        hands = carried.attempt.hands(np.array([share]))[0][0]
        tools = [joints.robot.tool_pose(q, arm)[:3, 3] for arm in arms]
        np.testing.assert_allclose(tools, hands, atol=1e-6)


def test_a_scene_that_names_a_robot_is_solved_by_it(monkeypatch):
    named = []
    monkeypatch.setattr(
        "comove.robots.solving.check_robot", lambda scene, arms, *_: named.append(arms.name) or 1 / 0
    )
    for scene, wanted in ((example("baxter_wide"), None), (example("wide"), "baxter")):
        if scene.n_dims == 3 or wanted:
            with pytest.raises(ZeroDivisionError):
                comove.solve(scene, robot=wanted)
    assert named == ["baxter", "baxter"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"approach": True}, "approach: no robot carries the payload"),
        ({"release": True}, "release: no robot carries the payload"),
        ({"present": {}}, "present: no robot carries the payload"),
        ({"begin": {}}, "begin: no robot carries the payload"),
        ({"found": print}, "found: no robot carries the payload"),
    ],
)
def test_arguments_of_robots_are_refused_without_one(options, told):
    with pytest.raises(OptionError, match=told):
        comove.solve(example("wide"), **options)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"objective": lambda samples: 0.0}, "objective: functions of one's own are of end effectors alone"),
        ({"constraints": [lambda samples: 0.0]}, "constraints: functions of one's own"),
        ({"planner": False}, "planner: the joints of 'small' need a planned path"),
        ({"obstacles": "cost"}, "obstacles are constraints of the robot 'small'"),
    ],
)
def test_what_joints_cannot_do_is_refused_and_the_advice_works(options, told):
    with pytest.raises(OptionError, match=told):
        comove.solve(gantry_scene(), robot=robot("gantry"), **options)
    comove.solve(gantry_scene(), robot=False, budget=Budget(work=0.05), **options)


def test_motions_solutions_and_folders_are_verified_by_one_call(carried, tmp_path):
    assert isinstance(comove.verify(carried.attempt), Verdict)
    found = comove.verify(carried)
    assert isinstance(found, JointVerdict) and found.verified is not None
    parts = comove.verify(write(tmp_path / "known"))
    assert [part.part for part in parts] == [ResultPart.MOTION, ResultPart.JOINTS] and all(
        p.verified for p in parts
    )
    assert comove.verify(carried.attempt, checks=[lambda motion: ["no"]]).reasons == ("no",)


def test_a_further_check_is_made_of_whatever_has_a_motion(carried):
    """A solution with joints, its verified motion and the joints of either are no exception."""
    bare = replace(carried, joints=None)
    for thing in (carried, bare, carried.motion, carried.joints, carried.joints.motion):
        seen = list[CoordinatedMotion]()
        assert comove.verify(thing, checks=[lambda motion, seen=seen: seen.append(motion) or ()]).verified
        assert seen == [carried.attempt]
        refused = comove.verify(thing, checks=[lambda motion: ["too blue"]])
        assert refused.verified is None and refused.reasons[0].endswith("too blue")


def test_a_folder_is_verified_against_objects_and_paths_alike(carried, tmp_path):
    """The robot and the scene that are trusted may be loaded already."""
    folder, known = write(tmp_path / "known"), known_carry()[0].scene
    path = tmp_path / "trusted.json"
    path.write_bytes(canonical(known.file))
    for options in ({"robot": robot("baxter")}, {"scene": known, "robot": "baxter"}, {"scene": path}):
        assert all(part.verified for part in comove.verify(folder, **options)), options
    _, joints = comove.verify(folder, robot=robot("two_xarm7"))
    assert not joints.verified and "two_xarm7" in joints.against[-1]


def test_bad_arguments_are_refused_with_a_robot_too():
    for budget in (-1, "10", np.nan):
        with pytest.raises(OptionError, match=f"budget = {budget!r}; give a positive number of seconds"):
            comove.solve(gantry_scene(), robot=robot("gantry"), budget=budget)
    with pytest.raises(OptionError, match=r"robot = True; give a Robot, its name, or the path"):
        comove.solve(gantry_scene(), robot=True)


def test_executions_are_verified_as_motions_are():
    """That a record of an execution holds is said by the same call, and what is wrong with one is told."""
    executor = comove.Executor(example("wide"), seed=0)
    record = executor.run(20.0)
    done = comove.verify(record)
    assert done.verified and done.part is ResultPart.RUN and executor.ended and not executor.interrupted
    assert done.report.clearance_min >= record.scene.clearance
    half = {name: getattr(record, name)[:50] for name in ("time", "center", "quaternion", "obstacles")}
    short = comove.verify(replace(record, **half, sagitta=record.sagitta[:49]))
    assert not short.verified and "goal is missed" in short.reasons[0]
    with pytest.raises(OptionError, match="checks: further checks are of motions"):
        comove.verify(record, checks=[list])


@pytest.mark.slow
def test_both_executors_are_run_recorded_and_verified_by_the_same_calls():
    """Joints follow their commands exactly; they hold the payload, and a link that goes astray is told."""
    executor = comove.Executor(gantry_scene(), robot=robot("gantry"), seed=0)
    record = executor.run(30.0)
    assert executor.ended and executor.blocker == "" and not executor.interrupted
    done = comove.verify(record)
    assert done.verified and done.part is ResultPart.ROBOT_RUN, done.reasons
    arms = [executor.robot.arm(name) for name in record.scene.manipulators]
    tools = executor.robot.tool_poses(record.joints, arms)[..., :3, 3]
    np.testing.assert_allclose(tools, record.position, atol=1e-9)
    joints = record.joints.copy()
    joints[len(joints) // 2 :] += 0.01
    assert any("off the load" in reason for reason in comove.verify(replace(record, joints=joints)).reasons)


@pytest.mark.parametrize(
    ("thing", "options", "told"),
    [
        (3, {}, "thing: a int cannot be verified"),
        ("motion", {"robot": "baxter"}, "robot: a motion has its own"),
        ("folder", {"checks": [list]}, "checks: further checks are of motions"),
        ("folder", {"robot": False}, "robot = False; give a Robot, its name, or the path of its description"),
        ("folder", {"scene": 3}, "scene = 3; give a Scene, or the path of its file"),
    ],
)
def test_what_cannot_be_verified_is_told(thing, options, told, carried, tmp_path):
    things = {"motion": carried.attempt, "folder": tmp_path}
    with pytest.raises(OptionError, match=told):
        comove.verify(things.get(thing, thing), **options)


def test_the_scene_says_which_executor_moves(monkeypatch):
    monkeypatch.setattr(
        JointExecutor, "__init__", lambda self, scene, arms, *_, **how: vars(self).update(how)
    )
    of_joints = comove.Executor(gantry_scene(), robot=robot("gantry"), period=0.005, seed=2)
    assert isinstance(of_joints, JointExecutor)
    assert (of_joints.settings.period, of_joints.seed) == (0.005, 2)
    free = comove.Executor(example("wide"), period=0.02)
    assert isinstance(free, FreeExecutor) and free.period == 0.02
    with pytest.raises(OptionError, match="demonstration: robots follow no demonstration"):
        comove.Executor(gantry_scene(), robot=robot("gantry"), demonstration=object())


def test_there_are_few_names_and_pages_use_no_other():
    assert len(comove.__all__) <= 17
    files = [*DOCS.rglob("*.md"), DOCS.parent / "README.md", *DOCS.parent.glob("examples/*.py")]
    packages = {path.stem for path in Path(comove.__file__).parent.iterdir()}
    for path in files:
        if {"_build", "gallery"} & set(path.parts):
            continue
        used = set(re.findall(r"\bcomove\.([A-Za-z]\w*)(?!\.py|\w)", path.read_text(encoding="utf-8")))
        others = used - set(comove.__all__) - packages - {"readthedocs", "bib", "csl", "png", "html"}
        assert not others, path


def test_every_name_of_the_reference_exists():
    text = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
    named = re.findall(r"auto(?:function|class):: ([\w.]+)", text)
    assert len(named) > 30
    documented = set()
    for name in named:
        module, _, one = name.rpartition(".")
        found = getattr(__import__(module, fromlist=[one]), one)
        documented.add(getattr(found, "__name__", ""))
    assert set(comove.__all__) - documented <= {"__version__", "show", "solve_many"}


@pytest.mark.parametrize("name", sorted(comove._FORMER))
def test_former_names_are_found_for_one_version(name):
    with pytest.warns(DeprecationWarning, match=rf"comove.{name} is now comove\.[\w.]+\.{name}") as told:
        found = getattr(comove, name)
    place = str(told[0].message).split(" is now ")[1].rpartition(".")[0]
    assert getattr(__import__(place, fromlist=[name]), name) is found


@pytest.mark.parametrize("kernel", ["planner.clearance_of", "planner.rrt_connect"])
def test_few_frames_lie_between_the_call_and_the_mathematics(kernel, monkeypatch):
    class Enough(Exception):
        """Ends the search where it begins to compute."""

    def frames(*_):
        frame, own = sys._getframe(1), []
        while frame is not None:
            if frame.f_globals["__name__"].startswith("comove."):
                own.append(frame.f_code.co_qualname)
            frame = frame.f_back
        raise Enough(own)

    scene = example("narrow")
    load_kernels(SceneKind.of(scene))
    monkeypatch.setattr(f"comove.planning.{kernel}", frames)
    with pytest.raises(Enough) as ended:
        comove.solve(scene)
    assert len(ended.value.args[0]) <= 6, ended.value.args[0]


def test_the_former_name_of_a_robots_call_says_the_new_one():
    with pytest.warns(DeprecationWarning, match=r"comove\.solve\(scene, robot=robot\)"):
        found = carry(gantry_scene(), robot("gantry"), budget=WORK)
    assert isinstance(found, Solution) and found.joints.verified


@pytest.mark.parametrize("enabled", [True, False])
def test_loading_names_leaves_the_garbage_collector_as_it_was(enabled):
    was = gc.isenabled()
    (gc.enable if enabled else gc.disable)()
    try:
        with suppress(RuntimeError), uncollected():
            assert not gc.isenabled()
            raise RuntimeError
        assert gc.isenabled() is enabled
    finally:
        (gc.enable if was else gc.disable)()


def test_threads_that_load_at_once_leave_the_garbage_collector_enabled():
    was, inside = gc.isenabled(), Barrier(2)
    gc.enable()
    try:
        first, second = uncollected(), uncollected()

        def enter_later():
            with second:
                inside.wait()
                inside.wait()  # for the first to have left

        other = Thread(target=enter_later)
        with first:
            other.start()
            inside.wait()
        assert not gc.isenabled()
        inside.wait()
        other.join()
        assert gc.isenabled()
    finally:
        (gc.enable if was else gc.disable)()
