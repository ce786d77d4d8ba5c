"""A real browser on a running workbench: Debian's chromium, driven by playwright."""

import contextlib
import shutil
import threading
import time

import numpy as np

from comove.geometry.rotations import matrices
from comove.view.workbench.server import serve
from comove.view.workbench.session import Session

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
]
SIZE = {"width": 1180, "height": 760}
PATIENCE = 180_000  # ms, as the browser draws without a graphics card
PLOTTED = """() => {
    const plots = [...document.querySelectorAll('.uplot canvas')];
    return plots.length >= 4 && plots.every(plot => plot.width > 100 && plot.getContext('2d')
        .getImageData(0, 0, plot.width, plot.height).data.some(value => value > 0));
}"""
HARMLESS = ("preventDefault inside passive event listener", "GPU stall", "favicon")


@contextlib.contextmanager
def browser():
    """Lend a browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        try:
            yield chromium
        finally:
            chromium.close()


class Bench:
    """A workbench with one page open in a browser.

    Attributes
    ----------
    page : the page
    session : its session, in this process
    errors : what the console said that is no mere remark
    """

    def __init__(self, chromium, shelf):
        self.sessions, plain = [], Session.__init__

        def made(session, *arguments):
            self.sessions.append(session)
            plain(session, *arguments)

        self._restore = plain
        Session.__init__ = made
        self.guarded = serve(shelf)
        self.page = chromium.new_page(viewport=SIZE)
        self.page.set_default_timeout(PATIENCE)
        self.errors = []
        self.page.on("console", self._heard)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(self.guarded.address)
        self.page.add_style_tag(
            content=".mantine-Notifications-root {display: none}"
        )  # on software rendering
        self.says("Verified")

    def _heard(self, message):
        if message.type == "error" and not any(words in message.text for words in HARMLESS):
            self.errors.append(message.text)

    @property
    def session(self):
        """The session of the page."""
        return self.sessions[-1]

    def says(self, text):
        """Wait until the page shows a text."""
        self.page.get_by_text(text).first.wait_for()

    def settle(self):
        """Wait until the planner has answered, and the browser has drawn it."""
        self.until(
            lambda: self.session.link.solved == self.session.link.asked and self.session.pointer.held is None
        )
        self.page.wait_for_timeout(1500)

    def plotted(self):
        """Wait until all plots have their size and a line: what comes before them is drawn then, too."""
        self.page.wait_for_function(PLOTTED)
        self.page.wait_for_timeout(3000)

    def until(self, condition):
        """Wait, while the browser lives, until a condition holds."""
        end = time.monotonic() + PATIENCE / 1e3
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError("it did not happen")
            self.page.wait_for_timeout(50)

    def pixel(self, point):
        """Return where a point of the scene is on the page [pixels]."""
        camera = self.session.client.camera
        turned = matrices(np.array(camera.wxyz)).T @ (
            np.asarray(point, dtype=float) - np.array(camera.position)
        )
        width, height = camera.image_width, camera.image_height
        focal = 0.5 * height / np.tan(0.5 * camera.fov)
        canvas = self.page.locator("canvas").first.bounding_box()
        scale = canvas["width"] / width
        return (
            canvas["x"] + scale * (0.5 * width + focal * turned[0] / turned[2]),
            canvas["y"] + scale * (0.5 * height + focal * turned[1] / turned[2]),
        )

    def drag(self, start, end, steps=10, pause=60):
        """Drag with the mouse from a point of the scene to another."""
        (x, y), (to_x, to_y) = self.pixel(start), self.pixel(end)
        self.page.mouse.move(x, y)
        self.page.wait_for_timeout(800)
        self.page.mouse.down()
        for step in range(1, steps + 1):
            self.page.mouse.move(x + step / steps * (to_x - x), y + step / steps * (to_y - y))
            self.page.wait_for_timeout(pause)
        self.page.mouse.up()

    def draw(self, way, pause=50):
        """Draw with the mouse along points of the scene, array of shape (n, 3)."""
        pixels = [self.pixel(point) for point in way]
        self.page.mouse.move(*pixels[0])
        self.page.wait_for_timeout(800)
        self.page.mouse.down()
        for pixel in pixels[1:]:
            self.page.mouse.move(*pixel)
            self.page.wait_for_timeout(pause)
        self.page.mouse.up()

    def press(self, label):
        """Press a button of the panel."""
        self.page.get_by_role("button", name=label, exact=True).click()

    def tab(self, label):
        """Show a tab of the panel."""
        self.page.get_by_role("tab", name=label, exact=True).click()

    def close(self):
        """Close the page and end the workbench."""
        Session.__init__ = self._restore
        self.page.close()
        for session in self.sessions:
            done = threading.Event()
            session.loop.call_soon_threadsafe(lambda end=session.close, told=done: (end(), told.set()))
            done.wait(10.0)
        self.guarded.stop()
