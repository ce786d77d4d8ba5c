"""Latency of the workbench, from a drag to a verified motion.

    python -m benchmarks.workbench [--drags 100] [SCENE ...]
    python -m benchmarks.workbench --memory                      # of page and planner, over 1000 drags
    python -m benchmarks.workbench --frames                      # in a browser, with 500 obstacles

Every drag takes an obstacle, a start or a goal, and moves it in `STEPS` steps to a random place near its own, as a
person would: a step every `PERIOD`. What is timed is what the page does: the draft goes to the planner's process, and
its first verified answer to the last step comes back with all that is drawn. Drags that end in no valid scene (a
start inside an obstacle), or where no motion is found, are counted apart, with the time after which the page says so.
The next drag begins with the first answer, as that of a person who does not wait: it ends the search before it.
"""

import argparse
import contextlib
import os
import queue
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import yaml

import comove
from benchmarks.timing import memory_of
from comove.view.workbench.edits import Draft, contents_of, grips_of, moved, place_of
from comove.view.workbench.link import Link
from comove.view.workbench.session import PageSettings
from comove.view.workbench.shelf import read_scene, shelf_of

STEPS, PERIOD = 5, 0.05  # s
REACH = 0.06  # of the longest side of the workspace: how far from its own place a thing is dragged
ENOUGH = 60.0  # s, after which a drag counts as lost
EXAMPLES = Path(comove.__file__).parent / "examples"
SCENES = [
    EXAMPLES / f"{name}.yaml" for name in ("wide", "narrow", "complex", "turning", "window", "triangle")
]


def answer_to(number, answers, kinds=("kept", "found", "solved", "failed")):
    """Wait for a draft's first answer of some kinds. Return its kind, and when it came [s]."""
    until = time.perf_counter() + ENOUGH
    while True:
        answer = answers.get(timeout=max(until - time.perf_counter(), 0.01))
        if answer["id"] == number and answer["kind"] in kinds:
            return answer["kind"], time.perf_counter()


def dragged(scene, link, answers, rng):
    """Make one drag; return its result and latency [s]."""
    contents = contents_of(scene)
    grips = grips_of(scene)
    grip = grips[rng.integers(len(grips))]
    home, reach = place_of(contents, grip), REACH * float((scene.upper - scene.lower).max())
    there = home.copy()
    there[: scene.n_dims] += rng.uniform(-reach, reach, scene.n_dims)
    for step in range(1, STEPS + 1):
        draft = Draft(moved(contents, grip, home + step / STEPS * (there - home)))
        begun, number = (
            time.perf_counter(),
            link.submit(draft, PageSettings().times_of(scene), dragging=step < STEPS),
        )
        if step < STEPS:
            time.sleep(PERIOD)
    kind, arrived = answer_to(number, answers)
    return kind, arrived - begun


def measured(path, n_drags, seed):
    """Drag many times in one scene; print a row."""
    scene, answers, rng = read_scene(path), queue.Queue(), np.random.default_rng(seed)
    link = Link(path.parent, lambda _, answer: answers.put(answer))
    number = link.submit(Draft(contents_of(scene)), PageSettings().times_of(scene))
    answer_to(number, answers, ("solved",))  # kernels are loaded
    for _ in range(10):
        dragged(scene, link, answers, rng)
    before = memory_of(link.pid)
    made = [dragged(scene, link, answers, rng) for _ in range(n_drags)]
    after = memory_of(link.pid)
    link.close()
    found = 1e3 * np.array([t for kind, t in made if kind != "failed"])
    anew = 1e3 * np.array([t for kind, t in made if kind not in ("failed", "kept")])
    failed = 1e3 * np.array([t for kind, t in made if kind == "failed"])

    def spread(times):
        return f"{np.median(times):5.0f} {np.percentile(times, 95):6.0f}" if len(times) else "    -      -"

    kept = len(found) - len(anew)
    print(
        f"{path.stem:14s} {len(found):5d} {spread(found)}   {kept:4d}   {len(anew):4d} {spread(anew)}   "
        f"{len(failed):4d} {spread(failed)}   {before:5.0f} {after:6.0f}",
        flush=True,
    )


def drag_on_page(session, grips, home, rng):
    """Drag on a page in `STEPS` movements, and wait for its planner."""
    grip = grips[rng.integers(len(grips))]
    reach = REACH * float((session.scene.upper - session.scene.lower).max())
    there = home[grip] + rng.uniform(-reach, reach, 3)
    before = session.link.answered
    for step in range(1, STEPS + 1):
        to = home[grip] + step / STEPS * (there - home[grip])
        session.loop.call_soon_threadsafe(
            lambda to=to, last=step == STEPS: session.move(grip, to, None, last=last)
        )
        time.sleep(0.01)
    until = time.monotonic() + ENOUGH
    while session.link.answered <= before and time.monotonic() < until:
        time.sleep(0.005)


def memory(n_drags, seed, every=100):
    """Print the memory of server and planner during drags."""
    from comove.view.workbench.server import serve
    from comove.view.workbench.session import Session
    from tests.view.workbench.pages import Page

    sessions, plain = [], Session.__init__

    def made(session, *arguments):
        plain(session, *arguments)
        sessions.append(session)

    Session.__init__ = made
    rng, path = np.random.default_rng(seed), EXAMPLES / "narrow.yaml"
    guarded = serve(shelf_of([path], path.parent))
    page = Page(guarded.address.rstrip("/"), ping_interval=None).appear()
    page.verdict("The search is done")
    (session,) = sessions
    page.messages = []

    def drain():
        with contextlib.suppress(Exception):  # until the page is closed
            while True:
                page.socket.recv()

    threading.Thread(target=drain, daemon=True).start()
    grips = grips_of(session.scene)
    home = {grip: place_of(session.history.now.contents, grip) for grip in grips}
    print("drags   page, server and client [MB]   planner [MB]")
    for drag in range(n_drags + 1):
        if drag % every == 0:
            print(
                f"{drag:5d}   {memory_of(os.getpid()):28.0f}   {memory_of(session.link.pid):12.0f}",
                flush=True,
            )
        drag_on_page(session, grips, home, rng)
    page.close()
    session.close()
    guarded.stop()


def crowded(n_obstacles, seed):
    """Return a spatial scene with many balls, one in five moving."""
    rng, obstacles = np.random.default_rng(seed), []
    while len(obstacles) < n_obstacles:
        x, y, z = rng.uniform(0.02, 0.98, 3).round(4).tolist()
        if np.hypot(y - 0.5, z - 0.5) > 0.3:
            moves = {"motion": {"velocity": [0.01, 0.0, 0.0]}} if len(obstacles) % 5 == 0 else {}
            obstacles.append({"shape": "sphere", "center": [x, y, z], "radius": 0.015, **moves})
    return {
        "name": "crowded",
        "duration": 5.0,
        "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "obstacles": obstacles,
        "load": {"shape": "bar", "length": 0.2, "radius": 0.01},
        "manipulators": [
            {"name": "a", "start": [0.1, 0.4, 0.5], "goal": [0.9, 0.4, 0.5]},
            {"name": "b", "start": [0.1, 0.6, 0.5], "goal": [0.9, 0.6, 0.5]},
        ],
    }


INTERVALS = """count => new Promise(done => {
    const times = [];
    const next = now => { times.push(now); times.length <= count ? requestAnimationFrame(next) : done(times); };
    requestAnimationFrame(next);
})"""


def frames(n_obstacles, seed, n_frames=30):
    """Print the latency of a state, and the browser's frame rate."""
    from tests.view.workbench.browser import Bench, browser

    with tempfile.TemporaryDirectory() as folder, browser() as chromium:
        path = Path(folder) / "crowded.yaml"
        path.write_text(yaml.safe_dump(crowded(n_obstacles, seed)), encoding="utf-8")
        bench = Bench(chromium, shelf_of([path], Path(folder)))
        try:
            bench.settle()
            session, sent = bench.session, []
            plain = session._show

            def timed(*arguments, **options):
                begun = time.perf_counter()
                plain(*arguments, **options)
                sent.append(time.perf_counter() - begun)

            session._show = timed
            drawn = 1e-3 * np.diff(bench.page.evaluate(INTERVALS, n_frames))
            report(f"a state is sent, {n_obstacles} obstacles", sent)
            report("between two pictures of the browser", drawn)
        finally:
            bench.close()


def report(what, times):
    """Print median and 95 % of times [s]."""
    times = 1e3 * np.array(times)
    median, most = np.median(times), np.percentile(times, 95)
    print(f"{what}: {len(times)} times, median {median:.1f} ms, 95 % {most:.1f} ms", flush=True)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", type=Path, default=SCENES)
    parser.add_argument("--drags", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--memory", action="store_true", help="print the memory over 1000 drags")
    parser.add_argument("--frames", action="store_true", help="print times of pictures with 500 obstacles")
    options = parser.parse_args()
    if options.memory or options.frames:
        if options.memory:
            memory(1000, options.seed)
        if options.frames:
            frames(500, options.seed)
        return
    print(
        f"{options.drags} drags a scene; times in ms after the last movement: median and 95 %; memory in MB"
    )
    print(
        "scene          found  med.   95 %   kept   anew  med.   95 %   none  med.   95 %   memory: before, after"
    )
    for path in options.scenes:
        measured(path, options.drags, options.seed)


if __name__ == "__main__":
    main()
