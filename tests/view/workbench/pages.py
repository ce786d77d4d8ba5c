"""A page without a browser: it speaks the viewer's protocol over a websocket, as the page of a browser does."""

import contextlib
import time

import numpy as np


class Page:
    """A client that collects what the server sends, by the names of messages."""

    def __init__(self, address, **options):
        import viser
        from websockets.sync.client import connect

        options.setdefault("origin", address)
        options.setdefault("ping_timeout", None)  # a machine that has much to do may not answer for a while
        self.socket = connect(
            address.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
            **options,
        )
        self.messages = []

    def send(self, message):
        """Send a message of the viewer's, or bytes."""
        import msgspec

        if not isinstance(message, bytes):
            message = msgspec.msgpack.encode(message.as_serializable_dict())
        self.socket.send(message)

    def appear(self):
        """Tell where the camera is, by which the page counts as opened."""
        from viser import _messages as kinds

        fields = {
            "wxyz": (1.0, 0.0, 0.0, 0.0),
            "position": (0.5, 0.5, 2.0),
            "fov": 1.0,
            "near": 0.01,
            "far": 100.0,
            "image_height": 600,
            "image_width": 800,
            "look_at": (0.5, 0.5, 0.0),
            "up_direction": (0.0, 1.0, 0.0),
        }
        self.send(kinds.ViewerCameraMessage(**fields))
        return self

    def receive(self, wanted, timeout=600):
        """Return the first message, of those that come or have come, for which `wanted` holds."""
        import msgspec
        import zstandard

        for message in self.messages:
            if wanted(message):
                return message
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            with contextlib.suppress(TimeoutError):
                raw = self.socket.recv(timeout=left)
                length, packed = np.frombuffer(raw[:16], dtype="<u8").tolist()
                inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=length)
                new = msgspec.msgpack.decode(inner)["messages"]
                self.messages += new
                for message in new:
                    if wanted(message):
                        return message
        raise TimeoutError("the message did not come")

    def verdict(self, text, timeout=600):
        """Wait until a verdict holds a text, and return it."""
        found = self.receive(lambda message: text in words_of(message), timeout)
        return words_of(found)

    def close(self):
        """Close the page."""
        self.socket.close()


def words_of(message):
    """Return the Markdown that a message shows, empty where it shows none."""
    if message.get("type") == "GuiUpdateMessage":
        return str(message["updates"].get("_markdown", message["updates"].get("content", "")))
    if message.get("type") == "GuiMarkdownMessage":
        return str(message["props"].get("_markdown", ""))
    return ""
