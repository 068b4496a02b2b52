"""The socket: one microscope, any number of clients."""

from __future__ import annotations

import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable
from typing import Any

import numpy.typing as npt

from ..errors import StemworldsError
from .messages import LONGEST_ANSWER, LONGEST_REQUEST, Answer, packed, parsed, receive, send, unpacked
from .microscope import Microscope

#: Where it listens unless told otherwise: this computer only, and the port of asyncroscopy's central server.
ADDRESS = ("127.0.0.1", 9000)


#: Clients at a time.
MOST_CLIENTS = 64
#: Seconds that a client may say nothing, or take to read an answer.
IDLE_S = 3600.0
#: Seconds that a request may take to come, from its first byte.
MESSAGE_S = 60.0
#: Bytes that are still read of a client after an error: else its end of the connection might drop the error unread.
_REST = 1 << 16


class _Handler(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        server = self.server
        assert isinstance(server, Server)
        while True:
            try:
                request = receive(self.request, LONGEST_REQUEST, idle_s=server.idle_s, message_s=server.message_s)
            except (ValueError, OSError) as error:
                if self._send(f"ERROR: {error}"):
                    _drain(self.request)
                return
            if request is None:
                return
            if not self._send(self._answer(server.microscope, request)):
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
        except Exception as error:
            # Whatever it is, the client hears of it and the server goes on.
            return f"ERROR: a fault of the server, please report it: {type(error).__name__}: {error}"

    def _send(self, answer: Answer) -> bool:
        assert isinstance(self.server, Server)
        try:
            self.request.settimeout(self.server.idle_s)
            send(self.request, packed(answer))
        except OSError:
            return False
        return True


def _drain(connection: socket.socket) -> None:
    """Says that no more is said, and reads what the client has sent by now."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_WR)
        connection.setblocking(False)
        left = _REST
        while left > 0 and (part := connection.recv(left)):
            left -= len(part)


class Server(socketserver.ThreadingTCPServer):
    """Serves a microscope until :meth:`close`.

    Args:
        microscope: it, or a function that makes it. The function is called when the port is taken, and clients can connect when it has returned.
        address: host and port; port 0 takes one that is free, see :attr:`port`.
        most_clients: connections at a time; more are told so, and closed.
        idle_s: seconds after which a client that says nothing is disconnected.
        message_s: seconds that a request may take to come, from its first byte to the last.

    Raises:
        OSError: where the port is taken.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(
        self,
        microscope: Microscope | Callable[[], Microscope],
        address: tuple[str, int] = ADDRESS,
        *,
        most_clients: int = MOST_CLIENTS,
        idle_s: float = IDLE_S,
        message_s: float = MESSAGE_S,
    ) -> None:
        super().__init__(address, _Handler, bind_and_activate=False)
        self.most_clients: int = most_clients
        self.idle_s: float = idle_s
        self.message_s: float = message_s
        self._clients: set[socket.socket] = set()
        self._guard = threading.Lock()
        self._begun = False
        try:
            self.server_bind()
            self.microscope: Microscope = microscope if isinstance(microscope, Microscope) else microscope()
            self.server_activate()
        except BaseException:
            self.server_close()
            raise

    @property
    def port(self) -> int:
        """The port that it listens on."""
        port: int = self.server_address[1]
        return port

    def start(self) -> Server:
        """Serves in a thread of its own; returns at once."""
        self._begun = True
        threading.Thread(target=self.serve_forever, name="stemworlds serve", daemon=True).start()
        return self

    def serve_forever(self, poll_interval: float = 0.1) -> None:
        """Serves until another thread calls :meth:`close`, or an exception comes."""
        self._begun = True
        super().serve_forever(poll_interval)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Gives a client a thread, unless there are too many."""
        with self._guard:
            there = len(self._clients)
            if there < self.most_clients:
                self._clients.add(request)
        if there < self.most_clients:
            super().process_request(request, client_address)
            return
        with contextlib.suppress(OSError):
            # A connection that has just begun takes so few bytes at once.
            request.setblocking(False)
            send(request, packed(f"ERROR: {there} clients are connected, and no more are served; close one of them"))
        _drain(request)
        self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Ends a connection."""
        with self._guard:
            self._clients.discard(request)
        super().shutdown_request(request)

    def close(self) -> None:
        """Ends it, and the connections of all clients. What is being recorded is recorded to its end."""
        if self._begun:
            # Of a server that never served it would wait for ever.
            self.shutdown()
        self.server_close()
        with self._guard:
            clients = list(self._clients)
        for client in clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

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
