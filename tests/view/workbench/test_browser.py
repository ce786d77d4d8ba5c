"""The workbench in a real browser: it opens, drags, plays, scrubs, steers, and saves, and the console is silent."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import comove
from comove.lab.examples import example_path
from comove.results import read_result, verify_result
from comove.view.workbench.shelf import shelf_of

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")
pytest.importorskip("playwright", reason="playwright is not installed: pip install 'comove[dev]'")

from tests.view.workbench import browser as chrome

EXAMPLES = Path(__file__).parents[3] / "examples"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chrome.CHROMIUM is None, reason="there is no chromium: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def chromium():
    with chrome.browser() as running:
        yield running


@pytest.fixture
def open_scene(chromium, tmp_path):
    """A function that opens a scene, by name, in the browser."""
    opened = []

    def opener(name):
        shutil.copy(example_path(name), tmp_path / f"{name}.yaml")
        opened.append(chrome.Bench(chromium, shelf_of([tmp_path / f"{name}.yaml"], tmp_path)))
        return opened[-1]

    yield opener
    for bench in opened:
        errors = bench.errors
        bench.close()
        assert not errors


@pytest.mark.parametrize("name", ["narrow", "window", "turning", "triangle"])
def test_every_kind_of_scene_opens_with_its_verified_motion(open_scene, name):
    bench = open_scene(name)
    bench.says("at every instant")
    bench.says("clearance [mm]")
    assert bench.page.locator(".uplot").count() == 4


def test_a_dragged_obstacle_gets_a_motion_that_is_verified(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    before, height = session.stage.recording, [0.0, 0.0, 0.03]
    centre = session.scene.centers[1].copy()
    bench.drag(centre + height, centre + height + [0.1, 0.02, 0.0])
    bench.until(lambda: session.history.at == 1)
    bench.settle()
    moved = session.scene.centers[1] - centre
    np.testing.assert_allclose(moved, [0.1, 0.02, 0.0], atol=0.02)
    assert session.stage.recording is not before
    assert not session.stage.pale
    bench.says("after the change")
    bench.tab("Steer")
    bench.press("Undo")
    bench.until(lambda: session.history.at == 0)
    np.testing.assert_allclose(session.scene.centers[1], centre)


def test_what_is_clicked_gets_arrows_that_move_it_along_an_axis(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    bench.tab("Steer")
    centre, height = session.scene.centers[1].copy(), np.array([0.0, 0.0, 0.03])
    bench.page.mouse.click(*bench.pixel(centre + height))
    bench.says("is taken")
    bench.page.wait_for_timeout(1500)
    arrow = np.array(session.pointer.gizmo.position) + [0.12, 0.0, 0.0]
    bench.drag(arrow, arrow + [0.08, 0.03, 0.0])
    bench.until(lambda: session.history.at == 1)
    bench.settle()
    moved = session.scene.centers[1] - centre
    assert 0.03 < moved[0] < 0.13
    assert abs(moved[1]) < 1e-6, "an arrow moves along its axis only"


def test_in_space_too(open_scene):
    bench = open_scene("window")
    bench.settle()
    session = bench.session
    post, grasped = session.scene.centers[4].copy(), np.array([0.0, 0.0, -0.25])
    bench.drag(post + grasped, post + grasped + [0.0, 0.0, 0.1])
    bench.until(lambda: session.history.at == 1)
    bench.settle()
    assert session.scene.centers[4][2] > post[2] + 0.05
    assert not session.stage.pale


def test_a_movement_is_drawn_and_learned(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    before = session.stage.recording.center
    bench.tab("Teach")
    bench.press("Show a movement")
    bench.says("Draw now")
    bench.page.wait_for_timeout(1500)
    shares = np.linspace(0.0, 1.0, 40)
    way = np.stack([0.15 + 0.7 * shares, 0.5 + 0.3 * np.sin(2 * np.pi * shares), 0.0375 + 0 * shares], axis=1)
    bench.draw(way)
    bench.says("Learned")
    bench.settle()
    drawn = np.array(session.history.now.taught)[:, 1:]
    assert np.abs(drawn[:, 1]).max() > 0.7
    assert np.abs(session.stage.recording.center - before).max() > 0.05


def test_it_plays_pauses_and_is_scrubbed(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    first = session.player.time
    bench.until(lambda: session.player.time != first)
    bench.press("Pause")
    bench.until(lambda: not session.player.playing)
    stopped = session.player.time
    bench.page.wait_for_timeout(400)
    assert session.player.time == stopped
    slider = bench.page.get_by_role("slider").first
    slider.focus()
    slider.press("Home")
    bench.until(lambda: session.player.time == 0.0)
    slider.press("End")
    bench.until(lambda: session.player.time == pytest.approx(10.0, abs=0.02))
    bench.press("Play")
    bench.until(lambda: session.player.playing)


def test_a_limit_is_changed_and_kept(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    bench.tab("Steer")
    field = bench.page.get_by_label("duration [s], 0: least")
    field.fill("6")
    field.press("Enter")
    bench.until(lambda: session.history.now.contents["duration"] == 6.0)
    bench.settle()
    assert session.stage.recording.time[-1] == pytest.approx(6.0)


def test_scene_and_result_are_saved(open_scene, tmp_path):
    bench = open_scene("narrow")
    bench.settle()
    bench.tab("Save")
    bench.press("Save scene")
    bench.says("Saved: steered.yaml")
    bench.press("Save result")
    bench.until(lambda: (tmp_path / "steered" / "solution.json").is_file())
    scene = comove.Scene.load(tmp_path / "steered.yaml")
    assert verify_result(read_result(tmp_path / "steered"), scene).verified is not None


def test_a_robot_is_drawn_and_its_arms_are_verified(chromium, tmp_path):
    pytest.importorskip("pinocchio", reason="robots are not installed: pip install 'comove[robot]'")
    shutil.copy(EXAMPLES / "robots" / "two_pandas.yaml", tmp_path / "pair.yaml")
    bench = chrome.Bench(chromium, shelf_of([tmp_path / "pair.yaml"], tmp_path))
    try:
        bench.settle()
        bench.says("share of torques")
        bench.plotted()
        session = bench.session
        assert session.stage.recording.links.shape[1] == 14
        place = tuple(session.stage.robot.joints[6].position)
        bench.until(lambda: tuple(session.stage.robot.joints[6].position) != place)
        assert not bench.errors
    finally:
        bench.close()


def test_a_run_is_live_and_then_played(open_scene):
    bench = open_scene("narrow")
    bench.settle()
    session = bench.session
    bench.tab("Run")
    bench.press("Run it live")
    bench.says("the load follows a plan")
    assert not session.panels.controls["time"].visible  # nothing is recorded yet
    bench.says("This is what happened")
    assert not session.live and session.panels.controls["time"].visible
    assert session.stage.recording.time[-1] == pytest.approx(10.0, abs=0.5)
    bench.says("Executed, and verified at every instant")


def test_two_stored_results_stand_side_by_side(chromium, tmp_path):
    for method in ("comove", "paper"):
        command = ["solve", str(example_path("narrow")), "--method", method, "--out", method]
        done = subprocess.run([sys.executable, "-m", "comove", *command], cwd=tmp_path, timeout=600)
        assert done.returncode == 0
    bench = chrome.Bench(chromium, shelf_of([tmp_path / "comove", tmp_path / "paper"], tmp_path))
    try:
        bench.settle()
        bench.tab("Compare")
        bench.says("stored: paper: Verified at every instant, anew from the result's files")
        assert bench.page.locator("input[role=combobox][value='stored: paper']").count() == 1
        first, second = bench.session.stage, bench.session.comparison.stage
        assert first.recording is not None and second.recording is not None
        assert second.aside[0] > 1.0
        assert not bench.errors
    finally:
        bench.close()


def test_another_example_is_chosen(chromium, tmp_path):
    bench = chrome.Bench(chromium, shelf_of([], tmp_path))
    try:
        bench.settle()
        bench.page.locator("input[role=combobox][value=narrow]").click()
        bench.page.get_by_role("option", name="wide", exact=True).click()
        bench.until(lambda: bench.session.scene.name == "wide")
        bench.settle()
        assert not bench.errors
    finally:
        bench.close()


def test_the_page_without_a_server_plays(chromium, tmp_path):
    file, asked, errors = tmp_path / "narrow.html", [], []
    command = [sys.executable, "-m", "comove", "view", str(example_path("narrow")), "--html", str(file)]
    assert subprocess.run(command, timeout=600).returncode == 0
    assert file.stat().st_size < 5e6
    page = chromium.new_page(viewport=chrome.SIZE)
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(file.as_uri())
    page.get_by_text("verified at every instant").wait_for()
    page.locator("canvas").first.wait_for()
    page.wait_for_timeout(3000)
    page.close()
    assert not errors
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))], "nothing is loaded"


def test_a_report_plays_its_motion(chromium, tmp_path):
    for command in (
        ["solve", str(example_path("wide")), "--out", "result", "--budget", "5"],
        ["report", "result", "--html", "report.html"],
    ):
        assert (
            subprocess.run([sys.executable, "-m", "comove", *command], cwd=tmp_path, timeout=600).returncode
            == 0
        )
    page, errors = chromium.new_page(viewport=chrome.SIZE), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((tmp_path / "report.html").as_uri())
    page.get_by_text("anew from the files").wait_for()
    page.frame_locator("iframe").locator("canvas").first.wait_for(timeout=chrome.PATIENCE)
    page.wait_for_timeout(2000)
    page.screenshot(path=tmp_path / "report.png")
    page.close()
    assert not errors
