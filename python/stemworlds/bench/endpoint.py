"""Asks a language model behind an OpenAI-compatible address, with the standard library alone."""

from __future__ import annotations

import http.client
import json
import math
import os
import time
import urllib.error
import urllib.parse
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from .._text import printable
from ..errors import StemworldsError, _invalid
from .posting import LONGEST_REPLY, post

__all__ = ["Endpoint", "EndpointError", "Unparsable"]

_Read = TypeVar("_Read")

#: HTTP statuses after which another try may succeed.
_PASSING = {408, 409, 425, 429, 500, 502, 503, 504, 529}
#: Errors that reading a reply may raise: wrong types, numbers out of range, unlimited nesting.
_UNREADABLE = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError)
#: Most braces of a reply that are tried as the beginning of an object. The limit keeps the reading time proportional to the length.
_MOST_BRACES = 100
#: Most characters of a service's text that a message quotes.
_LONGEST_WORDS = 300


class EndpointError(StemworldsError):
    """Raised if the service cannot be used: address, key or model are wrong, or it has never answered."""


class Unparsable(StemworldsError):
    """Raised if no reply could be read after all tries."""


@dataclass
class Endpoint:
    """An OpenAI-compatible service of chat completions.

    Redirects are not followed, so the key is sent to no other address. Replies longer than 1 MB are refused.

    Args:
        url: the part before ``/chat/completions``: ``"https://openrouter.ai/api/v1"``.
        model: name of the model at the service.
        key_variable: the environment variable with the key; if it is not set, no key is sent.
        temperature, max_tokens: sampling temperature and longest reply of each request.
        retries: further tries after a failure or a reply that cannot be read.
        timeout_s: seconds for one request, from the connection to the last byte of the reply.
        pause_s: seconds before the first retry; the pause doubles with each retry.

    Attributes:
        calls, retried, failed: numbers of requests, of retries, and of requests that failed in all tries.
    """

    url: str
    model: str
    key_variable: str = "OPENAI_API_KEY"
    temperature: float = 0.0
    max_tokens: int = 1024
    retries: int = 3
    timeout_s: float = 60.0
    pause_s: float = 1.0
    calls: int = field(default=0, init=False)
    retried: int = field(default=0, init=False)
    failed: int = field(default=0, init=False)
    _answered: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        parts = urllib.parse.urlsplit(self.url)
        if parts.scheme not in ("http", "https") or not parts.netloc:
            raise _invalid("url", f"url = {self.url!r}: expected an http or https address such as https://openrouter.ai/api/v1")
        if not self.model:
            raise _invalid("model", "model is empty: give the name that the service knows it by")
        in_time = math.isfinite(self.timeout_s) and self.timeout_s > 0 and math.isfinite(self.pause_s) and self.pause_s >= 0
        if self.retries < 0 or not in_time or self.max_tokens < 1:
            raise _invalid("retries, timeout_s, pause_s or max_tokens", "a number of the endpoint is out of its limits")

    def ask(self, instructions: str, question: str, *, png: bytes | None = None, read: Callable[[str], _Read]) -> _Read:
        """Sends a question, and reads the reply with ``read``, which raises :class:`ValueError` for a reply that it cannot read.

        Raises:
            Unparsable: if no reply could be read after all tries.
            EndpointError: if the service refuses the request (wrong key, unknown model), or has never answered at all.
        """
        body = json.dumps(self._body(instructions, question, png)).encode()
        self.calls += 1
        last: Exception | None = None
        for attempt in range(self.retries + 1):
            if attempt:
                self.retried += 1
                time.sleep(self.pause_s * 2 ** (attempt - 1))
            try:
                return read(self._reply(body))
            except urllib.error.HTTPError as error:
                with error:
                    if error.code not in _PASSING:
                        raise EndpointError(_refused(self.url, self.key_variable, error)) from error
                last = error
            except (OSError, http.client.HTTPException, *_UNREADABLE) as error:
                last = error
        self.failed += 1
        why = printable(str(last) or type(last).__name__, _LONGEST_WORDS)
        if not self._answered:
            raise EndpointError(f"{self.url}: no answer in {self.retries + 1} tries ({why}); is the address right?") from last
        raise Unparsable(f"{self.url}: no reply that can be read in {self.retries + 1} tries ({why})") from last

    def _body(self, instructions: str, question: str, png: bytes | None) -> dict[str, Any]:
        content: Any = question
        if png is not None:
            import base64

            image = {"url": "data:image/png;base64," + base64.b64encode(png).decode(), "detail": "high"}
            content = [{"type": "text", "text": question}, {"type": "image_url", "image_url": image}]
        return {
            "model": self.model,
            "temperature": self.temperature,
            "max_tokens": self.max_tokens,
            "messages": [{"role": "system", "content": instructions}, {"role": "user", "content": content}],
        }

    def _reply(self, body: bytes) -> str:
        headers = {"Content-Type": "application/json", "User-Agent": "stemworlds"}
        key = os.environ.get(self.key_variable, "").strip()
        if key:
            headers["Authorization"] = f"Bearer {key}"
        _, told = post(self.url.rstrip("/") + "/chat/completions", body, headers, self.timeout_s)
        self._answered = True
        if len(told) > LONGEST_REPLY:
            raise ValueError(f"the reply is longer than {LONGEST_REPLY} bytes")
        content = json.loads(told)["choices"][0]["message"]["content"]
        if not isinstance(content, str) or not content.strip():
            raise ValueError("the reply is empty")
        return content


def json_of(reply: str) -> dict[str, Any]:
    """Returns the last complete JSON object in a reply, inside or outside of a Markdown code fence.

    Raises:
        ValueError: if the reply contains no object.
    """
    # The parts with odd indices lie between two fences.
    fenced = [part.removeprefix("json") for part in reply.split("```")[1:-1:2]]
    decoder = json.JSONDecoder()
    tries = _MOST_BRACES
    for text in [*reversed(fenced), reply]:
        found: dict[str, Any] | None = None
        at = text.find("{")
        while at >= 0 and tries > 0:
            try:
                value, end = decoder.raw_decode(text, at)
            except (ValueError, RecursionError):
                tries -= 1
                at = text.find("{", at + 1)
                continue
            found = value if isinstance(value, dict) else found
            at = text.find("{", end)
        if found is not None:
            return found
    raise ValueError("the reply holds no JSON object")


def _refused(url: str, key_variable: str, error: urllib.error.HTTPError) -> str:
    if 300 <= error.code < 400:
        place = printable(error.headers.get("Location", "another address"), _LONGEST_WORDS)
        return f"{url}: the service sends on to {place} ({error.code}), where the key is not sent; give the address of the service itself"
    try:
        said = printable(error.read(_LONGEST_WORDS).decode(errors="replace").strip())
    except (OSError, http.client.HTTPException):
        said = "no words"
    advice = f"; is the key in {key_variable} right?" if error.code in (401, 403) else "; are address and model right?"
    return f"{url}: the service refuses the request, {error.code} {printable(str(error.reason), _LONGEST_WORDS)}: {said}{advice}"
