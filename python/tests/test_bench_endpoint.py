"""Analyst and planner that ask a language model, against a server on this machine that really answers."""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest
from bench_world import PIXEL_NM, Lattice, acquired, facts
from conftest import LONGEST_S

import stemworlds as sw
from stemworlds import bench

pytest.importorskip("sklearn")

#: What a server says: a status with the content of a reply, or something that writes the answer itself.
Said = tuple[int, str] | Callable[["Handler"], None]


class Handler(BaseHTTPRequestHandler):
    """A connection of a :class:`Service`."""

    service: Service

    def do_POST(self) -> None:
        service = self.service
        body = self.rfile.read(int(self.headers["Content-Length"]))
        service.asked.append((self.path, json.loads(body)))
        service.headers.append(dict(self.headers))
        answer = service.answers.pop(0) if len(service.answers) > 1 else service.answers[0]
        # The client may have gone.
        with contextlib.suppress(OSError):
            if callable(answer):
                answer(self)
                return
            status, content = answer
            told = json.dumps({"choices": [{"message": {"content": content}}]}) if status == 200 else content
            self.tell(status, told.encode())

    def tell(self, status: int, content: bytes, **headers: str) -> None:
        """An answer."""
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        pass


class Service:
    """A service of chat completions with given answers; the last goes on for ever."""

    def __init__(self, answers: list[Said]) -> None:
        self.answers, self.asked, self.headers = answers, [], []
        #: Set when the test is over: nobody waits for an answer any more.
        self.over = threading.Event()
        self.server = ThreadingHTTPServer(("127.0.0.1", 0), type("Own", (Handler,), {"service": self}))
        self.url = f"http://127.0.0.1:{self.server.server_port}/v1"
        self._thread = threading.Thread(target=self.server.serve_forever, args=(0.05,))
        self._thread.start()

    def close(self) -> None:
        self.over.set()
        self.server.shutdown()
        self.server.server_close()
        self._thread.join()

    asked: list[tuple[str, dict[str, Any]]]
    headers: list[dict[str, str]]

    def endpoint(self, **options: Any) -> bench.Endpoint:
        return bench.Endpoint(**{"url": self.url, "model": "m", "pause_s": 0.0, "timeout_s": LONGEST_S, **options})


@pytest.fixture
def serve() -> Iterator[Any]:
    made: list[Service] = []

    def start(*answers: Said) -> Service:
        made.append(Service(list(answers)))
        return made[-1]

    yield start
    for service in made:
        service.close()


def tile(row: int = 1, column: int = 2) -> bench.Acquired:
    y, x = np.mgrid[:128, :128]
    spots = [np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 18) for cx in range(16, 128, 24) for cy in range(16, 128, 24)]
    return acquired(0.02 + np.sum(spots, axis=0), row, column)


def analysed(service: Service, tiles: int = 1, **options: Any) -> tuple[bench.Findings, dict[str, float]]:
    analyst = bench.VisionLanguageAnalyst(service.endpoint(**options))
    analyst.start(facts(), np.random.default_rng(0))
    return analyst.findings([tile() for _ in range(tiles)]), analyst.notes()


DEFECTS = '{"defects": [{"row": 42, "col": 37, "type": "vacancy"}, {"row": 3, "col": 60, "type": "substitution"}], "phase": 1}'


def test_defects_that_the_model_names_are_put_on_atoms(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MY_KEY", "secret")
    service = serve((200, f"I see this:\n```json\n{DEFECTS}\n```"))
    found, notes = analysed(service, key_variable="MY_KEY")
    assert found.defects is not None
    # The nearest atom is at row 40, column 40; none is near row 3, column 60.
    assert np.asarray(found.defects["vacancy"]) == pytest.approx(np.array([[(2 * 124 + 40), (124 + 40)]]) * PIXEL_NM, abs=0.005)
    assert np.asarray(found.defects["substitution"]) == pytest.approx(np.array([[(2 * 124 + 60), (124 + 3)]]) * PIXEL_NM)
    assert len(found.columns) == 25 and found.columns[:, 2].sum() == 1
    assert notes == {"model_calls": 1, "model_retries": 0, "model_unparsable": 0}
    [(path, asked)] = service.asked
    assert path == "/v1/chat/completions" and service.headers[0]["Authorization"] == "Bearer secret"
    assert (asked["model"], asked["temperature"], asked["max_tokens"]) == ("m", 0.0, 1024)
    image = asked["messages"][1]["content"][1]["image_url"]["url"]
    png = base64.b64decode(image.removeprefix("data:image/png;base64,"))
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and (int.from_bytes(png[16:20]), int.from_bytes(png[20:24])) == (256, 256)


def test_pictures_are_what_the_tile_shows() -> None:
    from io import BytesIO

    from stemworlds.bench.vlm import png_of

    image = pytest.importorskip("PIL.Image")
    shown = np.asarray(image.open(BytesIO(png_of(tile().image))))
    assert np.array_equal(shown[::2, ::2], np.rint(tile().image * 255)) and np.array_equal(shown[::2], shown[1::2])


def test_failures_that_pass_are_tried_again(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr("stemworlds.bench.endpoint.time.sleep", waited.append)
    service = serve((503, "busy"), (429, "slower"), (200, "no JSON here"), (200, DEFECTS))
    found, notes = analysed(service, pause_s=1.0)
    assert waited == [1.0, 2.0, 4.0]
    assert found.defects is not None and len(np.asarray(found.defects["vacancy"])) == 1
    assert notes == {"model_calls": 1, "model_retries": 3, "model_unparsable": 0} and len(service.asked) == 4


@pytest.mark.parametrize(
    "reply",
    [
        "",
        "There are some defects.",
        '{"defects": "many"}',
        '{"defects": [{"row": 300, "col": 1, "type": "vacancy"}]}',
        '{"defects": [{"row": 3, "col": 1, "type": "hole"}]}',
        '{"defects": [{"row": 3, "type": "vacancy"}]}',
        '{"defects": [{"row": 3, "col',
    ],
)
def test_replies_without_sense_are_no_finding_and_counted(serve: Any, reply: str) -> None:
    service = serve((200, reply))
    found, notes = analysed(service, tiles=2)
    assert not found.defects and found.phases is None
    assert notes == {"model_calls": 2, "model_retries": 6, "model_unparsable": 2} and len(service.asked) == 8


def silent(handler: Handler) -> None:
    """Says nothing until the test is over."""
    handler.service.over.wait()


def dripping(handler: Handler) -> None:
    """Begins an answer that is never whole: a byte now and then."""
    handler.send_response(200)
    handler.end_headers()
    while not handler.service.over.wait(0.01):
        handler.wfile.write(b" ")


def dripping_head(handler: Handler) -> None:
    """Begins a head that never ends."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX-Long: ")
    while not handler.service.over.wait(0.01):
        handler.wfile.write(b"x")


@pytest.mark.parametrize("answer", [silent, dripping, dripping_head])
def test_answers_that_never_end_are_given_up(serve: Any, answer: Said) -> None:
    service = serve((200, DEFECTS), answer)
    analyst = bench.VisionLanguageAnalyst(service.endpoint(retries=1))
    analyst.start(facts(), np.random.default_rng(0))
    first = tile()
    analyst.findings([first])
    # These answers take longer than any limit, so it does not matter how short it is.
    analyst.endpoint.timeout_s = 0.2
    analyst.findings([first, tile()])
    assert analyst.notes() == {"model_calls": 2, "model_retries": 1, "model_unparsable": 1}


def long_reply(handler: Handler) -> None:
    """More than is read; the client closes the connection within it."""
    handler.tell(200, b'{"choices": [{"message": {"content": "' + b"x" * 8_000_000)


def raw(content: bytes) -> Said:
    """A reply of these bytes."""
    return lambda handler: handler.tell(200, content)


def saying(content: str) -> Said:
    """A reply in the right form with this content."""
    return raw(json.dumps({"choices": [{"message": {"content": content}}]}).encode())


HOSTILE: dict[str, Said] = {
    "long": long_reply,
    "deep": raw(b"[" * 400_000),
    "deep objects": raw(b'{"a":' * 200_000),
    "no text": raw(b"\xff\xfe\x00"),
    "HTML": raw(b"<html>Please log in</html>"),
    "a list": raw(b"[]"),
    "a number": raw(b"7"),
    "null": raw(b'{"choices": null}'),
    "nothing chosen": raw(b'{"choices": []}'),
    "an endless number": raw(b"1" * 900_000),
    "content of another kind": raw(b'{"choices": [{"message": {"content": {"defects": []}}}]}'),
    "deep content": saying('{"defects": ' + "[" * 300_000),
    "braces": saying("{" * 400_000),
    "nested braces": saying('{"a":' * 150_000),
    "half a fence": saying("```" + " " * 500_000),
    "fences": saying("```json\n{" * 80_000),
    "huge place": saying('{"defects": [{"row": 1' + "0" * 400 + ', "col": 1, "type": "vacancy"}]}'),
    "no place": saying('{"defects": [{"row": NaN, "col": 1, "type": "vacancy"}]}'),
    "a place of another kind": saying('{"defects": [{"row": {}, "col": [], "type": "vacancy"}]}'),
    "a kind of another kind": saying('{"defects": [{"row": 1, "col": 1, "type": ["vacancy"]}]}'),
    "many defects": saying(json.dumps({"defects": [{"row": 1, "col": 1, "type": "vacancy"}] * 15_000})),
    "controls": saying("\x1b]0;title\x07\ud800 {]"),
}


@pytest.mark.parametrize("answer", HOSTILE.values(), ids=HOSTILE)
def test_whatever_a_reply_holds_the_episode_goes_on(serve: Any, answer: Said) -> None:
    service = serve(answer)
    # It is the first thing that the service says.
    found, notes = analysed(service, tiles=2, retries=0)
    assert not found.defects and notes == {"model_calls": 2, "model_retries": 0, "model_unparsable": 2}
    planner = bench.LanguageModelPlanner(service.endpoint(retries=0))
    planner.start(facts(), np.random.default_rng(0))
    assert planner.plan(bench.Seen(facts())).mode == "SURVEY" and planner.notes() == {"planner_calls": 1, "planner_fallbacks": 1}


def test_a_phase_beyond_all_numbers_is_none(serve: Any) -> None:
    service = serve((200, '{"defects": [], "phase": 1}'), (200, '{"defects": [], "phase": 1' + "0" * 30 + "}"), (200, '{"defects": [], "phase": 2}'))
    analyst = bench.VisionLanguageAnalyst(service.endpoint())
    analyst.start(facts(), np.random.default_rng(0))
    phases = analyst.findings([tile(0, 0), tile(0, 1), tile(0, 2)]).phases
    assert analyst.notes()["model_unparsable"] == 0 and phases is not None and phases[0, :3].tolist() == [1, bench.NO_PHASE, 2]


def test_the_last_whole_object_is_read_in_time_with_its_length(monkeypatch: pytest.MonkeyPatch) -> None:
    from stemworlds.bench.endpoint import json_of

    assert json_of('see {this}: {"a": 1} and {"b": {"c": 2}} or {"d"') == {"b": {"c": 2}}
    assert json_of('{"a": 1}\n```json\n{"b": "}{"}\n```\n{"c": 3}') == {"b": "}{"}
    tried: list[int] = []
    whole = json.JSONDecoder.raw_decode

    def count(self: json.JSONDecoder, text: str, at: int = 0) -> Any:
        tried.append(at)
        return whole(self, text, at)

    monkeypatch.setattr(json.JSONDecoder, "raw_decode", count)
    for text in ("{" * 300_000, '{"a":[' * 100_000, "``` {" * 100_000):
        tried.clear()
        with pytest.raises(ValueError, match="no JSON object"):
            json_of(text)
        assert len(tried) == 100


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_redirect_is_not_followed(serve: Any, monkeypatch: pytest.MonkeyPatch, status: int) -> None:
    monkeypatch.setenv("MY_KEY", "secret")
    other = serve((200, DEFECTS))
    service = serve(lambda handler: handler.tell(status, b"", Location=f"{other.url}/chat/completions"))
    with pytest.raises(bench.EndpointError, match=f"sends on to {other.url}/chat/completions .{status}., where the key is not sent"):
        analysed(service, key_variable="MY_KEY")
    assert len(service.asked) == 1 and other.asked == []


def test_words_of_a_service_are_no_commands_of_a_terminal(serve: Any) -> None:
    for answer in ((400, "no\x1b[2J\x07\nfault: forged"), lambda handler: handler.tell(302, b"", Location="http://x/\x1b[2J")):
        with pytest.raises(bench.EndpointError) as told:
            analysed(serve(answer))
        assert str(told.value).isprintable() and "\\x1b[2J" in str(told.value)


def test_services_that_cannot_be_used_are_told(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    service = serve((401, "no key"))
    with pytest.raises(bench.EndpointError, match="401.*no key.*OPENAI_API_KEY right"):
        analysed(service)
    assert len(service.asked) == 1
    with pytest.raises(bench.EndpointError, match="is the address right"):
        analysed(serve((500, "broken")), retries=1)
    # A port that is taken, and where nobody listens.
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{taken.getsockname()[1]}/v1"
        with pytest.raises(bench.EndpointError, match="no answer in 2 tries"):
            analysed(service, retries=1, url=nobody)
    for options, words in (({"url": "api.example.com"}, "expected an http"), ({"model": ""}, "model is empty"), ({"retries": -1}, "out of its limits"), ({"timeout_s": float("nan")}, "limits")):
        with pytest.raises(sw.InvalidValue, match=words):
            bench.Endpoint(**{"url": "http://localhost/v1", "model": "m", **options})


def planned(service: Service, **options: Any) -> tuple[dict[str, Any], Lattice]:
    planner = bench.LanguageModelPlanner(service.endpoint(**options), every=2)
    env = Lattice()
    return bench.play(env, bench.Agent("llm", bench.GaussianProcess(), bench.Heuristic(), planner), 0), env


def test_a_language_model_plans(serve: Any) -> None:
    service = serve((200, '{"mode": "CHARACTERIZE"}'), (200, "```json\n{\"mode\": \"SURVEY\"}\n```"), (200, '{"mode": "TERMINATE"}'))
    record, env = planned(service)
    assert record["modes"] == ["CHARACTERIZE"] * 2 + ["SURVEY"] * 2 and env.ended == "done"
    assert record["notes"] == {"planner_calls": 3, "planner_fallbacks": 0}
    state = json.loads(service.asked[1][1]["messages"][1]["content"])
    assert state["tiles_seen"] == 2 and state["budget_left"] == 0.8 and state["mode"] == "CHARACTERIZE" and state["task"] == "defect-census"


def test_rules_stand_in_for_a_model_that_says_nothing_of_use(serve: Any) -> None:
    record, _ = planned(serve((200, '{"mode": "PARTY"}')), retries=0)
    rules = bench.play(Lattice(), bench.Agent("llm", bench.GaussianProcess(), bench.Heuristic(), bench.ModePlanner()), 0)
    assert record["modes"] == rules["modes"] and record["notes"]["planner_fallbacks"] == record["notes"]["planner_calls"] >= 5
    assert record["curve"] == rules["curve"]


def test_agents_with_a_service_are_made_from_tables(serve: Any) -> None:
    service = serve((200, '{"defects": []}'))
    agent = bench.make_agent(
        {"name": "Raster+VLM", "navigator": "raster", "analyst": {"kind": "vlm", "url": service.url, "model": "m", "pause_s": 0.0}}
    )
    record = bench.play(Lattice(budget=300.0), agent, 0)
    assert len(service.asked) == 3 and record["notes"]["model_calls"] == 3
    assert bench.play(Lattice(budget=300.0), agent, 0)["notes"]["model_calls"] == 3
