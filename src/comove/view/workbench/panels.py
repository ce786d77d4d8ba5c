"""Panels of a page: verification, playback, plots, edits and saving."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.methods import OWN
from comove.model.scene import Scene
from comove.view.figures.style import COLOURS, GOAL, MOVING, START
from comove.view.workbench.edits import OBJECTIVES, SIZES, Draft, Grip, sizes_of
from comove.view.workbench.playback import RecordedMotion

Told = Callable[[str, Any], None]

SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)
PLOTS = (
    ("clearance", "sampled clearance [mm]", 1e3),
    ("speed", "speed [m/s]", 1.0),
    ("acceleration", "acceleration [m/s²]", 1.0),
    ("error", "constraints: share of tolerance", 1.0),
)


LEGEND = "".join(
    f'<div style="font-size:.85em;padding:0 .9em"><span style="color:{colour}">{sign}</span> {words}</div>'
    for colour, sign, words in (
        (START, "&#9679;", "start, to drag"),
        (GOAL, "&#9679;", "goal, to drag"),
        ("#2a9d4b", "&#9644;", "path of the load's middle: green far from everything,"),
        ("#d7263d", "&#9644;", "red near to something; the load where it is tightest"),
        (COLOURS[0], "&#9472;", "path of a hand, a colour each"),
        ("#6b7280", "&#9476;", "demonstration, as each hand would do it"),
        (MOVING, "&#9632;", "obstacle that moves, with its path"),
        ("#d7263d", "&#9632;", "obstacle that is in the way"),
        ("#b9bec6", "&#9632;", "motion that is not verified in this scene"),
    )
)
"""What colours and lines mean, as HTML."""


class Panels:
    """Controls of one page.

    Parameters
    ----------
    gui : the viewer's controls of one client
    told : function that is called with the name of a control and its value when a person changes it
    names : scenes and results to choose from; none where there is one
    chosen : name of the one shown
    beside : choices for the motion beside
    """

    def __init__(
        self,
        gui: Any,
        told: Told,
        names: tuple[str, ...] = (),
        chosen: str = "",
        beside: tuple[str, ...] = (),
    ):
        self.gui, self._told = gui, told
        self.controls: dict[str, Any] = {}
        self._plots: dict[tuple[str, int], Any] = {}  # by measure and number of series, which cannot change
        self._data: dict[str, list[Array]] = {}
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        if names:
            self._add("shown", gui.add_dropdown("shown", names, initial_value=chosen))
        self.verdict = gui.add_markdown("")
        self._play()
        tabs = gui.add_tab_group()
        self._motion = tabs.add_tab("Motion")
        with self._motion:
            self.measures = gui.add_markdown("")
            with gui.add_folder("What is drawn", expand_by_default=False):
                gui.add_html(LEGEND)
        with tabs.add_tab("Steer"):
            self._steer()
        with tabs.add_tab("Teach"):
            self._teach()
        with tabs.add_tab("Compare"):
            self._compare(beside)
        with tabs.add_tab("Run"):
            self._run()
        with tabs.add_tab("Save"):
            self._save()

    def _add(self, name: str, control: Any) -> None:
        self.controls[name] = control

        async def changed(event: Any) -> None:
            if event.client_id is not None:  # else it was set from here
                self._told(name, control.value)

        (control.on_click if hasattr(control, "on_click") else control.on_update)(changed)

    def _button(self, name: str, label: str) -> None:
        self._add(name, self.gui.add_button(label))

    def _play(self) -> None:
        gui = self.gui
        self._button("play", "Pause")
        self._add("pace", gui.add_dropdown("pace", tuple(f"{s:g}x" for s in SPEEDS), initial_value="1x"))
        self._add("time", gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0))
        self._add("ghosts", gui.add_checkbox("load at equal times", True))

    def _steer(self) -> None:
        gui = self.gui
        self.taken = gui.add_markdown(
            "Drag an obstacle, or the green and red balls of start and goal. Click one for arrows and rings."
        )
        for name in SIZES:
            self._add(name, gui.add_number(name, 1.0, min=1e-3, max=1e3, step=0.005, visible=False))
        self._button("add box", "Add a box")
        self._button("remove", "Remove it")
        self.controls["remove"].visible = False
        for name, label, most, step in (
            ("duration", "duration [s], 0: least", 3600.0, 0.1),
            ("speed", "speed limit [m/s], 0: none", 1e3, 0.01),
            ("acceleration", "acceleration [m/s²], 0: none", 1e4, 0.01),
            ("clearance", "clearance [m]", 100.0, 0.001),
            ("bar", "length of the bar [m]", 100.0, 0.005),
        ):
            self._add(name, gui.add_number(label, 0.0, min=0.0, max=most, step=step))
        self._add("method", gui.add_dropdown("method", OWN, initial_value=OWN[0]))
        self._add("objective", gui.add_dropdown("objective", OBJECTIVES, initial_value=OBJECTIVES[0]))
        self._add("resemblance", gui.add_slider("resemblance", 0.0, 1.0, 0.05, 0.7))
        self._button("undo", "Undo")
        self._button("redo", "Redo")

    def _teach(self) -> None:
        self._button("draw", "Show a movement")
        self._button("forget", "Forget it")
        self._add("movement", self.gui.add_text("name", "drawn"))
        self._button("keep", "Keep it in the library")
        self.taught = self.gui.add_markdown(
            "Press the first button, then draw with the mouse in one go; in space, drag the arrows. Where you were "
            "quick, the load will be too."
        )

    def _compare(self, choices: tuple[str, ...]) -> None:
        self._add("beside", self.gui.add_dropdown("beside it", choices, initial_value=choices[0]))
        self.beside = self.gui.add_markdown("")

    def _run(self) -> None:
        self._button("run", "Run it live")
        self.ran = self.gui.add_markdown(
            "The load goes step by step and sees where the obstacles are. Drag one into its way while it goes."
        )

    def _save(self) -> None:
        self._add("name", self.gui.add_text("name", "steered"))
        self._button("save scene", "Save scene")
        self._button("save result", "Save result")
        self.saved = self.gui.add_markdown("Files go to the folder that comove was started in.")

    def say(self, words: str) -> None:
        """Show the verification result."""
        if self.verdict.content != words:
            self.verdict.content = words

    def fill(self, draft: Draft, scene: Scene, selected: Grip | None = None) -> None:
        """Show the values of a draft and the selected sizes."""
        contents = draft.contents
        limits, load = contents["limits"], contents.get("load") or {}
        is_bar = load.get("shape") == "bar"
        values = {
            "duration": contents["duration"] or 0.0,
            "speed": limits["speed"] or 0.0,
            "acceleration": limits["acceleration"] or 0.0,
            "clearance": limits["clearance"] or 0.0,
            "bar": load["length"] if is_bar else 0.0,
            "method": draft.method,
            "objective": draft.objective,
            "resemblance": 0.7 if draft.resemblance is None else draft.resemblance,
        }
        for name, value in values.items():
            if self.controls[name].value != value:
                self.controls[name].value = value
        self.controls["bar"].visible = is_bar
        self.show_sizes(contents, selected)
        taught = scene.file.demonstration is not None or draft.taught is not None
        self.controls["resemblance"].visible = taught

    def show_sizes(self, contents: dict[str, Any], grip: Grip | None) -> None:
        """Show the sizes of a selected obstacle, else none."""
        is_obstacle = grip is not None and grip.kind == "obstacle"
        sizes = sizes_of(contents, grip.number) if grip is not None and is_obstacle else ()
        for i, name in enumerate(SIZES):
            control = self.controls[name]
            control.visible = i < len(sizes)
            if i < len(sizes):
                control.label, control.value = sizes[i][0], sizes[i][-1]
        self.controls["remove"].visible = is_obstacle

    def show_run(self, live: bool) -> None:
        """Show whether a run is in progress. The time slider and playback are for recordings alone."""
        self.controls["run"].label = "Stop" if live else "Run it live"
        for name in ("play", "pace", "time", "ghosts"):
            self.controls[name].visible = not live

    def reach(self, end: float) -> None:
        """Set the end of the time slider [s]."""
        slider = self.controls["time"]
        if slider.max != end:
            slider.value = min(slider.value, end)
            slider.max = end

    def plot(self, recording: RecordedMotion, names: tuple[str, ...]) -> None:
        """Draw the measures over time."""
        for name, label, factor in PLOTS:
            columns = np.asarray(getattr(recording, name), dtype=float) * factor
            columns = columns.reshape(len(recording.time), -1).T
            series: list[dict[str, Any]] = [{"label": "t [s]"}]
            series += [
                {
                    "label": names[i] if len(columns) > 1 else name,
                    "stroke": COLOURS[i % len(COLOURS)],
                    "width": 1.5,
                }
                for i in range(len(columns))
            ]
            series.append({"label": "now", "stroke": "#d7263d", "width": 1, "points": {"show": False}})
            finite = columns[np.isfinite(columns)]
            top = float(finite.max()) if len(finite) else 1.0
            low = min(float(finite.min()), 0.0) if len(finite) else 0.0
            top = top * 1.05 if top > low else low + 1.0
            columns = np.where(np.isfinite(columns), columns, top)
            self._data[name] = [recording.time, *columns, np.full(len(recording.time), low)]
            self._draw(name, label, series, (low, top))

    def _draw(self, name: str, label: str, series: list[dict[str, Any]], reach: tuple[float, float]) -> None:
        data, key = tuple(self._data[name]), (name, len(series))
        for other, plot in self._plots.items():
            if other[0] == name:
                plot.visible = other == key
        if key in self._plots:
            self._plots[key].data = data
            self._plots[key].scales = scales_of(reach)
            return
        with self._motion:
            self._plots[key] = self.gui.add_uplot(
                data,
                tuple(series),
                title=label,
                scales=scales_of(reach),
                axes=({"size": 24, "space": 40}, {"size": 44, "space": 22}),
                legend={"show": False},
                height=118,
            )

    def point(self, index: int) -> None:
        """Mark an instant in all plots by a line."""
        for (name, count), plot in self._plots.items():
            data = self._data[name]
            if len(data) != count:  # of a scene with other hands
                continue
            low, high = plot.scales["y"]["range"]
            line = np.full(len(data[0]), low)
            line[index] = high
            data[-1] = line
            plot.data = tuple(data)


def scales_of(reach: tuple[float, float]) -> dict[str, Any]:
    """Return a time plot's scales for values within `reach`."""
    return {"x": {"time": False, "auto": True}, "y": {"auto": False, "range": reach}}
