"""Reads and writes the messages of asyncroscopy's servers and clients.

A message begins with its length in four bytes, the most significant first. A request is text, for example ``AS_get_scanned_image size=256
dwell_time=2e-6``: a verb, with or without the prefix of a server, and words ``key=value``. An answer is ``[dtype,shape]`` and the bytes of
an array, or ``[str,length]`` and text. The original servers: https://github.com/pycroscopy/asyncroscopy.
"""

from __future__ import annotations

import socket
import struct
import time
from typing import Any

import numpy as np
import numpy.typing as npt

#: Longest request in bytes.
LONGEST_REQUEST = 1 << 16
#: Longest answer in bytes.
LONGEST_ANSWER = 1 << 30
#: Names of servers that may precede a verb.
SERVERS = ("AS", "Gatan", "Ceos", "Central")

Answer = str | npt.NDArray[Any]


def packed(answer: Answer) -> bytes:
    """Converts an answer to bytes."""
    if isinstance(answer, str):
        text = answer.encode()
        return f"[str,{len(text)}]".encode() + text
    shape = ",".join(str(n) for n in answer.shape)
    return f"[{answer.dtype.name},{shape}]".encode() + np.ascontiguousarray(answer).tobytes()


def unpacked(message: bytes) -> Answer:
    """Reads an answer from bytes.

    Raises:
        ValueError: for bytes that are no answer.
    """
    head, closed, body = message.partition(b"]")
    if not closed or not head.startswith(b"["):
        raise ValueError(f"the answer begins with {message[:20]!r}, not with [dtype,shape]")
    dtype, *shape = head[1:].decode("ascii").split(",")
    if dtype == "str":
        return body.decode()
    return np.frombuffer(body, dtype=dtype).reshape([int(n) for n in shape])


def parsed(request: str) -> tuple[str, dict[str, str]]:
    """Splits a request. Returns its verb, without the name of a server, and its arguments.

    Raises:
        ValueError: for an empty request, and for words without the form ``key=value``.
    """
    # Tuples may contain spaces, so a word without = belongs to the word before it.
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
    """Sends the length of a message, and the message."""
    connection.sendall(struct.pack("!I", len(message)) + message)


def receive(connection: socket.socket, longest: int, *, idle_s: float | None = None, message_s: float | None = None) -> bytes | None:
    """Receives the next message. Returns ``None`` if the other side has closed the connection, or has sent nothing for ``idle_s``.

    Args:
        message_s: greatest number of seconds from the first to the last byte of a message.

    Raises:
        ValueError: for a message longer than ``longest``.
        ConnectionError: if the message ends early, or arrives too slowly.
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
