"""Messages of asyncroscopy's servers and clients: what they look like on the wire.

A message is its length, four bytes, the greatest first, and so many bytes. A request is text: ``AS_get_scanned_image size=256
dwell_time=2e-6``, a verb with or without the name of a server before it, and words ``key=value``. An answer is ``[dtype,shape]`` and
the bytes of an array, or ``[str,length]`` and text. (Its servers: https://github.com/pycroscopy/asyncroscopy.)
"""

from __future__ import annotations

import socket
import struct
import time
from typing import Any

import numpy as np
import numpy.typing as npt

#: Longest request.
LONGEST_REQUEST = 1 << 16
#: Longest answer.
LONGEST_ANSWER = 1 << 30
#: Names of servers that may stand before a verb.
SERVERS = ("AS", "Gatan", "Ceos", "Central")

Answer = str | npt.NDArray[Any]


def packed(answer: Answer) -> bytes:
    """An answer as bytes."""
    if isinstance(answer, str):
        text = answer.encode()
        return f"[str,{len(text)}]".encode() + text
    shape = ",".join(str(n) for n in answer.shape)
    return f"[{answer.dtype.name},{shape}]".encode() + np.ascontiguousarray(answer).tobytes()


def unpacked(message: bytes) -> Answer:
    """The answer that bytes are.

    Raises:
        ValueError: for bytes that are none.
    """
    head, closed, body = message.partition(b"]")
    if not closed or not head.startswith(b"["):
        raise ValueError(f"the answer begins with {message[:20]!r}, not with [dtype,shape]")
    dtype, *shape = head[1:].decode("ascii").split(",")
    if dtype == "str":
        return body.decode()
    return np.frombuffer(body, dtype=dtype).reshape([int(n) for n in shape])


def parsed(request: str) -> tuple[str, dict[str, str]]:
    """The verb of a request, without the name of a server, and its arguments.

    Raises:
        ValueError: for an empty request, and words that are no ``key=value``.
    """
    # Tuples may hold spaces: a word without = goes on with the last one.
    verb, *words = request.split()
    arguments: dict[str, str] = {}
    last = None
    for word in words:
        key, equals, value = word.partition("=")
        if equals:
            arguments[key], last = value, key
        elif last is not None:
            arguments[last] += word
        else:
            raise ValueError(f"{word!r}: expected key=value")
    server, _, rest = verb.partition("_")
    if server in SERVERS and rest:
        verb = rest
    return verb, arguments


def send(connection: socket.socket, message: bytes) -> None:
    """Sends a message with its length before it."""
    connection.sendall(struct.pack("!I", len(message)) + message)


def receive(connection: socket.socket, longest: int, *, idle_s: float | None = None, message_s: float | None = None) -> bytes | None:
    """The next message; ``None`` where the other side has closed the connection, or has said nothing for ``idle_s``.

    Args:
        message_s: seconds from the first byte of a message to the last.

    Raises:
        ValueError: for a message that is longer than ``longest``.
        ConnectionError: where it ends early, or comes too slowly.
    """
    if idle_s is not None:
        connection.settimeout(idle_s)
    try:
        first = connection.recv(1)
    except TimeoutError:
        if idle_s is None:
            raise
        return None
    if not first:
        return None
    end = None if message_s is None else time.monotonic() + message_s
    try:
        (length,) = struct.unpack("!I", first + _exactly(connection, 3, end))
        if length > longest:
            raise ValueError(f"a message of {length} bytes: at most {longest} are read")
        return _exactly(connection, length, end)
    except TimeoutError:
        if message_s is None:
            raise
        raise ConnectionError(f"the message was not whole after {message_s:g} s") from None


def _exactly(connection: socket.socket, count: int, end: float | None) -> bytes:
    parts: list[bytes] = []
    missing = count
    while missing:
        if end is not None:
            left = end - time.monotonic()
            if left <= 0:
                raise TimeoutError
            connection.settimeout(left)
        part = connection.recv(min(missing, 1 << 20))
        if not part:
            raise ConnectionError("the connection was closed within a message")
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
