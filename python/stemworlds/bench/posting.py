"""Sends HTTP requests to an untrusted service, with limits on address, time and length of the reply."""

from __future__ import annotations

import functools
import http.client
import io
import socket
import time
import urllib.error
import urllib.request
from typing import IO, Any

__all__ = ["LONGEST_REPLY", "post"]

#: Longest reply in bytes. A usual reply of a model has a hundredth of this length.
LONGEST_REPLY = 1_000_000


def post(url: str, body: bytes, headers: dict[str, str], seconds: float) -> tuple[int, bytes]:
    """Sends a request. Returns the status of the reply and its bytes, at most :data:`LONGEST_REPLY` + 1.

    No redirect is followed, so the headers, with their key, are sent to this address alone.

    Args:
        seconds: time limit from the connection to the last byte. The look-up of the host name is not included.

    Raises:
        urllib.error.HTTPError: for any status except success.
        OSError, http.client.HTTPException: if there is no complete answer in time.
    """
    end = time.monotonic() + seconds
    opener = urllib.request.build_opener(_Stay, _Http(end), _Https(end))
    request = urllib.request.Request(url, data=body, headers=headers, method="POST")
    with opener.open(request, timeout=seconds) as answer:
        return answer.status, answer.read(LONGEST_REPLY + 1)


class _Stay(urllib.request.HTTPRedirectHandler):
    """Treats redirects as errors."""

    def http_error_302(self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: http.client.HTTPMessage) -> None:
        return None

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


class _Http(urllib.request.HTTPHandler):
    def __init__(self, end: float) -> None:
        super().__init__()
        self._end = end

    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(functools.partial(_Connection, self._end), req)


class _Https(urllib.request.HTTPSHandler):
    def __init__(self, end: float) -> None:
        super().__init__()
        self._end = end

    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(functools.partial(_SafeConnection, self._end), req)


def _left(end: float) -> float:
    """Returns the seconds until the end.

    Raises:
        TimeoutError: if the end has passed.
    """
    left = end - time.monotonic()
    if left <= 0:
        raise TimeoutError("the answer takes too long")
    return left


class _Connection(http.client.HTTPConnection):
    """A connection with a time limit for the whole exchange, also for a slow sequence of bytes."""

    def __init__(self, end: float, host: str, **options: Any) -> None:
        super().__init__(host, **options)
        self._end = end
        self.response_class = functools.partial(_Response, end)  # type: ignore[assignment]
        self._create_connection = functools.partial(_connected, end)

    def connect(self) -> None:
        super().connect()
        self.sock.settimeout(_left(self._end))


class _SafeConnection(_Connection, http.client.HTTPSConnection):
    """A connection with a time limit, over TLS."""


def _connected(end: float, address: tuple[str, int], _timeout: Any = None, source: Any = None) -> socket.socket:
    """Connects to one of the addresses of a host."""
    last: OSError | None = None
    for family, kind, protocol, _, place in socket.getaddrinfo(*address, type=socket.SOCK_STREAM):
        made = socket.socket(family, kind, protocol)
        try:
            made.settimeout(_left(end))
            if source:
                made.bind(source)
            made.connect(place)
            made.settimeout(_left(end))
            return made
        except OSError as error:
            made.close()
            last = error
    raise last or OSError(f"{address[0]} has no address")


class _Response(http.client.HTTPResponse):
    def __init__(self, end: float, connection: socket.socket, *options: Any, **named: Any) -> None:
        super().__init__(_Timed(connection, end), *options, **named)  # type: ignore[arg-type]


class _Timed:
    """A stream for a response. Each read is limited to the remaining time."""

    def __init__(self, connection: socket.socket, end: float) -> None:
        self._connection, self._end = connection, end

    def makefile(self, _mode: str = "rb") -> IO[bytes]:
        return io.BufferedReader(_Parts(self._connection, self._end))


class _Parts(io.RawIOBase):
    def __init__(self, connection: socket.socket, end: float) -> None:
        self._connection, self._end = connection, end
        # The file keeps the connection open after the request has been sent, and closes it at its own end.
        self._file = connection.makefile("rb", buffering=0)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        self._connection.settimeout(_left(self._end))
        count: int | None = self._file.readinto(buffer)
        return count

    def close(self) -> None:
        self._file.close()
        super().close()
