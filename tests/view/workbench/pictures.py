"""Draw pictures of docs/workbench.md in a real browser: `python -m tests.view.workbench.pictures docs [NAME ...]`."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

from comove.lab.examples import example_path
from comove.view.workbench.shelf import shelf_of
from tests.view.workbench.browser import Bench, browser
from tests.view.workbench.test_live import OPEN


def planar(bench):
    """Drag the lower wall of the narrow passage, and stop in the middle of the way."""
    height = np.array([0.0, 0.0, 0.03])
    centre = bench.session.scene.centers[0] + height
    bench.drag(centre, centre + [-0.12, 0.0, 0.0])
    bench.until(lambda: bench.session.history.at == 1)
    bench.settle()
    show_at(bench, 4.6)


def spatial(bench):
    """Look at the window in space."""
    show_at(bench, 5.0)


def refused(bench):
    """Drag a wall onto the start."""
    centre = bench.session.scene.centers[0] + [0.0, 0.1, 0.03]
    bench.drag(centre, np.array([0.15, 0.45, 0.03]))
    bench.says("No verified motion found")
    bench.tab("Steer")
    bench.page.wait_for_timeout(2500)


def compared(bench):
    """Show the paper's method beside comove's own."""
    bench.tab("Compare")
    bench.session.loop.call_soon_threadsafe(bench.session.changed, "beside", "paper")
    bench.session.panels.controls["beside"].value = "paper"
    bench.until(lambda: "**paper**: **" in bench.session.panels.beside.content)
    bench.until(lambda: "Searching" not in bench.session.panels.beside.content)
    stop_at(bench, 4.5)


def taught(bench):
    """Draw a movement, which is learned and used."""
    bench.tab("Teach")
    bench.press("Show a movement")
    bench.says("Draw now")
    bench.page.wait_for_timeout(1500)
    shares = np.linspace(0.0, 1.0, 40)
    high = 0.5 - 0.3 * np.sin(2 * np.pi * shares)
    bench.draw(np.stack([0.15 + 0.7 * shares, high, np.full(40, 0.0375)], axis=1))
    bench.says("Learned")
    bench.settle()
    stop_at(bench, 6.0)


def show_at(bench, time):
    """Stop at an instant, with the plots in sight."""
    stop_at(bench, time)
    bench.plotted()


def stop_at(bench, time):
    """Stop at an instant."""
    bench.session.loop.call_soon_threadsafe(bench.session.changed, "time", time)
    bench.page.wait_for_timeout(4000)


def robot(bench):
    """Look at two arms with their load between the posts."""
    show_at(bench, 5.5)


def run(bench):
    """Lead the disc into the way of the load while it goes, and look when it dodges."""
    session = bench.session
    bench.tab("Run")
    bench.press("Run it live")
    bench.until(lambda: session.live and "the load" in session.panels.ran.content)
    bench.page.wait_for_timeout(400)
    disc = session.scene.centers[0] + [0.0, 0.0, session.stage.lift]
    bench.drag(disc, np.array([0.5, 0.55, session.stage.lift]), pause=20)
    bench.page.wait_for_timeout(3000)
    bench.until(lambda: float(session.panels.ran.content.partition(" s:")[0]) > 0.5 * LIVE)
    assert session.live, "the machine is too slow for this picture"


def executed(bench):
    """Look at a stored run when the load waits for the disc."""
    show_at(bench, 2.2)


def example(name):
    """Return a function that gives the path of an example."""
    return lambda folder: example_path(name)


def two_pandas(folder):
    """Return the path of the scene with two arms."""
    return EXAMPLES / "robots" / "two_pandas.yaml"


def opened(folder):
    """Write a scene with a single disc beside the way, and return its path."""
    path = folder / "open.yaml"
    path.write_text(yaml.safe_dump({**OPEN, "duration": LIVE}, sort_keys=False), encoding="utf-8")
    return path


def crossed(folder):
    """Execute the scene with a crossing disc, and return the folder."""
    command = ["run", str(EXAMPLES / "moving" / "crossing.yaml"), "--out", "crossed"]
    subprocess.run([sys.executable, "-m", "comove", *command], cwd=folder, check=True)
    return folder / "crossed"


LIVE = 20.0  # s, of the run that is shown
EXAMPLES = Path(__file__).parents[3] / "examples"
PICTURES = {
    "workbench_planar": (example("narrow"), planar),
    "workbench_spatial": (example("window"), spatial),
    "workbench_refused": (example("narrow"), refused),
    "workbench_taught": (example("narrow"), taught),
    "workbench_compared": (example("narrow"), compared),
    "workbench_robot": (two_pandas, robot),
    "workbench_run": (crossed, executed),
    "workbench_live": (opened, run),
}


def main(folder, *names):
    """Draw pictures, all unless named, into a folder."""
    with browser() as chromium, tempfile.TemporaryDirectory() as made:
        for name in names or PICTURES:
            source, pose = PICTURES[name]
            bench = Bench(chromium, shelf_of([source(Path(made))], folder))
            try:
                bench.settle()
                bench.plotted()
                pose(bench)
                bench.page.screenshot(path=folder / f"{name}.png")
                print(folder / f"{name}.png")
            finally:
                bench.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
