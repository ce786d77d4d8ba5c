"""Planner of one page, in a process of its own.

`python -m comove.view.workbench.worker SOCKET` answers the messages of a socket (see
`comove.view.workbench.protocol`). It ends when the other end closes.

A draft is answered in steps. First the present motion is verified on the new scene: where it is still verified, it
stays, and the answer comes at once. Then a motion is searched; the first verified one is sent as soon as it is
found, better ones follow, and the last answer is the best. A newer draft ends the search, but during a drag only
after a minimum time for its first motion: so plans are found while the pointer moves.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comove.compiled.counting import WarmUp, shown_by
from comove.errors import ComoveError, ExtraError, OptionError
from comove.methods import METHODS
from comove.model.demonstration import demonstration_of
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning import (
    Budget,
    Comove,
    LeastJerk,
    PaperCost,
    Progress,
    SceneKind,
    Solution,
    load_kernels,
    movements_of,
)
from comove.planning.compiling import IN_ALL, compiling
from comove.planning.objectives import OBJECTIVES, objective_of_scene
from comove.planning.pace import with_limits
from comove.planning.solution import ProgressCallback
from comove.planning.warming import require
from comove.results.inputs import place_of_scene
from comove.solving import solve
from comove.verification.verify import VerifiedMotion, verify
from comove.view.workbench.bodies import bodies_of, poses_of, robot_of
from comove.view.workbench.edits import Draft
from comove.view.workbench.live import LiveRun, run_live, save_run
from comove.view.workbench.playback import (
    Playback,
    playback_of,
    playback_of_item,
    playback_of_joints,
    playback_of_run,
)
from comove.view.workbench.protocol import Mailbox, Message, SearchTimes
from comove.view.workbench.shelf import read_scene
from comove.view.workbench.teaching import csv_of, demonstration_from

if TYPE_CHECKING:
    from comove.robots import JointMotion, Robot, VerifiedJointMotion

Tell = Callable[[Message], None]


class RunMailbox(Mailbox):
    """Mailbox that also keeps a run's stop request and dragged obstacles."""

    def __init__(self) -> None:
        super().__init__()
        self._leads: dict[int, Any] = {}
        self._halted = False

    def put(self, message: Message) -> None:
        """Add a message; keep the newest position of each dragged obstacle."""
        with self._changed:
            if message["kind"] == "lead":
                self._leads[message["obstacle"]] = message["place"]
                return
            if message["kind"] == "halt":
                self._halted = True
                return
            if message["kind"] == "run":  # what was said before is not meant for it
                self._leads, self._halted = {}, False
        super().put(message)

    def leads(self) -> dict[int, Any]:
        """Return the new positions of dragged obstacles since the last call."""
        with self._changed:
            leads, self._leads = self._leads, {}
            return leads

    @property
    def halted(self) -> bool:
        """Return whether a run shall end, for a request or draft."""
        return self._halted or self.closed or self.draft is not None

    @property
    def let_go(self) -> bool:
        """Return whether a newer draft waits that ends a drag."""
        draft = self.draft
        return draft is not None and not draft["dragging"]


class PlannedArms:
    """Arms of a robot, with the present joint motion.

    Parameters
    ----------
    robot : the robot
    named : name or path of its description, as in the scene
    """

    def __init__(self, robot: Robot, named: str):
        self.robot, self.named = robot, named
        self.kept: JointMotion | None = None
        self._found: VerifiedJointMotion | None = None

    def still(self, motion: VerifiedMotion) -> Playback | None:
        """Return the present joint motion if verified with a new motion."""
        from comove.robots import verify_joints

        if self.kept is None:
            return None
        duration, joints = motion.motion.scene.duration, self.kept
        if abs(joints.duration - duration) > 1e-9:
            joints = joints.stretched(duration)
        return self._shown(verify_joints(self.robot, motion, joints).verified)

    def carried(self, motion: CoordinatedMotion) -> Playback | None:
        """Return the found joint motion of an end-effector motion, or None."""
        found = self._found
        return self._shown(found) if found is not None and found.motion.motion is motion else None

    def _shown(self, verified: VerifiedJointMotion | None) -> Playback | None:
        if verified is None:
            return None
        self.kept = verified.joints
        return playback_of_joints(self.robot, verified.motion.motion, verified.joints, verified.report)

    def find(self, found: VerifiedJointMotion) -> None:
        """Store a joint motion that a search has just verified."""
        self._found = found


class Worker:
    """Planner that answers drafts. The last verified motion answers the next draft at once, if it is still verified.

    Parameters
    ----------
    mailbox : source of drafts
    tell : function that sends an answer
    """

    def __init__(self, mailbox: RunMailbox, tell: Tell):
        self.mailbox, self.tell = mailbox, tell
        self.kept: CoordinatedMotion | None = None
        self.arms: PlannedArms | None = None
        self.solution: tuple[int, Solution | LiveRun] | None = None
        self.draft: Draft | None = None
        self.times = SearchTimes()
        self._taught: tuple[str, Any] | None = None
        self._begun = 0.0
        self._verified_after: float | None = None

    def run(self) -> None:
        """Answer messages until the mailbox is closed."""
        with compiling(compiled=IN_ALL), shown_by(self._warming_up):
            answers = {"draft": self.answer, "save": self.save, "run": self.run_live}
            while (message := self.mailbox.take()) is not None:
                self._begun, self._verified_after = time.perf_counter(), None
                try:
                    answers[message["kind"]](message)
                except (ComoveError, OSError) as error:
                    kind = "unsaved" if message["kind"] == "save" else "failed"
                    self._send(message, kind, reasons=[str(error)])

    def answer(self, asked: Message) -> None:
        """Answer a draft. A result folder, if requested, else the present motion is verified; then a motion is
        searched.

        Raises
        ------
        SceneError
            If the draft is no scene.
        ResultError
            If the folder does not hold it.
        """
        scene = read_scene(asked["draft"].contents, asked["folder"])
        self._meet_robot(scene)
        item = asked["item"]
        if item is not None and item.result is not None:
            stored = playback_of_item(item)
            self._played(stored, asked, "stored" if stored.holds else "failed", touches=stored.touches)
        elif not self._still_verified(scene, asked) or not asked["dragging"]:
            self._search(scene, asked)

    def _meet_robot(self, scene: Scene) -> None:
        """Load the robot of a scene and send its bodies. Where robots are not installed, the end effectors are
        planned alone."""
        named = scene.file.robot
        if named == (None if self.arms is None else self.arms.named):
            return
        self.arms = None
        if named is None:
            return
        try:
            robot = robot_of(scene)
        except ExtraError as error:
            self.tell({"kind": "armless", "id": -1, "reasons": [str(error)]})
            return
        if robot is not None:
            self.arms = PlannedArms(robot, named)
            home = poses_of(robot, robot.home[None])[0]
            self.tell({"kind": "robot", "id": -1, "bodies": bodies_of(robot), "home": home})

    def _still_verified(self, scene: Scene, asked: Message) -> bool:
        """Return whether the present motion is verified on a changed scene. It is sent if it is."""
        before = self.kept
        if before is None or before.scene.n_dims != scene.n_dims:
            return False
        timed = scene if scene.is_timed else with_limits(scene).timed(before.scene.duration)
        try:
            motion = before.on(timed)
            verdict = verify(motion) if motion.weights.shape == before.weights.shape else None
        except (ComoveError, ValueError, IndexError):  # its coordinates are not those of this scene
            return False
        if verdict is None or verdict.verified is None:
            return False
        still = playback_of(verdict.verified) if self.arms is None else self.arms.still(verdict.verified)
        if still is None:
            return False
        self.kept = motion
        self._found(still, asked, "kept")
        return True

    def _search(self, scene: Scene, asked: Message) -> None:
        told: list[tuple[CoordinatedMotion, float]] = []

        def progress(state: Progress) -> None:
            now = time.perf_counter()
            soon = told and (state.motion is told[-1][0] or now - told[-1][1] < asked["times"].pause)
            if state.motion is None or soon:
                return
            told.append((state.motion, now))
            found = self._verified(state.motion)
            if found is not None:
                self.kept = state.motion
                self._found(found, asked, "found")
            told[-1] = state.motion, time.perf_counter()

        def stop() -> bool:
            early = time.perf_counter() - self._begun < asked["times"].patience
            patient = not told and not self.mailbox.let_go and early
            return self.mailbox.closed or (self.mailbox.draft is not None and not patient)

        solution = self._solved(scene, asked, progress, stop)
        if self.mailbox.draft is not None:  # which nobody waits for any more
            return
        self.solution, self.draft, self.times = (asked["id"], solution), asked["draft"], asked["times"]
        if solution.verified:
            self.kept = solution.attempt
            if self.arms is not None and solution.joints is not None:
                self.arms.kept = solution.joints.attempt
            self._found(playback_of(solution), asked, "solved")
        else:
            self._played(playback_of(solution), asked, "failed")

    def _verified(self, motion: CoordinatedMotion) -> Playback | None:
        if self.arms is not None:
            return self.arms.carried(motion)
        verified = verify(motion).verified
        return None if verified is None else playback_of(verified)

    def _solved(
        self, scene: Scene, asked: Message, progress: ProgressCallback, stop: Callable[[], bool]
    ) -> Solution:
        """Search a motion of the end effectors, or of a robot."""
        draft: Draft = asked["draft"]
        method, aim = METHODS[draft.method].kind(), _aim_of(scene, draft)
        load_kernels(SceneKind.of(scene))
        taught = self._movements(scene, method.scene_of(scene), draft.taught)
        wanted: dict[str, Any] = {
            "demonstration": taught,
            "seed": draft.seed,
            "objective": aim,
            "budget": Budget.of(asked["times"].budget, option="comove solve --budget"),
            "progress": progress,
            "stop": stop,
        }
        if self.arms is None:
            return solve(scene, robot=False, method=method, **wanted)
        own = None if draft.method == Comove.name else method
        return solve(scene, robot=self.arms.robot, method=own, found=self.arms.find, **wanted)

    def _movements(self, scene: Scene, solved: Scene, rows: Any) -> Any:
        """Return the demonstration for every end effector, read once."""
        key = repr((scene.file.demonstration, scene.turns_as_one, rows))
        if self._taught is None or self._taught[0] != key:
            self._taught = key, demonstration_of(scene) if rows is None else demonstration_from(rows)
        return movements_of(self._taught[1], solved)

    def run_live(self, asked: Message) -> None:
        """Execute a draft step by step, send states, and verify it.

        Raises
        ------
        SceneError
            If the draft is no scene.
        OptionError
            If it has no duration, or names a robot.
        """
        draft: Draft = asked["draft"]
        scene = read_scene(draft.contents, asked["folder"])
        if scene.file.robot is not None:
            raise OptionError("arms are not led live", way_out="take a scene without a robot")
        if not scene.is_timed:
            if self.kept is None:
                raise OptionError("the scene leaves its duration open", way_out="wait for a verified motion")
            scene = with_limits(scene).timed(self.kept.scene.duration)
        require(*SceneKind.of(scene).jobs, "executions")

        run = run_live(
            scene,
            draft.contents,
            demonstration=self._movements(scene, scene, draft.taught),
            seed=draft.seed,
            plan=self._plan_on(scene),
            leads=self.mailbox.leads,
            tell=lambda state: self._send(asked, "state", state=state),
            stop=lambda: self.mailbox.halted,
        )
        self.solution = asked["id"], run
        playback = playback_of_run(run.record, run.blocker)
        self._played(playback, asked, "ran", holds=playback.holds)

    def _plan_on(self, scene: Scene) -> VerifiedMotion | None:
        try:
            return None if self.kept is None else verify(self.kept.on(scene)).verified
        except (ComoveError, ValueError, IndexError):  # its coordinates are not those of this scene
            return None

    def save(self, asked: Message) -> None:
        """Write the last result into a folder, as `comove solve` does.

        Raises
        ------
        ResultError
            If it cannot be written there.
        """
        from comove.io.folders import whole_folder
        from comove.results import RESULT
        from comove.view.figures import save_result

        number, solution = self.solution or (-1, None)
        known = number == asked["of"] and (isinstance(solution, LiveRun) or (solution and solution.verified))
        if solution is None or not known:
            self._send(asked, "unsaved", reasons=["there is no verified motion of this scene to save yet"])
            return
        with whole_folder(asked["target"], RESULT) as draft:
            if isinstance(solution, LiveRun):
                save_run(solution, draft, seed=asked["seed"])
            else:
                again = _command_again(self.draft, solution.scene, self.times)
                save_result(solution, draft, wall_time_s=solution.effort.seconds, **again)
        self._send(asked, "saved", target=asked["target"])

    def _found(self, playback: Playback, asked: Message, kind: str) -> None:
        if self._verified_after is None:
            self._verified_after = time.perf_counter() - self._begun
        self._played(playback, asked, kind, verified_after=self._verified_after)

    def _played(self, playback: Playback, asked: Message, kind: str, **further: Any) -> None:
        keys = ("recording", "verdict", "reasons", "rows", "proved", "against")
        told = {key: getattr(playback, key) for key in keys}
        self._send(asked, kind, **told, **further)

    def _send(self, asked: Message, kind: str, **told: Any) -> None:
        self.tell({"kind": kind, "id": asked["id"], **told})

    @contextmanager
    def _warming_up(self, _: WarmUp) -> Iterator[None]:
        self.tell({"kind": "compiling", "id": -1, "is_over": False})
        try:
            yield
        finally:
            self.tell({"kind": "compiling", "id": -1, "is_over": True})


def _aim_of(scene: Scene, draft: Draft) -> Any:
    """Return the objective of a draft; None leaves it to `solve`."""
    name, resemblance = draft.objective, draft.resemblance
    if draft.method != Comove.name:
        return None if name not in OBJECTIVES else PaperCost()
    aim: Any = OBJECTIVES[name]() if name in OBJECTIVES else objective_of_scene(scene.file.objective)
    if resemblance is None or (aim is not None and aim.is_time):
        return aim
    return LeastJerk(resemblance=resemblance) if aim is None else type(aim)(resemblance=resemblance)


def _command_again(draft: Draft | None, scene: Scene, times: SearchTimes) -> dict[str, Any]:
    """Return the command and recording that solve a draft again. They are arguments of `save_result`."""
    if draft is None:
        return {}
    words: list[str | Path] = ["solve", place_of_scene(scene), "--method", draft.method]
    words += ["--seed", str(draft.seed), "--budget", repr(times.budget)]
    made: dict[Path, bytes] = {}
    if draft.objective in OBJECTIVES:
        aim = draft.objective if draft.method == Comove.name else "paper"
        words += ["--objective", aim.replace("_", "-")]
    if draft.resemblance is not None and draft.method == Comove.name and draft.objective != "least_time":
        words += ["--resemblance", repr(float(draft.resemblance))]
    if draft.taught is not None:
        drawn = scene.folder / "drawn.csv"
        words += ["--demonstration", drawn]
        made[drawn] = csv_of(draft.taught)
    return {"command": words, "made": made}


def main(number: int) -> None:
    """Answer the messages of a socket until it is closed."""
    os.dup2(2, 1)  # what libraries print is no part of what the command says
    connection, mailbox, sending = Connection(number), RunMailbox(), threading.Lock()

    def read() -> None:
        with suppress(EOFError, OSError):
            while True:
                mailbox.put(connection.recv())
        mailbox.close()

    def tell(message: Message) -> None:
        with sending:
            connection.send(message)

    threading.Thread(target=read, daemon=True).start()
    with suppress(BrokenPipeError, ConnectionError, KeyboardInterrupt):
        Worker(mailbox, tell).run()
    os._exit(0)  # the thread that reads still waits


if __name__ == "__main__":
    main(int(sys.argv[1]))
