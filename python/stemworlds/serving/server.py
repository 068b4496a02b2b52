"""Serves one microscope to several clients over a socket."""

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

#: The default address: this computer only, and the port of asyncroscopy's central server.
ADDRESS = ("127.0.0.1", 9000)


#: Greatest number of simultaneous clients.
MOST_CLIENTS = 64
#: Greatest number of seconds without a request from a client, or for reading an answer.
IDLE_S = 3600.0
#: Greatest number of seconds from the first to the last byte of a request.
MESSAGE_S = 60.0
#: Greatest number of bytes that are read from a client after an error. With unread bytes, the system could drop the message about the
#: error.
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
            # Errors of values are ValueErrors; other StemworldsErrors are about files and memory.
            return f"ERROR: {error}"
        except Exception as error:
            # Any other error is sent to the client, and the server continues.
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
    """Closes the connection for writing, and reads the remaining bytes from the client."""
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_WR)
        connection.setblocking(False)
        left = _REST
        while left > 0 and (part := connection.recv(left)):
            left -= len(part)


class Server(socketserver.ThreadingTCPServer):
    """Serves a microscope until :meth:`close`.

    Args:
        microscope: the microscope, or a function that makes it. The function is called after the port is reserved. Clients can connect
            after it has returned.
        address: host and port. Port 0 chooses a free port, see :attr:`port`.
        most_clients: greatest number of simultaneous connections. Further clients get an error, and are disconnected.
        idle_s: seconds without a request after which a client is disconnected.
        message_s: greatest number of seconds from the first to the last byte of a request.

    Raises:
        OSError: if the port is in use.
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
        """The port of the server."""
        port: int = self.server_address[1]
        return port

    def start(self) -> Server:
        """Serves in a separate thread. Returns at once."""
        self._begun = True
        threading.Thread(target=self.serve_forever, name="stemworlds serve", daemon=True).start()
        return self

    def serve_forever(self, poll_interval: float = 0.1) -> None:
        """Serves until another thread calls :meth:`close`, or an exception is raised."""
        self._begun = True
        super().serve_forever(poll_interval)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Starts a thread for a client, unless there are too many clients."""
        with self._guard:
            there = len(self._clients)
            if there < self.most_clients:
                self._clients.add(request)
        if there < self.most_clients:
            super().process_request(request, client_address)
            return
        with contextlib.suppress(OSError):
            # The message fits into the buffer of a new connection, so it need not wait.
            request.setblocking(False)
            send(request, packed(f"ERROR: {there} clients are connected, and no more are served; close one of them"))
        _drain(request)
        self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Closes a connection."""
        with self._guard:
            self._clients.discard(request)
        super().shutdown_request(request)

    def close(self) -> None:
        """Stops the server, and closes all connections. A recording in progress is completed."""
        if self._begun:
            # shutdown() would wait for ever if the server never served.
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
    """A client of :class:`Server`, for scripts and tests.

    >>> microscope = Client()                                                     # doctest: +SKIP
    >>> image = microscope.array("get_scanned_image", size=256, dwell_time=2e-6)  # doctest: +SKIP
    """

    def __init__(self, address: tuple[str, int] = ADDRESS, timeout_s: float | None = 600.0) -> None:
        self._socket = socket.create_connection(address, timeout=timeout_s)

    def __call__(self, verb: str, **arguments: object) -> Answer:
        """Sends a verb. Returns the array or text of its answer.

        Raises:
            RuntimeError: if the server reports an error. It has the server's message.
            ConnectionError: if the server has closed the connection.
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
        """Sends a verb with an array as its answer. Returns the array.

        Raises:
            RuntimeError, ConnectionError: see :meth:`__call__`. A text as answer is a RuntimeError too.
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
