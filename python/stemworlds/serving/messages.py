"""Messages of asyncroscopy's servers and clients: what they look like on the wire.

A message is its length, four bytes, the greatest first, and so many bytes. A request is text: ``AS_get_scanned_image size=256
dwell_time=2e-6``, a verb with or without the name of a server before it, and words ``key=value``. An answer is ``[dtype,shape]`` and
the bytes of an array, or ``[str,length]`` and text. (Its servers: https://github.com/pycroscopy/asyncroscopy.)
"""

from __future__ import annotations

import socket
import struct
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


def receive(connection: socket.socket, longest: int) -> bytes | None:
    """The next message; ``None`` where the other side has closed the connection.

    Raises:
        ValueError: for a message that is longer than ``longest``.
        ConnectionError: where it ends early.
    """
    head = _exactly(connection, 4)
    if head is None:
        return None
    (length,) = struct.unpack("!I", head)
    if length > longest:
        raise ValueError(f"a message of {length} bytes: at most {longest} are read")
    body = _exactly(connection, length)
    if body is None:
        raise ConnectionError("the connection was closed within a message")
    return body


def _exactly(connection: socket.socket, count: int) -> bytes | None:
    parts: list[bytes] = []
    missing = count
    while missing:
        part = connection.recv(min(missing, 1 << 20))
        if not part:
            if parts:
                raise ConnectionError("the connection was closed within a message")
            return None
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
