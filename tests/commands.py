"""Commands of comove in this process: the start of another costs more than most of what they do."""

import warnings
from contextlib import ExitStack, chdir
from functools import cache
from io import BytesIO
from unittest import mock

import typer.testing
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from comove.cli.app import whole_application
from comove.view.figures import style

typer.testing._get_command = cache(typer.testing._get_command)  # it is built anew for every command otherwise


def _pixel(figure, **_):
    said, picture = PngInfo(), BytesIO()
    said.add_text("Software", "Matplotlib")  # by which a picture of a program is told from a photograph
    Image.new("L", (1, 1)).save(picture, "PNG", pnginfo=said)
    return picture.getvalue()


def invoke(*arguments, folder=".", pictures=False):
    """What a command printed that was run in a folder, and its exit code.

    Figures are made, but without `pictures` they become images of one pixel: layout and pixels, which take longer
    than most commands, are what tests of figures are about.
    """
    with warnings.catch_warnings(), chdir(folder), ExitStack() as patched:
        if not pictures:
            for kind, name, instead in (
                (ConstrainedLayoutEngine, "execute", lambda *_: None),
                (style, "png", _pixel),
            ):
                patched.enter_context(mock.patch.object(kind, name, instead))
        return typer.testing.CliRunner().invoke(
            whole_application(), [str(argument) for argument in arguments]
        )
