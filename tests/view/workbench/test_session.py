"""Pages are sessions of their own: each with its planner, which is ended with it."""

import shutil
import threading
import time

import numpy as np
import pytest

import comove
from comove.lab.examples import example, example_path
from comove.view.workbench.edits import contents_of, grips_of, moved, place_of
from comove.view.workbench.playback import playback_of
from comove.view.workbench.shelf import shelf_of
from comove.view.workbench.teaching import Stroke

viser = pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")

from comove.view.workbench.server import serve  # noqa: E402
from comove.view.workbench.session import Session  # noqa: E402
from comove.view.workbench.stage import BLOCKS  # noqa: E402
from tests.commands import invoke  # noqa: E402
from tests.killing import alive, soon  # noqa: E402
from tests.view.workbench.pages import Page  # noqa: E402


@pytest.fixture
def opened(bench):
    """A page that is open and shows its motion, its session, and the folder that it was started in."""
    guarded, sessions, folder = bench
    page = Page(guarded.address.rstrip("/")).appear()
    page.verdict("The search is done")
    (session,) = sessions
    yield page, session, folder
    page.close()


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A running workbench on the example `narrow`, and its sessions as they are made."""
    sessions, plain = [], Session.__init__

    def made(self, *arguments):
        plain(self, *arguments)
        sessions.append(self)

    monkeypatch.setattr(Session, "__init__", made)
    shutil.copy(example_path("narrow"), tmp_path / "narrow.yaml")
    guarded = serve(shelf_of([tmp_path / "narrow.yaml"], tmp_path))
    yield guarded, sessions, tmp_path
    for session in sessions:
        session.close()
    guarded.stop()


def on_loop(session, function, *arguments, **options):
    """Call a method of a session where its page would, and wait for it."""
    done, result = threading.Event(), []

    def call():
        try:
            result.append(function(*arguments, **options))
        finally:
            done.set()

    session.loop.call_soon_threadsafe(call)
    assert done.wait(600)
    return result[0]


def test_a_page_shows_scene_and_verified_motion_and_frees_its_planner(bench):
    guarded, sessions, folder = bench
    page = Page(guarded.address.rstrip("/")).appear()
    page.verdict("The search is done")
    names = {message.get("name") for message in page.messages}
    assert {"/obstacle_0", "/obstacle_1", "/start_0", "/goal_0", "/load/rod_0", "/path_load"} <= names
    (session,) = sessions
    pid = session.link.pid
    assert alive(pid)
    page.close()
    soon(lambda: not alive(pid))
    assert [entry.name for entry in folder.iterdir()] == ["narrow.yaml"], "nothing is written without a wish"


@pytest.mark.slow
def test_a_dragged_obstacle_gets_a_motion_of_its_own_and_can_be_undone_and_saved(opened):
    _, session, folder = opened
    before = session.stage.recording
    grip = grips_of(session.scene)[0]
    to = place_of(session.history.now.contents, grip) + [0.0, -0.03, 0.0]
    on_loop(session, session.move, grip, to, None, last=True)
    soon(lambda: session.link.solved == session.link.asked)
    np.testing.assert_allclose(session.scene.centers[0], to, atol=1e-6)
    assert session.stage.recording is not before
    assert not session.stage.pale
    on_loop(session, session.changed, "save result", True)
    session.panels.controls["name"].value = "steered"
    on_loop(session, session.changed, "save result", True)
    on_loop(session, session.changed, "save scene", True)
    soon(lambda: (folder / "steered" / "solution.json").is_file())
    scene = comove.Scene.load(folder / "steered.yaml")
    from comove.results import read_result, verify_result

    assert verify_result(read_result(folder / "steered"), scene).verified is not None
    on_loop(session, session.changed, "undo", True)
    assert session.history.at == 0
    np.testing.assert_allclose(session.scene.centers[0], example("narrow").centers[0])


def test_where_no_motion_is_the_page_says_what_is_in_the_way_and_the_old_one_stays_grey(opened):
    page, session, _ = opened
    grip = grips_of(session.scene)[0]
    start = session.scene.start.mean(axis=0)
    on_loop(session, session.move, grip, np.array([*start, 0.0]), None, last=True)
    assert "at the start the load or a hand" in page.verdict("No verified motion")
    assert session.stage.pale
    assert session.stage.recording is not None
    on_loop(session, session.changed, "undo", True)
    on_loop(session, session.changed, "duration", 0.1)
    assert "would do" in page.verdict("too short")
    assert session.stage.pale


@pytest.mark.slow
def test_just_the_obstacle_that_is_named_is_coloured(opened):
    page, session, _ = opened
    grip = grips_of(session.scene)[0]
    start = np.array([*session.scene.start.mean(axis=0), 0.0])
    on_loop(session, session.move, grip, start, None, last=True)
    assert "obstacles\\[0] (box)" in page.verdict("No verified motion")
    assert [tuple(handle.color) == BLOCKS for handle in session.stage.obstacles] == [True, False]
    on_loop(session, session.changed, "undo", True)
    soon(lambda: session.link.solved == session.link.asked)
    assert not any(tuple(handle.color) == BLOCKS for handle in session.stage.obstacles)


@pytest.mark.slow
def test_an_obstacle_is_led_while_the_load_goes_and_what_happened_is_judged_and_saved(opened):
    page, session, folder = opened
    on_loop(session, session.changed, "duration", 5.0)
    soon(lambda: session.link.solved == session.link.asked)
    on_loop(session, session.changed, "run", True)
    assert session.live
    place = session.scene.centers[1] + [-0.1, 0.05, 0.0]
    on_loop(session, session.link.lead, 1, place.tolist())
    soon(lambda: not session.live)
    soon(lambda: session.link.solved == session.link.asked)
    ran = session.stage.recording
    np.testing.assert_allclose(session.scene.centers[1] + ran.offsets[-1, 1], place, atol=1e-6)
    assert not ran.offsets[:, 0].any()
    page.verdict("**Executed, and verified at every instant**")
    session.panels.controls["name"].value = "ran"
    on_loop(session, session.changed, "save result", True)
    soon(lambda: (folder / "ran" / "run.json").is_file())
    assert playback_of(folder / "ran").holds


@pytest.mark.slow
def test_a_run_is_stopped_by_its_button_and_by_a_change(opened):
    page, session, _ = opened
    on_loop(
        session, session.changed, "duration", 60.0
    )  # far longer than a busy machine takes to press the button
    soon(lambda: session.link.solved == session.link.asked)
    on_loop(session, session.changed, "run", True)
    page.verdict("the load follows")
    on_loop(session, session.changed, "run", True)
    soon(lambda: not session.live)
    page.verdict("the goal is missed")
    assert session.stage.pale
    on_loop(session, session.changed, "run", True)
    on_loop(session, session.changed, "duration", 6.0)
    assert not session.live
    soon(lambda: session.link.solved == session.link.asked)
    assert session.stage.recording.time[-1] == pytest.approx(6.0)


@pytest.mark.slow
def test_a_result_takes_the_place_of_no_other_folder(opened):
    page, session, folder = opened
    (folder / "taken").mkdir()
    (folder / "taken" / "letter.txt").write_text("mine")
    session.panels.controls["name"].value = "taken"
    on_loop(session, session.changed, "save result", True)
    assert "not empty" in page.verdict("**Not saved.**")
    assert [entry.name for entry in (folder / "taken").iterdir()] == ["letter.txt"]


def test_a_box_is_added_resized_and_removed_and_all_of_it_undone(opened):
    _, session, _ = opened
    n_before = len(session.scene.file.obstacles)
    on_loop(session, session.changed, "add box", True)
    assert session.pointer.selected.number == n_before
    assert session.panels.controls["remove"].visible and session.panels.controls["first size"].visible
    on_loop(session, session.changed, "first size", 0.02)
    on_loop(session, session.changed, "second size", 0.03)
    box = session.scene.file.obstacles[n_before]
    assert box.name == "box_1" and tuple(box.size) == (0.02, 0.03)
    assert session.pointer.selected.number == n_before, "what is resized stays taken"
    on_loop(session, session.changed, "remove", True)
    assert len(session.scene.file.obstacles) == n_before and session.pointer.selected is None
    assert not session.panels.controls["remove"].visible
    on_loop(session, session.changed, "undo", True)
    assert len(session.scene.file.obstacles) == n_before + 1
    on_loop(session, session.changed, "undo", True)
    on_loop(session, session.changed, "undo", True)
    on_loop(session, session.changed, "undo", True)
    assert session.history.at == 0


@pytest.mark.slow
def test_pages_do_not_disturb_each_other(bench):
    guarded, sessions, _ = bench
    first, second = (Page(guarded.address.rstrip("/")).appear() for _ in range(2))
    for page in (first, second):
        page.verdict("The search is done")
    assert sessions[0].link.pid != sessions[1].link.pid
    on_loop(sessions[0], sessions[0].changed, "duration", 7.0)
    assert sessions[1].history.now.contents["duration"] == 10.0
    pid = sessions[1].link.pid
    first.close()
    soon(lambda: sessions[0].player.closed)
    assert alive(pid)
    second.close()


@pytest.mark.slow
def test_a_method_is_shown_beside_on_one_clock_with_its_verdict(opened):
    page, session, _ = opened
    on_loop(session, session.changed, "beside", "projection")
    assert "erified" in page.verdict("**projection**: **")
    other = session.comparison.stage
    assert other.recording is not None
    assert {"/name", "/beside/name", "/beside/load/rod_0"} <= {m.get("name") for m in page.messages}
    assert other.recording.time[-1] == session.stage.recording.time[-1]
    pid = session.comparison._link.pid
    on_loop(session, session.changed, "beside", "nothing")
    soon(lambda: not alive(pid))


@pytest.mark.slow
def test_a_drawn_movement_is_learned_used_at_once_and_kept(opened):
    _, session, folder = opened
    before = session.stage.recording.center
    on_loop(session, session.changed, "draw", True)
    stroke = Stroke(2)
    for share in np.linspace(0.0, 1.0, 60):
        point = np.array([0.15 + 0.7 * share, 0.5 - 0.3 * np.sin(2 * np.pi * share), 0.0])
        on_loop(session, session._drawn, stroke, point, last=share == 1.0)
        time.sleep(0.02)
    assert session.history.now.taught is not None
    soon(lambda: session.link.solved == session.link.asked)
    after = session.stage.recording.center
    assert np.abs(after - before).max() > 0.1, "the load moves as was drawn"
    assert after[:, 1].min() < 0.35
    session.panels.controls["movement"].value = "../wave"
    on_loop(session, session.changed, "keep", True)
    assert not (folder / "library").exists()
    session.panels.controls["movement"].value = "wave"
    on_loop(session, session.changed, "keep", True)
    assert comove.Library(folder / "library").names == ("wave",)
    assert session.history.now.contents["demonstration"]["library"] == "wave"
    soon(lambda: session.link.solved == session.link.asked)
    assert np.abs(session.stage.recording.center - after).max() < 0.05, (
        "the primitive in the library is what was drawn"
    )


@pytest.fixture
def two_stored(bench):
    """A page of two stored results, of which the second takes longer, its session and their folder."""
    _, sessions, folder = bench
    for name, duration in (("first", 10.0), ("second", 14.0)):
        options = ("--duration", duration, "--out", name, "--budget", 2)
        assert invoke("solve", "narrow.yaml", *options, folder=folder).exit_code == 0
    guarded = serve(shelf_of([folder / "first", folder / "second"], folder))
    page = Page(guarded.address.rstrip("/")).appear()
    soon(
        lambda: sessions and sessions[-1].link.solved == sessions[-1].link.asked
    )  # either of the two may come first
    yield page, sessions[-1], folder
    page.close()
    guarded.stop()


@pytest.mark.slow
def test_a_stored_result_stands_beside_another_on_one_clock(two_stored):
    page, session, _ = two_stored
    assert "Verified at every instant" in page.verdict("**stored: second**: **")
    other = session.comparison.stage.recording
    assert (session.stage.recording.time[-1], other.time[-1]) == (10.0, 14.0)
    assert session.end == session.panels.controls["time"].max == 14.0
    on_loop(session, session.changed, "time", 13.0)
    on_loop(session, session.changed, "duration", 7.0)
    soon(lambda: session.link.solved == session.link.asked)
    assert session.comparison.stage.recording is other, (
        "what is stored stays when the scene beside it changes"
    )
    on_loop(session, session.changed, "beside", "nothing")
    assert session.end == session.panels.controls["time"].max == 7.0
    assert session.player.time <= 7.0


@pytest.mark.slow
def test_what_is_held_stays_while_the_scene_changes(opened):
    _, session, _ = opened
    on_loop(session, session.changed, "beside", "the motion shown now")
    held = session.comparison.stage.recording
    assert held is session.stage.recording
    on_loop(session, session.changed, "duration", 7.0)
    soon(lambda: session.link.solved == session.link.asked)
    assert session.comparison.stage.recording is held
    assert session.stage.recording.time[-1] == pytest.approx(7.0)


@pytest.mark.slow
def test_what_no_control_sends_changes_nothing(bench):
    guarded, sessions, _ = bench
    page = Page(guarded.address.rstrip("/")).appear()
    soon(lambda: sessions)
    (session,) = sessions
    for name, value in (
        ("duration", float("nan")),
        ("speed", -1.0),
        ("bar", 0.0),
        ("method", "magic"),
        ("objective", None),
        ("resemblance", 7.0),
        ("pace", "fast"),
        ("time", "noon"),
        ("shown", "../../etc/passwd"),
        ("beside", "magic"),
        ("no such control", 1.0),
    ):
        on_loop(session, session.changed, name, value)
        assert session.history.at == 0, name
    page.close()


def test_names_with_paths_are_not_saved(opened):
    _, session, folder = opened
    for name in ("../out", "/tmp/out", "a/b", ""):
        session.panels.controls["name"].value = name
        on_loop(session, session.changed, "save scene", True)
        on_loop(session, session.changed, "save result", True)
        assert "no plain name" in session.panels.saved.content
    assert [entry.name for entry in folder.iterdir()] == ["narrow.yaml"]


def test_moved_contents_are_those_of_the_page():
    scene = example("narrow")
    grip = grips_of(scene)[0]
    contents = moved(contents_of(scene), grip, np.array([0.5, 0.2, 0.0]))
    assert contents["obstacles"][0]["center"] == [0.5, 0.2]
