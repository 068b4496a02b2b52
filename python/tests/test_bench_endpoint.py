"""Analyst and planner that ask a language model, against a server on this machine that really answers."""

from __future__ import annotations

import base64
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest
from bench_world import PIXEL_NM, Lattice, acquired, facts

import stemworlds as sw
from stemworlds import bench

pytest.importorskip("sklearn")

#: What a server says: a status with the content of a reply, or seconds to wait before it.
Said = tuple[int, str] | float


class Service:
    """A service of chat completions with given answers; the last goes on for ever."""

    def __init__(self, answers: list[Said]) -> None:
        self.answers, self.asked, self.headers = answers, [], []
        service = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                service.asked.append((self.path, json.loads(body)))
                service.headers.append(dict(self.headers))
                answer = service.answers.pop(0) if len(service.answers) > 1 else service.answers[0]
                if isinstance(answer, float):
                    time.sleep(answer)
                    answer = (200, "{}")
                status, content = answer
                told = json.dumps({"choices": [{"message": {"content": content}}]}) if status == 200 else content
                try:
                    self.send_response(status)
                    self.end_headers()
                    self.wfile.write(told.encode())
                except OSError:
                    pass

            def log_message(self, *_: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    asked: list[tuple[str, dict[str, Any]]]
    headers: list[dict[str, str]]

    def endpoint(self, **options: Any) -> bench.Endpoint:
        return bench.Endpoint(**{"url": self.url, "model": "m", "pause_s": 0.001, "timeout_s": 5.0, **options})


@pytest.fixture
def serve() -> Iterator[Any]:
    made: list[Service] = []

    def start(*answers: Said) -> Service:
        made.append(Service(list(answers)))
        return made[-1]

    yield start
    for service in made:
        service.server.shutdown()
        service.server.server_close()


def tile() -> bench.Acquired:
    y, x = np.mgrid[:128, :128]
    spots = [np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 18) for cx in range(16, 128, 24) for cy in range(16, 128, 24)]
    return acquired(0.02 + np.sum(spots, axis=0), 1, 2)


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


def test_failures_that_pass_are_tried_again(serve: Any) -> None:
    service = serve((503, "busy"), (429, "slower"), (200, "no JSON here"), (200, DEFECTS))
    found, notes = analysed(service)
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


def test_slow_answers_are_given_up(serve: Any) -> None:
    service = serve((200, DEFECTS), 0.6)
    analyst = bench.VisionLanguageAnalyst(service.endpoint(timeout_s=0.1, retries=1))
    analyst.start(facts(), np.random.default_rng(0))
    began = time.monotonic()
    analyst.findings([tile(), tile()])
    assert analyst.notes()["model_unparsable"] == 1 and time.monotonic() - began < 1.0


def test_services_that_cannot_be_used_are_told(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    service = serve((401, "no key"))
    with pytest.raises(bench.EndpointError, match="401.*no key.*OPENAI_API_KEY right"):
        analysed(service)
    assert len(service.asked) == 1
    with pytest.raises(bench.EndpointError, match="is the address right"):
        analysed(serve((500, "broken")), retries=1)
    gone = serve((200, ""))
    gone.server.shutdown()
    gone.server.server_close()
    with pytest.raises(bench.EndpointError, match="no answer in 2 tries"):
        analysed(gone, retries=1)
    for options, words in (({"url": "api.example.com"}, "expected an http"), ({"model": ""}, "model is empty"), ({"retries": -1}, "out of its limits")):
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
