"""A page of a robot scene: the arms are drawn, follow every motion, and are saved with it."""

import shutil
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")
pytest.importorskip("pinocchio", reason="robots are not installed: pip install 'comove[robot]'")

from comove.robots import verify_stored
from comove.view.workbench.edits import grips_of, place_of
from comove.view.workbench.protocol import SearchTimes
from comove.view.workbench.server import serve
from comove.view.workbench.session import PageSettings, Session
from comove.view.workbench.shelf import shelf_of
from tests.killing import soon
from tests.view.workbench.pages import Page
from tests.view.workbench.test_session import on_loop

SCENE = Path(__file__).parents[3] / "examples" / "robots" / "two_pandas.yaml"

pytestmark = pytest.mark.slow


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """A page that shows a robot and its verified motion, its session, and the folder that it was started in."""
    sessions, plain = [], Session.__init__

    def made(self, *arguments):
        plain(self, *arguments)
        sessions.append(self)

    monkeypatch.setattr(Session, "__init__", made)
    shutil.copy(SCENE, tmp_path / "pair.yaml")
    settings = PageSettings(arms=SearchTimes(budget=12.0, patience=1.5))
    guarded = serve(shelf_of([tmp_path / "pair.yaml"], tmp_path), settings=settings)
    page = Page(guarded.address.rstrip("/")).appear()
    page.verdict("The search is done", timeout=600)
    yield page, sessions[0], tmp_path
    page.close()
    sessions[0].close()
    guarded.stop()


def test_arms_are_drawn_once_and_follow_what_is_dragged(opened):
    page, session, folder = opened
    names = {message.get("name") for message in page.messages}
    assert {"/robot", "/robot/joint_0", "/robot/joint_13"} <= names
    before = session.stage.recording
    assert before.links.shape[1] == 14
    page.messages.clear()
    grip = grips_of(session.scene)[1]
    to = place_of(session.history.now.contents, grip) + [0.03, 0.0, 0.0]
    on_loop(session, session.move, grip, to, None, last=True)
    page.verdict("The search is done", timeout=600)
    assert session.link.solved == session.link.asked
    after = session.stage.recording
    assert after is not before and not session.stage.pale
    assert "share of torques" in session.panels.measures.content
    meshes = [message["name"] for message in page.messages if message["type"] == "MeshMessage"]
    assert meshes and not [name for name in meshes if "/body_" in name], "its meshes are not sent again"
    hands = after.nodes[0, :2]
    last = [int(arm[-1]) for arm in (np.arange(7), np.arange(7, 14))]
    assert np.linalg.norm(after.links[0, last, :3] - hands, axis=1).max() < 0.3, "arms are at the load"
    on_loop(session, session.changed, "save result", True)
    soon(lambda: (folder / "steered" / "robot.json").is_file())
    assert verify_stored(folder / "steered").verified is not None


def test_where_an_arm_cannot_reach_it_says_so(opened):
    page, session, _ = opened
    grip = next(grip for grip in grips_of(session.scene) if grip.kind == "goal")
    contents = session.history.now.contents
    wide = contents | {"workspace": {"lower": [-1.0, -2.0, -0.5], "upper": [2.0, 2.0, 1.0]}}
    on_loop(session, session.commit, session.history.now.with_contents(wide))
    to = place_of(contents, grip) + [1.0, 0.0, 0.0]
    on_loop(session, session.move, grip, to, None, last=True)
    assert "cannot reach its goal" in page.verdict("No verified motion", timeout=600)
    assert session.stage.pale
