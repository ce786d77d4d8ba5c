"""A second motion beside the first, in the same scene, on one clock: another method's, or one that is held."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from comove.scenes.scene import Scene
from comove.workbench.edits import METHODS, Draft
from comove.workbench.geometry import longest_side
from comove.workbench.link import Link
from comove.workbench.panels import Panels
from comove.workbench.protocol import Message
from comove.workbench.recording import RecordedMotion
from comove.workbench.stage import Stage
from comove.workbench.words import measures_words, named_in, verdict_words

NOTHING, HELD = "nothing", "the motion shown now"
CHOICES = (NOTHING, HELD, *METHODS)
PREFIX = "/beside"
APART = 1.2  # widths of the workspace, from one scene to the other
PATIENCE = 20.0  # s, that another method has


class Comparison:
    """The motion that stands beside that of a page.

    Parameters
    ----------
    client : the viewer's client
    loop : event loop of the page
    panels : panels of the page
    """

    def __init__(self, client: Any, loop: asyncio.AbstractEventLoop, panels: Panels):
        self.client, self.loop, self.panels = client, loop, panels
        self.chosen = NOTHING
        self.stage: Stage | None = None
        self._link: Link | None = None
        self._asked = -1
        self._closed = False

    def choose(
        self, choice: Any, scene: Scene, draft: Draft, shown: RecordedMotion | None, folder: Path
    ) -> None:
        """Show another method's motion, the one that is shown now, or nothing."""
        if choice not in CHOICES:
            return
        self.chosen = choice
        self.renew(scene, draft, folder)
        if choice == HELD and shown is not None and self.stage is not None:
            self.stage.draw_motion(shown)
            self.panels.beside.content = "Held: what is changed from now on is seen beside it."

    def renew(self, scene: Scene, draft: Draft, folder: Path) -> None:
        """Draw the scene anew after a change, and ask for the method's motion; what is held stays."""
        if self.chosen == HELD and self.stage is not None and self.stage.recording is not None:
            self.redraw()
            return
        self.stage, self._asked = None, -1
        self.panels.beside.content = ""
        self.client.scene.remove_by_name(PREFIX)
        if self.chosen == NOTHING:
            self._end()
            return
        self._lay(scene)
        if self.chosen != HELD:
            self._ask(replace(draft, method=self.chosen), folder)

    def redraw(self) -> None:
        """Draw again what is held, as the page's scene was cleared."""
        if self.stage is None or self.stage.recording is None:
            return
        recording = self.stage.recording
        self._lay(self.stage.scene)
        self.stage.draw_motion(recording)

    def _lay(self, scene: Scene) -> None:
        width = float(scene.upper[0] - scene.lower[0])
        self.client.scene.add_frame(PREFIX, show_axes=False, position=(APART * width, 0.0, 0.0))
        self.stage = Stage(self.client.scene, scene, PREFIX)
        self.stage.draw_scene()

    def _ask(self, draft: Draft, folder: Path) -> None:
        if self._link is None or self._link.folder != folder:
            self._end()
            self._link = Link(folder, self._hand_over)
        self._asked = self._link.submit(draft, budget=PATIENCE)
        self.panels.beside.content = f"**{self.chosen}** is searching ..."

    def _hand_over(self, message: Message) -> None:
        link = self._link
        with suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(self._answered, link, message)

    def _answered(self, link: Link | None, message: Message) -> None:
        header = message.header
        if self._closed or link is not self._link or header["id"] != self._asked or self.stage is None:
            return
        words = verdict_words(header["kind"], header.get("reasons", ()), header.get("verified_after"))
        if message.arrays:
            self.stage.draw_motion(RecordedMotion(**message.arrays), pale=header["kind"] == "failed")
        if header["kind"] == "failed":
            self.stage.blame(*named_in(self.stage.scene, header["reasons"]))
        if header.get("rows"):
            words += "\n\n" + measures_words(header["rows"])
        self.panels.beside.content = f"**{self.chosen}**: {words}"

    def show(self, time: float) -> None:
        """Show an instant [s], or the end where it comes later."""
        if self.stage is not None and self.stage.recording is not None:
            recording = self.stage.recording
            self.stage.show(recording.index_at(min(time, float(recording.time[-1]))))

    @property
    def shift(self) -> np.ndarray:
        """Return by how much the camera looks aside, so that both are seen; array, shape (3,) [m]."""
        if self.stage is None:
            return np.zeros(3)
        scene = self.stage.scene
        return np.array([0.5 * APART * float(scene.upper[0] - scene.lower[0]), 0.0, 0.0])

    @property
    def farther(self) -> float:
        """Return by which factor the camera stands farther off, so that both are seen."""
        if self.stage is None:
            return 1.0
        scene = self.stage.scene
        return 1.0 + 0.5 * float(scene.upper[0] - scene.lower[0]) / longest_side(scene)

    def _end(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None

    def close(self) -> None:
        """Free the planner."""
        self._closed = True
        self._end()
