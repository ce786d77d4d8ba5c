"""Draw pictures of docs/workbench.md in a real browser: `python -m tests.workbench.pictures docs [NAME ...]`."""

import sys
from pathlib import Path

import numpy as np

from comove.experiments.examples import example_path
from comove.workbench.shelf import shelf_of
from tests.workbench.browser import Bench, browser


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
    show_at(bench, 4.5)


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
    show_at(bench, 6.0)


def show_at(bench, time):
    """Stop at an instant."""
    bench.session.loop.call_soon_threadsafe(bench.session.changed, "time", time)
    bench.page.wait_for_timeout(2500)


PICTURES = {
    "workbench_planar": ("narrow", planar),
    "workbench_spatial": ("window", spatial),
    "workbench_refused": ("narrow", refused),
    "workbench_taught": ("narrow", taught),
    "workbench_compared": ("narrow", compared),
}


def main(folder, *names):
    """Draw pictures, all unless named, into a folder."""
    with browser() as chromium:
        for name in names or PICTURES:
            scene, pose = PICTURES[name]
            bench = Bench(chromium, shelf_of(example_path(scene), folder))
            try:
                bench.settle()
                pose(bench)
                bench.page.screenshot(path=folder / f"{name}.png")
                print(folder / f"{name}.png")
            finally:
                bench.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
