"""Second motion beside the first, on one clock. It is another method's, a held one, or a stored one."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from comove.methods import OWN
from comove.view.workbench.edits import Draft, contents_of
from comove.view.workbench.link import Link, on_loop
from comove.view.workbench.panels import Panels
from comove.view.workbench.protocol import Message, SearchTimes
from comove.view.workbench.shelf import Item, read_scene
from comove.view.workbench.stage import BESIDE, Stage
from comove.view.workbench.words import measures_words, named_in, plain_text, verdict_words

NOTHING, HELD = "nothing", "the motion shown now"
CHOICES = (NOTHING, HELD, *OWN)  # and what was named


class Comparison:
    """Motion shown beside that of a page.

    Parameters
    ----------
    loop : event loop of the page
    panels : panels of the page
    items : named scenes and results that can be shown beside, by choice
    drawn : function that is called when a motion has been drawn
    times : times of another method's search
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        panels: Panels,
        items: Mapping[str, Item],
        drawn: Callable[[], None],
        times: SearchTimes,
    ):
        self.loop, self.panels, self.items, self._drawn, self.times = loop, panels, items, drawn, times
        self.chosen = NOTHING
        self.stage: Stage | None = None
        self._link: Link | None = None

    def choose(self, choice: Any, first: Stage, draft: Draft, folder: Path) -> None:
        """Show another method's motion, the present one, a stored one, or nothing.

        Parameters
        ----------
        first : stage beside which it is shown
        draft, folder : draft for another method, and the folder to which its paths are relative
        """
        if choice not in CHOICES and choice not in self.items:
            return
        self.close()
        self.chosen, self.stage = choice, None
        first.api.remove_by_name(BESIDE)
        first.name("")
        self.panels.beside.content = ""
        if choice in OWN:
            self._ask_method(first, draft, folder)
        elif choice == HELD:
            self._lay(first, first)
            self.panels.beside.content = "Held: what is changed from now on is seen beside it."
        elif choice in self.items:
            item = self.items[choice]
            scene = read_scene(item.scene)
            self._lay(first, Stage(first.api, scene))
            self._ask(Draft(contents_of(scene)), item.scene.parent, item)
        self._drawn()

    def renew(self, first: Stage, draft: Draft, folder: Path) -> None:
        """Draw the changed scene, and request the method's motion again. Other motions stay unchanged."""
        if self.chosen in OWN:
            self._ask_method(first, draft, folder)
        elif self.stage is not None:
            self._lay(first, self.stage)

    def _ask_method(self, first: Stage, draft: Draft, folder: Path) -> None:
        self._lay(first, Stage(first.api, first.scene, robot=first.robot))
        self._ask(replace(draft, method=self.chosen), folder)

    def _lay(self, first: Stage, drawn: Stage) -> None:
        """Draw the content of another stage to the right."""
        self.stage = Stage.beside(first, drawn.scene)
        self.stage.touches = drawn.touches
        self.stage.draw_scene()
        if drawn.robot is not None:
            self.stage.draw_robot(drawn.robot.bodies, drawn.robot.home)
        if drawn.recording is not None:
            self.stage.draw_motion(drawn.recording, pale=drawn.pale)
        first.name("shown now")
        self.stage.name("held" if self.chosen == HELD else self.chosen)

    def _ask(self, draft: Draft, folder: Path, item: Item | None = None) -> None:
        if self._link is None or self._link.folder != folder:
            self.close()
            self._link = Link(folder, on_loop(self.loop, self._answered))
        self._link.submit(draft, self.times, item=item)
        doing = "is searching" if item is None or item.result is None else "is verified"
        self.panels.beside.content = f"**{plain_text(self.chosen)}** {doing} ..."

    def _answered(self, link: Link, message: Message) -> None:
        kind, stage = message["kind"], self.stage
        if link is not self._link or stage is None:
            return
        if kind == "robot" and stage.robot is None and stage.scene.file.robot is not None:
            stage.draw_robot(message["bodies"], message["home"])
        if message["id"] != link.asked:
            return
        failed, reasons = kind == "failed", message.get("reasons", ())
        words = verdict_words(kind, reasons, message.get("verified_after"), message.get("verdict", ""))
        if recording := message.get("recording"):
            stage.touches = message.get("touches", ())
            stage.draw_motion(recording, pale=failed)
        if failed:
            stage.blame(*named_in(stage.scene, reasons))
        if message.get("rows"):
            words += "\n\n" + measures_words(message["rows"], message["proved"])
        self.panels.beside.content = f"**{plain_text(self.chosen)}**: {words}"
        self._drawn()

    def show(self, time: float) -> None:
        """Show an instant [s], or the end if that is earlier."""
        if self.stage is not None and self.stage.recording is not None:
            self.stage.show(self.stage.recording.index_at(time))

    @property
    def end(self) -> float:
        """Return the end of the second motion [s], or 0."""
        recording = None if self.stage is None else self.stage.recording
        return 0.0 if recording is None else float(recording.time[-1])

    def close(self) -> None:
        """Close the planner; its further answers are ignored."""
        if self._link is not None:
            self._link.close()
            self._link = None
