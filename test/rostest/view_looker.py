"""Somebody who looks at the view's page, without a browser: what is in the scene, clicks, driving.

Speaks viser's protocol as the page does.
"""

import contextlib
import json
import queue
import re
import secrets
import socket
import threading
import time

import numpy as np
import viser
import zstandard
from lab_testing import wait_for
from msgspec import msgpack
from viser import _messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


class Looker:
    """Looks at a page until it is closed; all of its nodes are in `nodes`, by name.

    Args:
        url: of the page, with the token.
    """

    def __init__(self, url):
        self.nodes = {}
        self.controls = {}
        self.received = 0
        scheme, host = url.split("/")[0], url.split("/")[2]
        self._options = {"origin": f"{scheme}//{host}", "max_size": None, "compression": None}
        # A name of its own, as each tab has.
        self._address = f"{url.replace('http', 'ws', 1)}{secrets.token_hex(4)}"
        self._socket = connect(
            self._address, subprotocols=[f"viser-v{viser.__version__}"], **self._options
        )
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()
        self.say(
            _messages.ViewerCameraMessage(
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=(0.0, 0.0, 5.0),
                fov=1.0,
                near=0.1,
                far=100.0,
                image_height=480,
                image_width=640,
                look_at=(0.0, 0.0, 0.0),
                up_direction=(0.0, 0.0, 1.0),
            )
        )

    def click(self, x, y):
        """Click on the floor."""
        self.say(
            _messages.ScenePointerMessage(
                "click", (x, y, 5.0), (0.0, 0.0, -1.0), ((0.5, 0.5),), None
            )
        )

    def press(self, label, value):
        """Have a control of the page, by its label, say a value."""
        uuid = next(k for k, props in self.controls.items() if props.get("label") == label)
        self.say(_messages.GuiUpdateMessage(uuid, {"value": value}))

    def driver(self):
        """Return a pad to drive by."""
        return Driver(connect(self._address + "/drive", **self._options))

    def positions(self, name):
        """Return where the copies in a node are, (n, 3); empty where there is no such node."""
        props = self.nodes.get(name, {})
        return np.array(props.get("batched_positions", ())).reshape(-1, 3)

    def close(self):
        """Close the page."""
        self._socket.close()
        self._thread.join(5.0)

    def say(self, message):
        """Send a message, one of viser's or its bytes."""
        data = message if isinstance(message, bytes) else pack(message.as_serializable_dict())
        self._socket.send(data)

    def _receive(self):
        try:
            for data in self._socket:
                self.received += len(data)
                for message in read_messages(data):
                    self._take(message)
        except ConnectionClosed:
            pass

    def _take(self, message):
        kind, name = message["type"], message.get("name")
        if kind == "RemoveSceneNodeMessage":
            self.nodes.pop(name, None)
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.setdefault(name, {}).update(message["updates"])
        elif kind in ("SetPositionMessage", "SetOrientationMessage"):
            key = "position" if "position" in message else "wxyz"
            self.nodes.setdefault(name, {})[key] = message[key]
        elif kind == "GuiUpdateMessage":
            self.controls.setdefault(message["uuid"], {}).update(message["updates"])
        elif kind.startswith("Gui") and "props" in message:
            self.controls[message["uuid"]] = dict(message["props"])
        elif name is not None and "props" in message:
            self.nodes[name] = dict(message["props"])


class Link:
    """A forwarded port that takes its time: `delay` s each way, and nothing passes while `stalled`.

    Args:
        url: of the page.
        delay: s, each way.

    Attributes:
        url: of the page by this link.
    """

    def __init__(self, url, delay=0.0):
        self._target = (url.split("/")[2].split(":")[0], int(url.split("/")[2].split(":")[1]))
        self._delay, self.stalled = delay, threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        port = self._server.getsockname()[1]
        self.url = url.replace(f":{self._target[1]}", f":{port}")
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self):
        """Take no more connections."""
        self._server.close()

    def _serve(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(self._target)
                for ends in ((near, far), (far, near)):
                    pieces = queue.Queue()
                    for work in (self._take, self._pass_on):
                        threading.Thread(target=work, args=(*ends, pieces), daemon=True).start()

    def _take(self, source, _, pieces):
        with contextlib.suppress(OSError):
            while True:
                data = source.recv(65536)
                pieces.put((time.monotonic() + self._delay, data))
                if not data:
                    return

    def _pass_on(self, _, target, pieces):
        with contextlib.suppress(OSError):
            while True:
                due, data = pieces.get()
                time.sleep(max(0.0, due - time.monotonic()))
                while self.stalled.is_set():
                    time.sleep(0.01)
                if not data:
                    target.close()
                    return
                target.sendall(data)


class Driver:
    """A pad as the page has it: its words bear the newest time that the server has told.

    `told` is what that has said last.
    """

    def __init__(self, socket):
        self.socket = socket
        self.told = json.loads(socket.recv())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def listen(self):
        """Take up what the server has said, and return the newest."""
        with contextlib.suppress(TimeoutError):
            while True:
                self.told = json.loads(self.socket.recv(timeout=0.0))
        return self.told

    def send(self, shares):
        """Say what is held down, forward and to the left."""
        self.socket.send(f"{self.listen()['time']} {shares}")


def pack(message):
    """Return a message, a dict, as viser's protocol has it."""
    return msgpack.encode(message)


def read_messages(data):
    """Return the messages in what the page is sent at once."""
    size = int.from_bytes(data[8:16], "little")
    found = msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))
    buffers, place = [], 16 + size
    for length in found["binaryBufferLengths"]:
        place += -place % 8
        buffers.append(data[place : place + length])
        place += length
    return _with_arrays(found["messages"], buffers)


def _with_arrays(value, buffers):
    if isinstance(value, dict):
        if "__binary_index" in value:
            return np.frombuffer(buffers[value["__binary_index"]], value["dtype"])
        return {key: _with_arrays(entry, buffers) for key, entry in value.items()}
    if isinstance(value, list):
        return [_with_arrays(entry, buffers) for entry in value]
    return value


def wait_for_url(output):
    """Return the URL that a view has printed; `output` says what it has printed so far."""
    return wait_for(lambda: re.search(r"the view is at (\S+)", output()), output)[1]
