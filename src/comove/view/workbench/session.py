"""One page: its scene, history and planner, and its responses to input.

Everything here runs on the viewer's event loop, one step at a time, so nothing is locked. The planner answers from a
thread of its own, and its answers are passed to the loop.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveError
from comove.geometry.rotations import conjugate, quaternion_product
from comove.model.scene import Scene
from comove.view.workbench.comparison import CHOICES, Comparison
from comove.view.workbench.edits import (
    SIZES,
    VALUES,
    Draft,
    Grip,
    History,
    contents_of,
    moved,
    with_box,
    with_size,
    with_value,
    without_obstacle,
)
from comove.view.workbench.link import Link, on_loop
from comove.view.workbench.live import State
from comove.view.workbench.panels import Panels
from comove.view.workbench.playback import RecordedMotion
from comove.view.workbench.player import Player, PlayerSettings
from comove.view.workbench.pointer import Pointer, on_plane
from comove.view.workbench.protocol import Message, SearchTimes
from comove.view.workbench.saving import save_scene, target_in
from comove.view.workbench.shelf import Item, Shelf, read_scene
from comove.view.workbench.stage import ROBOT, Stage, clear, demonstrated
from comove.view.workbench.teaching import Stroke, keep
from comove.view.workbench.words import measures_words, named_in, plain_text, verdict_words

UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
VERIFIED = ("stored", "kept", "found", "solved", "ran")
FINAL = ("stored", "solved", "ran")  # of these, after which nothing better comes


@dataclass(frozen=True)
class PageSettings:
    """Settings of the workbench's pages.

    Attributes
    ----------
    hands, arms : times of searches where hands move alone, and where the arms of a robot follow, which takes longer
    beside : times of a search by another method, whose motion stands beside
    most_pages : pages that are served at once, as each has a planner
    player : settings of the clock by which motions are played
    """

    hands: SearchTimes = field(default_factory=SearchTimes)
    arms: SearchTimes = field(default_factory=lambda: SearchTimes(budget=15.0, patience=1.5))
    beside: SearchTimes = field(default_factory=lambda: SearchTimes(budget=20.0))
    most_pages: int = 6
    player: PlayerSettings = field(default_factory=PlayerSettings)

    def times_of(self, scene: Scene) -> SearchTimes:
        """Return the times of a search in a scene."""
        return self.hands if scene.file.robot is None else self.arms


class Session:
    """One page.

    Parameters
    ----------
    client : the viewer's client
    loop : event loop on which everything happens
    shelf : scenes to choose from
    settings : settings of searches and playback
    """

    def __init__(
        self,
        client: Any,
        loop: asyncio.AbstractEventLoop,
        shelf: Shelf,
        settings: PageSettings = PageSettings(),
    ):
        self.client, self.loop, self.shelf, self.settings = client, loop, shelf, settings
        self.note = ""
        names = tuple(shelf.items) if len(shelf.items) > 1 else ()
        beside = shelf.comparable
        self.panels = Panels(client.gui, self.changed, names, shelf.first, (*CHOICES, *beside))
        self.comparison = Comparison(loop, self.panels, beside, self._stretch, settings.beside)
        self.stage: Stage
        self.link: Link
        self.pointer, self.live = Pointer(), False
        self.player = Player(self._playable, self._play, settings.player)
        first = shelf.items[shelf.first]
        self._begin(first, read_scene(first.scene))
        if shelf.beside is not None:
            self.panels.controls["beside"].value = shelf.label(shelf.beside)
            self._compare(shelf.label(shelf.beside))
        self.player.start(loop)

    @property
    def scene(self) -> Scene:
        """Return the scene that is shown."""
        return self.stage.scene

    # --- scenes ---

    def _open(self, name: Any) -> None:
        """Show another item of the shelf, and request its motion."""
        if name not in self.shelf.items:
            return
        item = self.shelf.items[name]
        scene = read_scene(item.scene)
        self.link.close()
        self.player.time, self.pointer.selected, self.note = 0.0, None, ""
        if self.live:
            self._end_run()
        self.client.scene.remove_by_name(ROBOT)
        self._begin(item, scene)

    def _begin(self, item: Item, scene: Scene) -> None:
        """Show an item with a planner and a history of its own."""
        self.link = Link(item.scene.parent, on_loop(self.loop, self._answered))
        self.history = History((Draft(contents_of(scene)),))
        self._lay(scene)
        self._look()
        self._ask(item=item)

    def _lay(self, scene: Scene, before: Stage | None = None) -> None:
        """Draw a scene that has been read.

        Parameters
        ----------
        before : stage of the same scene before its change
        """
        selected = self.pointer.forget()
        shown = before.recording if before is not None else None
        again = before is not None and before.scene.manipulators == scene.manipulators
        clear(self.client.scene)
        self.stage = Stage(self.client.scene, scene, robot=None if before is None else before.robot)
        self.stage.draw_scene(demonstrated(scene, self.history.now.taught))
        grips = self.stage.grips()
        for grip, handle in grips.items():
            self._make_draggable(grip, handle)
        if selected is not None and selected in grips:
            self._show_gizmo(selected, grips[selected])
        self.panels.fill(self.history.now, scene, self.pointer.selected)
        alike = again and shown is not None and shown.nodes.shape[1] == scene.body.n_nodes
        if shown is not None and alike and shown.offsets.shape[1] == len(scene.file.obstacles):
            self.stage.draw_motion(shown, pale=True)
        self.comparison.renew(self.stage, self.history.now, self.link.folder)

    def _compare(self, choice: Any) -> None:
        self.comparison.choose(choice, self.stage, self.history.now, self.link.folder)
        self._look()

    def _look(self) -> None:
        position, look_at, up = self.stage.camera(self.comparison.stage)
        camera = self.client.camera
        upright = camera.image_width / camera.image_height
        if upright < 1.0:  # of a phone, whose lower half the panel covers
            away = (position - look_at) / upright
            distance = float(np.linalg.norm(away))
            shown_up = up - (up @ away) * away / distance**2
            down = 0.5 * distance * np.tan(0.5 * camera.fov) * shown_up / np.linalg.norm(shown_up)
            look_at = look_at - down
            position = look_at + away
        self.client.camera.up_direction = up
        self.client.camera.position = position
        self.client.camera.look_at = look_at

    # --- dragging ---

    def _make_draggable(self, grip: Grip, handle: Any) -> None:
        async def dragged(event: Any) -> None:
            self._dragged(grip, handle, event)

        async def clicked(_: Any) -> None:
            self._show_gizmo(grip, handle)

        handle.on_drag(dragged)
        handle.on_click(clicked)

    def _dragged(self, grip: Grip, handle: Any, event: Any) -> None:
        """Move a grip with the pointer. In the plane it moves along it, in space across the line of sight. During a
        run, obstacles are dragged, and drawn at its states."""
        if self.live and grip.kind != "obstacle":
            return
        drawn = np.array(handle.position, dtype=float) if self.live else None
        taken = np.array(event.start_position, dtype=float)
        held = self.pointer.hold(event, grip, self.history.now.contents, taken, UNTURNED, drawn)
        to = held.pointed(event, self.client.camera.position, self.scene.n_dims == 2)
        last = event.phase == "end"
        if self.live:
            if to is not None:
                self.link.lead(grip.number, to.tolist())
            self.pointer.held = None if last else held
        elif to is not None:
            lift = self.stage.lift if grip.kind != "obstacle" else 0.0
            handle.position = tuple(to + [0.0, 0.0, lift])
            self.move(grip, to, None, last=last)

    def move(self, grip: Grip, to: Array, turn: Array | None, *, last: bool) -> None:
        """Move a grip relative to the drag's beginning; request the motion.

        Parameters
        ----------
        to, turn : as in `comove.view.workbench.edits.moved`
        last : whether the drag ends
        """
        held, now = self.pointer.held, self.history.now
        before = now.contents if held is None else held.contents
        try:
            draft = now.with_contents(moved(before, grip, to, turn))
        except ComoveError as error:
            self.panels.say(verdict_words("failed", [str(error)]))
            return
        if last:
            self.pointer.held = None
            self.commit(draft)
        else:
            self._ask(draft, dragging=True)

    def _show_gizmo(self, grip: Grip, handle: Any) -> None:
        """Show arrows and rings at a clicked element."""
        self.pointer.let_go()
        planar = self.scene.n_dims == 2
        gizmo = self.client.scene.add_transform_controls(
            "/gizmo",
            scale=0.16 * self.stage.side,
            active_axes=(True, True, not planar),
            disable_rotations=not grip.turns,
            depth_test=False,
            position=tuple(handle.position),
        )
        self.pointer.selected, self.pointer.gizmo = grip, gizmo
        self.panels.taken.content = (
            f"**{plain_text(self._name(grip))}** is taken: arrows move it, rings turn it."
        )
        self.panels.show_sizes(self.history.now.contents, grip)

        async def updated(event: Any) -> None:
            self._turned(grip, handle, event)

        gizmo.on_update(updated)

    def _turned(self, grip: Grip, handle: Any, event: Any) -> None:
        if self.live:
            return
        place = np.array(event.target.position, dtype=float)
        turn = np.array(event.target.wxyz, dtype=float)
        held = self.pointer.hold(event, grip, self.history.now.contents, place, turn)
        by = quaternion_product(turn, conjugate(held.quaternion))
        by_turn = by if grip.turns and abs(by[0]) < 1 - 1e-12 else None
        to = held.place + place - held.taken
        handle.position = tuple(place)
        if grip.kind == "obstacle":
            handle.wxyz = tuple(by)
        self.move(grip, to, by_turn, last=event.phase == "end")

    def _name(self, grip: Grip) -> str:
        if grip.kind == "obstacle":
            return self.scene.name_of(grip.number)
        return f"the {grip.kind} of {', '.join(self.scene.manipulators[hand] for hand in grip.hands)}"

    # --- running ---

    def _run(self, _: Any) -> None:
        """Start a step-by-step execution, or end the present one."""
        if self.live:
            self.link.halt()
            return
        if self.stage.recording is None:
            self.panels.ran.content = "Wait for a motion first."
            return
        self.pointer.put_down()
        self.stage.draw_run()
        self.live, self.pointer.held = True, None
        self.link.run(self.history.now)
        self.panels.show_run(True)
        self.panels.say(verdict_words("running"))

    def _go(self, message: Message) -> None:
        """Show a state of the run."""
        if not self.live or message["id"] != self.link.asked:
            return
        state: State = message["state"]
        with self.client.atomic():
            self.stage.show_state(state.nodes, state.offsets, state.time)
        plan = "follows a plan" if state.planned else "has no plan, and goes where it is clear"
        self.panels.ran.content = f"{state.time:.1f} s: the load {plan}."

    def _end_run(self) -> None:
        self.live, self.pointer.held = False, None
        self.panels.show_run(False)

    # --- teaching ---

    def _draw(self, _: Any) -> None:
        """Start drawing a demonstration, on a sheet or by arrows."""
        self.pointer.put_down()
        stroke = Stroke(self.scene.n_dims)
        self.panels.taught.content = "**Draw now**, in one go, from the start to the goal."
        if self.scene.n_dims == 2:
            self.pointer.tool = self.stage.sheet()

            async def drawn(event: Any) -> None:
                end = np.array(event.end_position, dtype=float)
                point = on_plane(self.client.camera.position, end, event.start_position[2])
                self._drawn(stroke, point, last=event.phase == "end")

            self.pointer.tool.on_drag(drawn)
            return
        middle = tuple(self.scene.start.mean(axis=0))
        self.pointer.tool = self.client.scene.add_transform_controls(
            "/hand", scale=0.2 * self.stage.side, disable_rotations=True, depth_test=False, position=middle
        )

        async def led(event: Any) -> None:
            self._drawn(stroke, np.array(event.target.position, dtype=float), last=event.phase == "end")

        self.pointer.tool.on_update(led)

    def _drawn(self, stroke: Stroke, point: Array | None, *, last: bool) -> None:
        """Add a point of a demonstration; after the last, learn it."""
        if self.pointer.tool is None:
            return
        if point is not None:
            stroke.add(time.monotonic(), point)
            self.stage.draw_stroke(stroke.rows)
        if not last:
            return
        self.pointer.put_down()
        try:
            taught = stroke.taught(self.stage.side)
        except ComoveError as error:
            self.panels.taught.content = verdict_words("failed", [str(error)])
            return
        self.panels.taught.content = (
            f"**Learned** from {len(stroke.rows)} points in {taught[-1][0]:.1f} s, {len(taught)} after cleaning; "
            "the dashed lines are what each hand would do of it."
        )
        self.commit(replace(self.history.now, taught=taught))

    def _forget(self, _: Any) -> None:
        self.pointer.put_down()
        self.panels.taught.content = "The scene's own demonstration counts again."
        self.commit(replace(self.history.now, taught=None))

    def _keep(self, _: Any) -> None:
        """Learn a primitive from the demonstration, and add it to the library."""
        draft, name = self.history.now, self.panels.controls["movement"].value
        if draft.taught is None:
            self.panels.taught.content = "Show a movement first."
            return
        target_in(self.shelf.folder, name)
        keep(draft.taught, name, self.shelf.folder)
        self.panels.taught.content = f"**Kept** as {plain_text(name)} in the folder library."
        if self.link.folder.resolve() == self.shelf.folder.resolve():  # where the scene finds it
            contents = draft.contents | {"demonstration": {"library": name}}
            self.commit(replace(draft, contents=contents, taught=None))

    # --- changes ---

    def commit(self, draft: Draft) -> None:
        """Add a changed draft to the history, and request its motion."""
        self._go_to(self.history.then(draft))

    def _renew(self) -> None:
        """Draw the history's scene if valid, and request its motion."""
        try:
            scene = read_scene(self.history.now.contents, self.link.folder)
        except ComoveError as error:
            self.stage.fade()
            self.stage.blame(*named_in(self.scene, [str(error)]))
            self.link.drop()
            self.panels.say(verdict_words("failed", [str(error)]))
            return
        self._lay(scene, self.stage)
        self._ask()

    def _ask(self, draft: Draft | None = None, *, dragging: bool = False, item: Item | None = None) -> None:
        if self.live:
            self._end_run()
        times = self.settings.times_of(self.scene)
        self.link.submit(draft or self.history.now, times, dragging=dragging, item=item)
        self.stage.blame()
        if not dragging:
            self.panels.say(verdict_words("waiting"))

    def changed(self, name: str, value: Any) -> None:
        """Handle a changed control."""
        try:
            self._controls[name](self, value) if name in self._controls else self._set(name, value)
        except ComoveError as error:
            places = {"keep": self.panels.taught}
            place = places.get(name, self.panels.saved if name.startswith("save") else self.panels.verdict)
            place.content = verdict_words("failed", [str(error)])

    def _set(self, name: str, value: Any) -> None:
        """Change a value of the draft."""
        draft = self.history.now
        if name in VALUES:
            self.commit(draft.with_contents(with_value(draft.contents, name, value)))
        elif name in SIZES:
            grip = self.pointer.selected
            if grip is not None and grip.kind == "obstacle":
                changed = with_size(draft.contents, grip.number, SIZES.index(name), value)
                self.commit(draft.with_contents(changed))
        elif name in ("method", "objective", "resemblance"):
            self.commit(replace(draft, **{name: value}))

    def _add_box(self, _: Any) -> None:
        """Add a selected box in the middle of the scene."""
        draft = self.history.now
        number = len(draft.contents["obstacles"])
        self.commit(draft.with_contents(with_box(draft.contents)))
        for grip, handle in self.stage.grips().items():
            if (grip.kind, grip.number) == ("obstacle", number):
                self._show_gizmo(grip, handle)

    def _remove(self, _: Any) -> None:
        grip = self.pointer.selected
        if grip is not None and grip.kind == "obstacle":
            self.pointer.let_go()
            draft = self.history.now
            self.commit(draft.with_contents(without_obstacle(draft.contents, grip.number)))

    def _go_to(self, history: History) -> None:
        self.history = history
        self._renew()

    def _toggle(self, _: Any) -> None:
        self.player.playing = not self.player.playing
        self.panels.controls["play"].label = "Pause" if self.player.playing else "Play"

    def _set_pace(self, value: Any) -> None:
        with suppress(ValueError, AttributeError):
            self.player.pace = min(max(float(value.rstrip("x")), 0.1), 10.0)

    def _scrub(self, value: Any) -> None:
        if isinstance(value, (int, float)) and np.isfinite(value):
            if self.player.playing:
                self._toggle(True)
            self._show(float(value))

    def _save_scene(self, _: Any) -> None:
        path = target_in(self.shelf.folder, self.panels.controls["name"].value, ".yaml")
        now = self.history.now
        save_scene(now.contents, path, self.link.folder, now.taught)
        self.panels.saved.content = f"Saved: {plain_text(path.name)}"

    def _save_result(self, _: Any) -> None:
        path = target_in(self.shelf.folder, self.panels.controls["name"].value)
        if self.link.solved != self.link.asked:
            self.panels.saved.content = (
                "There is no verified motion of this scene to save yet; wait for the search."
            )
            return
        self.link.save(self.link.solved, path, self.history.now.seed)

    _controls: Mapping[str, Callable[[Session, Any], None]] = {
        "undo": lambda self, _: self._go_to(self.history.undone()),
        "redo": lambda self, _: self._go_to(self.history.redone()),
        "shown": _open,
        "play": _toggle,
        "add box": _add_box,
        "remove": _remove,
        "pace": _set_pace,
        "time": _scrub,
        "ghosts": lambda self, value: self.stage.show_ghosts(bool(value)),
        "beside": _compare,
        "run": _run,
        "draw": _draw,
        "forget": _forget,
        "keep": _keep,
        "save scene": _save_scene,
        "save result": _save_result,
    }

    # --- answers ---

    def _answered(self, link: Link, message: Message) -> None:
        kind = message["kind"]
        if self.player.closed or link is not self.link:
            return
        if kind in ("compiling", "ended"):
            if kind == "ended" or not message["is_over"]:
                self.panels.say(verdict_words(kind))
        elif kind == "robot":
            self.stage.draw_robot(message["bodies"], message["home"])
            self._look()
        elif kind == "armless":
            reasons = plain_text(" ".join(message["reasons"]))
            self.note = f"\n\n{reasons}. This is the motion of the hands alone."
        elif kind == "saved":
            self.panels.saved.content = f"Saved: {plain_text(message['target'].name)}"
        elif kind == "unsaved":
            self.panels.saved.content = f"**Not saved.** {plain_text(' '.join(message['reasons']))}"
        elif kind == "state":
            self._go(message)
        else:
            self._answered_draft(message)

    def _answered_draft(self, message: Message) -> None:
        """Show the planner's answer to a draft, unless outdated."""
        number, kind = message["id"], message["kind"]
        if number < self.link.answered or (kind == "ran" and number != self.link.asked):
            return
        newest = number == self.link.asked
        if self.live and newest:
            self._end_run()
        self.link.answered = number
        if kind in VERIFIED:
            self._take(message, newest)
        elif newest:
            self._fail(message)
            self.panels.say(verdict_words("failed", message["reasons"]))

    def _fail(self, message: Message) -> None:
        """Show an unverified motion in grey. It is that of a folder, or else the motion before."""
        recording = message.get("recording")
        if recording is not None and self.stage.recording is None:
            self.stage.draw_motion(recording, pale=True)
            self._measure(message)
        self.stage.fade()
        if not self.stage.touches:  # what the reasons name is in the way, or else what is nearest
            named = named_in(self.scene, message["reasons"])
            nearest = () if recording is None else (int(recording.tightest[1]),)
            self.stage.blame(*(named or nearest))

    def _take(self, message: Message, newest: bool) -> None:
        """Show a verified motion, in grey if the scene has changed."""
        with self.client.atomic():
            self.stage.draw_motion(message["recording"], pale=not newest or not message.get("holds", True))
            self._show(min(self.player.time, self.end))
        if not newest:
            return
        kind = message["kind"]
        self.link.solved = message["id"] if kind in FINAL else self.link.solved
        first = self.history.at == 0 and self.pointer.held is None  # which includes the loading of kernels
        seconds = None if first else message.get("verified_after")
        verdict, against = message["verdict"], message.get("against", ())
        self.panels.say(verdict_words(kind, message["reasons"], seconds, verdict, against))
        self._measure(message)

    def _measure(self, message: Message) -> None:
        """Show the measures and contacts of a recording."""
        recording = message["recording"]
        self.stage.touches = message.get("touches", ())
        self.panels.plot(recording, self.scene.manipulators)
        self._stretch()
        words = measures_words(message["rows"], message["proved"]) if message["rows"] else ""
        self.panels.measures.content = words + self._tightest_words(recording) + self.note

    def _tightest_words(self, recording: RecordedMotion) -> str:
        """Return where and when the clearance is least, in words."""
        at, nearest = float(recording.tightest[0]), int(recording.tightest[1])
        if not np.isfinite(recording.clearance[recording.index_at(at)]):
            return ""
        return f"\n\nTightest (red): at {plain_text(self.scene.name_of(nearest))}, after {at:.2f} s."

    # --- playing ---

    def _playable(self) -> float | None:
        """Return the end of what can be played [s]; None while nothing can be."""
        return None if self.stage.recording is None or self.live else self.end

    @property
    def end(self) -> float:
        """Return the last instant of all shown motions [s]."""
        recording = self.stage.recording
        return max(0.0 if recording is None else float(recording.time[-1]), self.comparison.end)

    def _stretch(self) -> None:
        if self.end > 0.0 and not self.live:
            self.panels.reach(self.end)
            self._show(min(self.player.time, self.end))

    def _show(self, at: float) -> None:
        """Go to an instant [s]."""
        if self.stage.recording is not None:
            self.player.time = at
            self._play(at, True)

    def _play(self, at: float, pointing: bool) -> None:
        """Show an instant [s], marked in the plots if `pointing`."""
        if self.stage.recording is None:
            return
        index = self.stage.recording.index_at(at)
        self.stage.show(index)
        self.comparison.show(at)
        if pointing:
            self.panels.controls["time"].value = round(at, 2)
            self.panels.point(index)

    def close(self) -> None:
        """Close the page's planner and clock."""
        self.player.close()
        self.comparison.close()
        self.link.close()
