"""The socket: one microscope, any number of clients."""

from __future__ import annotations

import socket
import socketserver
import threading
from typing import Any

import numpy.typing as npt

from ..errors import StemworldsError
from .messages import LONGEST_ANSWER, LONGEST_REQUEST, Answer, packed, parsed, receive, send, unpacked
from .microscope import Microscope

#: Where it listens unless told otherwise: this computer only, and the port of asyncroscopy's central server.
ADDRESS = ("127.0.0.1", 9000)


class _Handler(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        assert isinstance(self.server, Server)
        while True:
            try:
                request = receive(self.request, LONGEST_REQUEST)
            except (ValueError, ConnectionError) as error:
                self._send(f"ERROR: {error}")
                return
            if request is None:
                return
            if not self._send(self._answer(self.server.microscope, request)):
                return

    def _answer(self, microscope: Microscope, request: bytes) -> Answer:
        try:
            text = request.decode().strip()
            if not text:
                raise ValueError("the request is empty")
            verb, arguments = parsed(text)
            return microscope.answer(verb, arguments)
        except (ValueError, StemworldsError) as error:
            # StemworldsError of values are ValueErrors too; the others are of files and memory.
            return f"ERROR: {error}"

    def _send(self, answer: Answer) -> bool:
        try:
            send(self.request, packed(answer))
        except OSError:
            return False
        return True


class Server(socketserver.ThreadingTCPServer):
    """Serves a microscope until :meth:`close`.

    Args:
        microscope: it.
        address: host and port; port 0 takes one that is free, see :attr:`port`.

    Raises:
        OSError: where the port is taken.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, microscope: Microscope, address: tuple[str, int] = ADDRESS) -> None:
        super().__init__(address, _Handler)
        self.microscope = microscope

    @property
    def port(self) -> int:
        """The port that it listens on."""
        port: int = self.server_address[1]
        return port

    def start(self) -> Server:
        """Serves in a thread of its own; returns at once."""
        threading.Thread(target=self.serve_forever, name="stemworlds serve", daemon=True).start()
        return self

    def close(self) -> None:
        """Ends it."""
        self.shutdown()
        self.server_close()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()


class Client:
    """A client of such a server, for scripts and tests.

    >>> microscope = Client()                                                     # doctest: +SKIP
    >>> image = microscope.array("get_scanned_image", size=256, dwell_time=2e-6)  # doctest: +SKIP
    """

    def __init__(self, address: tuple[str, int] = ADDRESS, timeout_s: float | None = 600.0) -> None:
        self._socket = socket.create_connection(address, timeout=timeout_s)

    def __call__(self, verb: str, **arguments: object) -> Answer:
        """Sends a verb; returns its array or text.

        Raises:
            RuntimeError: with the server's words, where it refuses.
            ConnectionError: where it has gone.
        """
        words = [verb, *(f"{key}={value}" for key, value in arguments.items())]
        send(self._socket, " ".join(words).encode())
        message = receive(self._socket, LONGEST_ANSWER)
        if message is None:
            raise ConnectionError("the server has closed the connection")
        answer = unpacked(message)
        if isinstance(answer, str) and answer.startswith("ERROR: "):
            raise RuntimeError(answer.removeprefix("ERROR: "))
        return answer

    def array(self, verb: str, **arguments: object) -> npt.NDArray[Any]:
        """Sends a verb whose answer is an array.

        Raises:
            RuntimeError, ConnectionError: as a call; the first for answers that are text, too.
        """
        answer = self(verb, **arguments)
        if isinstance(answer, str):
            raise RuntimeError(f"{verb}: the answer is no array: {answer}")
        return answer

    def close(self) -> None:
        """Closes the connection."""
        self._socket.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
