"""The planner of one page, in a process of its own: it solves the newest draft and drops those before.

`python -m comove.workbench.worker` reads messages from standard input and answers on standard output, as
`comove.workbench.protocol` writes them. It ends when the other end closes.

A draft is answered in steps. First the motion that is shown is judged on the new scene: where it is still verified,
it stays, and the answer comes at once. Then a motion is searched; the first verified one is sent as soon as it is
found, better ones follow, and the last answer is the best. A newer draft ends the search, but while the hand still
drags not before it had `PATIENCE` to find its first motion: so a plan follows a hand that never rests.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from comove.coordination.motion import CoordinatedMotion
from comove.errors import ComoveError, ComoveWarning
from comove.planning import (
    Comove,
    LeastJerk,
    LeastTime,
    Paper,
    PaperCost,
    Printed,
    Progress,
    Projection,
    SceneKind,
    Solution,
    load_kernels,
    movements_of,
    solve,
)
from comove.planning.compiling import IN_ALL, compiling
from comove.planning.objectives import objective_of_scene
from comove.planning.pace import with_limits
from comove.results import filled_in, read_result, verify_result
from comove.results.solution import rebuild
from comove.scenes.demonstration import demonstration_of
from comove.scenes.scene import Scene
from comove.verification.verify import Report, VerifiedMotion, verify
from comove.workbench.protocol import Message, read_message, write_message
from comove.workbench.recording import RecordedMotion
from comove.workbench.teaching import demonstration_from

PATIENCE = 0.25  # s, that a search has to find its first motion although a newer draft waits
PAUSE = 0.4  # s, between better motions that are sent
KINDS = {kind.name: kind for kind in (Comove, Projection, Paper, Printed)}
AIMS: dict[str, type] = {"least_jerk": LeastJerk, "least_time": LeastTime, "paper": PaperCost}

Tell = Callable[[Message], None]


class Mailbox:
    """A mailbox with one slot for drafts, where the newest replaces the one before; other messages queue."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._draft: Message | None = None
        self._others: deque[Message] = deque()
        self._closed = False

    def put(self, message: Message) -> None:
        """Add a message."""
        with self._changed:
            if message.header.get("kind") == "draft":
                self._draft = message
            else:
                self._others.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Note that nothing comes any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def take(self) -> Message | None:
        """Wait for a message and return it, drafts last; None once the mailbox is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._others or self._draft is not None)
            if self._closed:
                return None
            if self._others:
                return self._others.popleft()
            message, self._draft = self._draft, None
            return message

    @property
    def waiting(self) -> bool:
        """Return whether a newer draft waits."""
        return self._draft is not None

    @property
    def let_go(self) -> bool:
        """Return whether a newer draft waits after which none follows at once, so that it need not be put off."""
        draft = self._draft
        return draft is not None and not draft.header["dragging"]

    @property
    def closed(self) -> bool:
        """Return whether nothing comes any more."""
        return self._closed


class Worker:
    """Answers drafts; the last verified motion answers the next draft at once, if it still holds.

    Parameters
    ----------
    mailbox : where drafts come from
    tell : function that sends an answer
    """

    def __init__(self, mailbox: Mailbox, tell: Tell):
        self.mailbox, self.tell = mailbox, tell
        self.kept: CoordinatedMotion | None = None
        self.solution: tuple[int, Solution] | None = None
        self._taught: tuple[str, Any] | None = None
        self._first: tuple[int, float] = (-1, 0.0)

    def run(self) -> None:
        """Answer messages until the mailbox is closed."""
        with compiling(self._say_compiling, IN_ALL):
            while (message := self.mailbox.take()) is not None:
                try:
                    {"draft": self.answer, "save": self.save}[message.header["kind"]](message.header)
                except (ComoveError, OSError) as error:
                    kind = "failed" if message.header["kind"] == "draft" else "unsaved"
                    self._send(message.header, kind, reasons=[str(error)])

    def answer(self, header: Mapping[str, Any]) -> None:
        """Answer a draft: judge the motion that is shown, then search.

        Raises
        ------
        SceneError
            If the draft is no scene.
        """
        begun = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            scene = Scene.from_dict(header["contents"], folder=header["folder"])
        if header["result"] is not None:
            self._stored(scene, header, begun)
            return
        if self._still_verified(scene, header, begun) and header["dragging"]:
            return
        self._search(scene, header, begun)

    def _stored(self, scene: Scene, header: Mapping[str, Any], begun: float) -> None:
        """Judge the motion of a result folder anew, and tell of it.

        Raises
        ------
        ResultError
            If the folder holds no result of this scene.
        """
        stored = read_result(header["result"])
        scene = filled_in(scene, stored)
        verdict = verify_result(stored, scene)
        if verdict.verified is None:
            attempt = RecordedMotion.of(rebuild(stored.arrays, scene))
            self._send(header, "failed", attempt, begun, reasons=list(verdict.reasons))
            return
        self.kept = verdict.verified.motion
        self._found(verdict.verified, header, begun, "stored")

    def _still_verified(self, scene: Scene, header: Mapping[str, Any], begun: float) -> bool:
        """Return whether the motion that is shown is verified on a changed scene as well; it is told if it is."""
        before = self.kept
        if before is None or before.scene.n_dims != scene.n_dims:
            return False
        asked = scene if scene.is_timed else with_limits(scene).timed(before.scene.duration)
        try:
            motion = before.on(asked)
            verdict = verify(motion) if motion.weights.shape == before.weights.shape else None
        except (ComoveError, ValueError, IndexError):  # its coordinates are not those of this scene
            return False
        if verdict is None or verdict.verified is None:
            return False
        self.kept = motion
        self._found(verdict.verified, header, begun, "kept")
        return True

    def _search(self, scene: Scene, header: Mapping[str, Any], begun: float) -> None:
        method, aim = KINDS[header["method"]](), _aim_of(scene, header)
        load_kernels(SceneKind.of(scene))
        taught = self._movements(scene, method.scene_of(scene), header["taught"])
        told: list[tuple[CoordinatedMotion, float]] = []

        def progress(state: Progress) -> None:
            now = time.perf_counter()
            if state.motion is None or (told and (state.motion is told[-1][0] or now - told[-1][1] < PAUSE)):
                return
            told.append((state.motion, now))
            verified = verify(state.motion).verified
            if verified is not None:
                self.kept = state.motion
                self._found(verified, header, begun, "found")

        def stop() -> bool:
            patient = not told and not self.mailbox.let_go and time.perf_counter() - begun < PATIENCE
            return self.mailbox.closed or (self.mailbox.waiting and not patient)

        solution = solve(
            scene,
            demonstration=taught,
            seed=header["seed"],
            method=method,
            objective=aim,
            budget=header["budget"],
            progress=progress,
            stop=stop,
        )
        self.solution = header["id"], solution
        if solution.motion is not None:
            self.kept = solution.attempt
            self._found(solution.motion, header, begun, "solved", interrupted=solution.interrupted)
        elif not solution.interrupted or not self.mailbox.waiting:
            attempt = RecordedMotion.of(solution.attempt)
            self._send(header, "failed", attempt, begun, reasons=list(solution.reasons))

    def _movements(self, scene: Scene, solved: Scene, rows: Any) -> Any:
        """Return the movement that was taught, or that a scene names, for every hand; it is read once."""
        key = repr((scene.file.demonstration, scene.turns_as_one, rows))
        if self._taught is None or self._taught[0] != key:
            self._taught = key, demonstration_of(scene) if rows is None else demonstration_from(rows)
        return movements_of(self._taught[1], solved)

    def save(self, header: Mapping[str, Any]) -> None:
        """Write the last result into a folder, as `comove solve` does.

        Raises
        ------
        ResultError
            If it cannot be written there.
        """
        from comove.io.folders import whole_folder
        from comove.results import RESULT
        from comove.views import save_result

        if self.solution is None or self.solution[0] != header["of"] or not self.solution[1].verified:
            self._send(header, "unsaved", reasons=["there is no verified motion of this scene to save yet"])
            return
        solution, folder = self.solution[1], Path(header["target"])
        with whole_folder(folder, RESULT) as draft:
            save_result(solution, draft, wall_time_s=solution.solve_time_s, with_scene=True)
        self._send(header, "saved", target=str(folder))

    def _found(
        self,
        verified: VerifiedMotion,
        header: Mapping[str, Any],
        begun: float,
        kind: str,
        **further: Any,
    ) -> None:
        motion, now = verified.motion, time.perf_counter() - begun
        if self._first[0] != header["id"]:
            self._first = header["id"], now
        recording = RecordedMotion.of(motion)
        further |= {"report": _numbers(verified.report), "verified_after": self._first[1]}
        self._send(header, kind, recording, begun, duration=motion.scene.duration, **further)

    def _send(
        self,
        header: Mapping[str, Any],
        kind: str,
        recording: RecordedMotion | None = None,
        begun: float | None = None,
        **further: Any,
    ) -> None:
        after = {} if begun is None else {"after": time.perf_counter() - begun}
        arrays = {} if recording is None else recording.arrays()
        self.tell(Message({"kind": kind, "id": header["id"], **after, **further}, arrays))

    def _say_compiling(self, kernel: str) -> None:
        self.tell(Message({"kind": "compiling", "id": -1, "kernel": kernel}))


def _aim_of(scene: Scene, header: Mapping[str, Any]) -> Any:
    """Return the objective that a draft asks for; None leaves it to `solve`."""
    name, resemblance = header["objective"], header["resemblance"]
    if header["method"] != Comove.name:
        return None if name not in AIMS else PaperCost()
    aim = AIMS[name]() if name in AIMS else objective_of_scene(scene.file.objective)
    if resemblance is None or isinstance(aim, LeastTime):
        return aim
    return LeastJerk(resemblance=resemblance) if aim is None else type(aim)(resemblance=resemblance)


def _numbers(report: Report) -> dict[str, float]:
    return {key: float(value) for key, value in asdict(report).items() if value is not None}


def main() -> None:
    """Answer drafts from standard input on standard output until it is closed."""
    answers: IO[bytes] = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever is printed must not come between the answers
    mailbox, writing = Mailbox(), threading.Lock()

    def read() -> None:
        while (message := read_message(sys.stdin.buffer)) is not None:
            mailbox.put(message)
        mailbox.close()

    def tell(message: Message) -> None:
        with writing:
            write_message(answers, message)

    threading.Thread(target=read, daemon=True).start()
    with suppress(BrokenPipeError, KeyboardInterrupt):
        Worker(mailbox, tell).run()
    os._exit(0)  # the thread that reads still waits


if __name__ == "__main__":
    main()
