"""A microscope on a socket: what clients send and get, byte for byte, and what the beam does."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DYING, LONGEST_S, until

import stemworlds as sw
from stemworlds.serving import Client, Microscope, Server

#: Electrons in a pA s.
ELECTRONS_PER_PA_S = 1e-12 / 1.602176634e-19


@pytest.fixture
def world(library: str) -> sw.LiveWorld:
    return fresh(library)


def fresh(library: str) -> sw.LiveWorld:
    return sw.LiveWorld("test", grid=(1, 1), set=DYING, seed=3, most_dose=5e5, cache=library)


@pytest.fixture
def port(world: sw.LiveWorld) -> Iterator[int]:
    with Server(Microscope(world, fov_angstrom=10.0), ("127.0.0.1", 0)) as server:
        server.start()
        yield server.port


@pytest.fixture
def client(port: int) -> Iterator[Client]:
    with Client(("127.0.0.1", port)) as connected:
        yield connected


def raw(port: int, request: bytes) -> bytes:
    """What the bytes of a client without our code come to."""
    with socket.create_connection(("127.0.0.1", port), timeout=LONGEST_S) as connection, connection.makefile("rb") as answers:
        connection.sendall(struct.pack("!I", len(request)) + request)
        (length,) = struct.unpack("!I", answers.read(4))
        return answers.read(length)


def test_the_bytes_are_those_that_clients_of_asyncroscopy_read(port: int) -> None:
    assert raw(port, b"AS_get_status") == b"[str,19]Microscope is Ready"
    head, _, body = raw(port, b"AS_get_stage").partition(b"]")
    assert head == b"[float32,5" and body == bytes(20)
    head, _, body = raw(port, b"AS_get_scanned_image scanning_detector=HAADF size=16 dwell_time=1e-05").partition(b"]")
    assert head == b"[float32,16,16" and len(body) == 4 * 16 * 16
    assert np.frombuffer(body, "<f4").max() > 0
    # The words of a tuple may be apart.
    assert raw(port, b"place_beam beam_pos=(0.25, 0.75)").endswith(b"Beam moved to 0.25, 0.75")


def test_the_dose_is_current_times_dwell_time_per_pixel(client: Client, world: sw.LiveWorld, library: str) -> None:
    client("set_current", current=200.0)
    image = client.array("get_scanned_image", detector="HAADF", size=32, dwell_time=20e-6)
    assert image.shape == (32, 32)
    expected = 200.0 * 20e-6 * ELECTRONS_PER_PA_S / (10.0 / 32) ** 2
    assert client.array("get_dose")[0] == pytest.approx(expected, rel=0.1)
    [told] = world.history
    assert told["dose"] == pytest.approx(expected, rel=1e-6)
    # The same by hand, in another world of the same seed.
    middle = world.recipe["field.tile_px"] * world.recipe.pixel_nm / 2
    edges = (middle - 0.5, middle - 0.5, middle + 0.5, middle + 0.5)
    same = fresh(library).acquire(region_nm=edges, pixel_nm=1 / 32, current_pa=200.0, dwell_us=20.0, profile="ideal")
    assert np.array_equal(image, same.array)
    assert image.sum() == pytest.approx(same.ideal.array.mean() * expected * 10.0**2, rel=0.03)


def test_the_specimen_changes_under_the_beam(client: Client, world: sw.LiveWorld) -> None:
    client("set_current", current=1000.0)
    client("set_fov", fov=30.0)
    for _ in range(2):
        client("get_scanned_image", size=48, dwell_time=1.25e-5)
    lost = [told["lost"].get("O", 0) for told in world.history]
    assert len(lost) == 2 and sum(lost) > 0
    middle = world.recipe["field.tile_px"] * world.recipe.pixel_nm / 2
    around = (middle - 0.25, middle - 0.25, middle + 0.25, middle + 0.25)
    before = world.dose(around)
    client("place_beam", x=0.5, y=0.5)
    client("unblank_beam", duration=1e-5)
    client("blank_beam")
    # All its electrons are in the middle.
    assert (world.dose(around) - before) * 5.0**2 == pytest.approx(1000.0 * 1e-5 * ELECTRONS_PER_PA_S, rel=0.05)


def test_the_stage_moves_the_field_of_view(client: Client, world: sw.LiveWorld) -> None:
    client("set_fov", fov=8.0)
    assert client.array("get_fov")[0] == 8.0
    client("set_stage", x=2e-10, y=-1e-10)
    client("set_stage", x=1e-10, relative=True)
    assert np.allclose(client.array("get_stage"), [3e-10, -1e-10, 0, 0, 0])
    client("get_scanned_image", size=16, dwell_time=1e-6)
    middle = world.recipe["field.tile_px"] * world.recipe.pixel_nm / 2
    around = (middle + 0.3 - 0.3, middle - 0.1 - 0.3, middle + 0.3 + 0.3, middle - 0.1 + 0.3)
    assert world.dose(around) > 0
    assert world.dose((0.0, 0.0, middle - 0.3, middle - 0.6)) == 0


@pytest.mark.parametrize(
    ("verb", "arguments", "says"),
    [
        ("get_scaned_image", {}, "discover_commands"),
        ("get_scanned_image", {"size": 5}, "8 to 4096"),
        ("get_scanned_image", {"size": 64, "dwel_time": 1e-6}, "takes no 'dwel_time'"),
        ("get_scanned_image", {"size": "many"}, "expected a number"),
        ("get_scanned_image", {"size": 8.9}, "size=8.9: expected a whole number from 8 to 4096"),
        ("get_scanned_image", {"size": 64, "dwell_time": 1.0}, "600 s"),
        ("get_scanned_image", {"size": 64, "dwell_time": 0.2}, "1e-08 to 0.146 s for 64 x 64 pixels"),
        ("get_scanned_image", {"size": 8, "dwell_time": 1.5}, "1e-08 to 1 s for 8 x 8 pixels"),
        ("get_scanned_image", {"size": 8, "dwell_time": 9e-9}, "1e-08 to 1 s"),
        ("get_scanned_image", {"size": 64, "dwell_time": "nan"}, "finite"),
        ("get_scanned_image", {"detector": "BF"}, "HAADF"),
        ("set_current", {"current": -3}, "0.001"),
        ("set_current", {}, "missing"),
        ("set_stage", {"x": 1.0}, "leaves the specimen"),
        ("set_stage", {"a": 0.1}, "flat"),
        ("set_stage", {"x": 1e-10, "relative": "yes"}, "relative='yes': expected true or false"),
        ("set_fov", {"fov": 0.5}, "expected 1 Angstrom or more"),
        ("set_fov", {"fov": 5000}, "leaves the specimen"),
        ("place_beam", {"x": 2, "y": 0}, "from 0 to 1"),
        *(("place_beam", {"beam_pos": odd}, "expected (x,y)") for odd in ("(1", "1,1", "(1,1,1)", "{0.1,0.2}", "((0.1,0.2))", "f(1,1)", "(" * 60_000)),
        ("place_beam", {"beam_pos": "(0.1,x)"}, "expected a number"),
        ("place_beam", {"beam_pos": "(0.1,nan)"}, "finite"),
        ("unblank_beam", {"duration": 601}, "1e-08 to 600 s"),
        ("unblank_beam", {}, "duration"),
        ("set_current", {"current": 1e6}, None),
    ],
)
def test_what_makes_no_sense_is_refused_and_changes_nothing(client: Client, verb: str, arguments: dict[str, object], says: str | None) -> None:
    if says is None:
        # A dose that the specimen is not made for.
        client(verb, **arguments)
        with pytest.raises(RuntimeError, match="dose"):
            client("get_scanned_image", size=64, dwell_time=0.1)
    else:
        with pytest.raises(RuntimeError, match=re.escape(says)):
            client(verb, **arguments)
    assert client("get_status") == "Microscope is Ready" and client.array("get_dose")[0] == 0


def test_pixels_have_a_least_size(client: Client) -> None:
    before = float(np.asarray(client("get_fov")).item())
    client("set_fov", fov=2)
    with pytest.raises(RuntimeError, match=re.escape("size=4096: pixels of 0.000488 A in a field of view of 2 A; expected 0.001 to 100 A")):
        client("get_scanned_image", size=4096, dwell_time=1e-8)
    client("set_fov", fov=before)


def test_the_limits_in_messages_are_those_of_recordings(client: Client, world: sw.LiveWorld) -> None:
    client("set_current", current=0.001)
    for dwell_s in (1e-8, 1.0):
        assert client.array("get_scanned_image", size=8, dwell_time=dwell_s).shape == (8, 8)
    with pytest.raises(RuntimeError, match="expected a whole number"):
        client("get_scanned_image", size=7)
    # A minute is recorded in parts of a second.
    for duration in (1e-8, 60.0):
        client("unblank_beam", duration=duration)
    times = [told["electrons"] / (1e-3 * ELECTRONS_PER_PA_S) for told in world.history[2:]]
    assert times == pytest.approx([1e-8, 60.0], rel=1e-3)


def test_a_busy_microscope_says_so_at_once(world: sw.LiveWorld) -> None:
    microscope = Microscope(world, fov_angstrom=10.0)
    with Server(microscope, ("127.0.0.1", 0)) as server:
        server.start()
        # As long as another client records.
        with microscope._busy:
            assert raw(server.port, b"get_status") == b"[str,18]Microscope is Busy"
        assert raw(server.port, b"get_status") == b"[str,19]Microscope is Ready"


def answer_of(connection: socket.socket) -> bytes:
    """The next answer of a server; nothing where it has closed the connection."""
    with connection.makefile("rb") as answers:
        head = answers.read(4)
        return answers.read(struct.unpack("!I", head)[0]) if head else b""


def test_too_many_clients_are_told(world: sw.LiveWorld) -> None:
    with Server(Microscope(world, fov_angstrom=10.0), ("127.0.0.1", 0), most_clients=2) as server:
        server.start()
        with Client(("127.0.0.1", server.port)) as one, Client(("127.0.0.1", server.port)) as two:
            assert one("get_status") == two("get_status") == "Microscope is Ready"
            with socket.create_connection(("127.0.0.1", server.port), timeout=LONGEST_S) as third:
                assert b"ERROR: 2 clients are connected" in answer_of(third)

        def served() -> bool:
            with contextlib.suppress(OSError, struct.error):
                return raw(server.port, b"get_status").endswith(b"Ready")
            return False

        # They have gone, which the server notices in its own time.
        until(served)


def test_idle_and_half_sent_messages_end_their_connection(world: sw.LiveWorld) -> None:
    with Server(Microscope(world, fov_angstrom=10.0), ("127.0.0.1", 0), idle_s=0.1, message_s=LONGEST_S) as server:
        server.start()
        with socket.create_connection(("127.0.0.1", server.port), timeout=LONGEST_S) as idle:
            assert answer_of(idle) == b""
    with Server(Microscope(world, fov_angstrom=10.0), ("127.0.0.1", 0), message_s=0.1) as server:
        server.start()
        for half in (b"\0\0", struct.pack("!I", 100) + b"half"):
            with socket.create_connection(("127.0.0.1", server.port), timeout=LONGEST_S) as slow:
                slow.sendall(half)
                assert b"ERROR: the message was not whole after 0.1 s" in answer_of(slow)


def test_a_server_closes_whatever_it_does(world: sw.LiveWorld) -> None:
    microscope = Microscope(world, fov_angstrom=10.0)
    Server(microscope, ("127.0.0.1", 0)).close()
    server = Server(microscope, ("127.0.0.1", 0)).start()
    with Client(("127.0.0.1", server.port)) as client:
        assert client("get_status") == "Microscope is Ready"
        server.close()
        with pytest.raises(ConnectionError):
            client("get_status")
    server.close()


def test_the_port_is_taken_before_the_specimen_is_made(world: sw.LiveWorld) -> None:
    made: list[int] = []

    def microscope() -> Microscope:
        made.append(1)
        return Microscope(world, fov_angstrom=10.0)

    with Server(microscope, ("127.0.0.1", 0)) as server:
        assert made == [1]
        with pytest.raises(OSError, match="in use"):
            Server(microscope, ("127.0.0.1", server.port))
        assert made == [1]


@pytest.mark.parametrize(("option", "value"), [("fov_angstrom", 0.0), ("fov_angstrom", float("nan")), ("current_pa", -5.0), ("current_pa", float("nan"))])
def test_a_microscope_has_sound_numbers(world: sw.LiveWorld, option: str, value: float) -> None:
    options: dict[str, Any] = {"fov_angstrom": 10.0, option: value}
    with pytest.raises(ValueError, match=f"{option.partition('_')[0]}={value}: expected"):
        Microscope(world, **options)


def test_damaged_requests_end_the_connection_and_not_the_server(port: int) -> None:
    assert raw(port, b"") == b"[str,27]ERROR: the request is empty"
    assert raw(port, b"set_current \xff\xfe").startswith(b"[str,")
    with socket.create_connection(("127.0.0.1", port), timeout=LONGEST_S) as connection:
        connection.sendall(b"GET / HTTP/1.1\r\n\r\n")
        assert b"ERROR" in answer_of(connection)
    with socket.create_connection(("127.0.0.1", port), timeout=LONGEST_S) as connection:
        connection.sendall(struct.pack("!I", 100) + b"half")
    assert raw(port, b"get_status") == b"[str,19]Microscope is Ready"


def test_several_clients_share_one_specimen(port: int, world: sw.LiveWorld) -> None:
    def record() -> None:
        with Client(("127.0.0.1", port)) as mine:
            for _ in range(3):
                mine("get_scanned_image", size=16, dwell_time=1e-6)

    threads = [threading.Thread(target=record) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(world.history) == 12


def test_every_verb_has_help(client: Client) -> None:
    verbs = json.loads(str(client("discover_commands")))
    assert {"connect", "get_status", "set_current", "get_scanned_image", "get_stage", "set_stage", "place_beam", "blank_beam"} <= set(verbs)
    for verb in verbs:
        assert json.loads(str(client("get_help", command_name=verb)))["summary"].endswith(".")


def test_the_command_serves_until_it_is_interrupted(library: str) -> None:
    changes = [word for key, value in DYING.items() for word in ("--set", f"{key}={value}")]
    words = [sys.executable, "-m", "stemworlds", "serve", "test", "--grid", "1x1", "--port", "0", "--fov", "10", *changes]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "STEMGEN_CACHE": library}) as run:
        assert run.stdout is not None and run.stderr is not None
        told = run.stdout.readline()
        assert told.startswith("listening on 127.0.0.1:"), run.stderr.read()
        with Client(("127.0.0.1", int(told.split(":")[1].split(";")[0]))) as client:
            assert "simulated" in str(client("connect", host="localhost", port=9001))
            assert client.array("get_scanned_image", size=16, dwell_time=1e-6).shape == (16, 16)
        run.send_signal(signal.SIGINT)
        assert run.wait(LONGEST_S) == 0 and "Traceback" not in run.stderr.read()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["srtoi3"], "srtio3"),
        (["test", "--grid", "0x4"], "grid"),
        (["test", "--grid", "four"], "rows x columns"),
        (["test", "--grid", "1x1", "--fov", "99999"], "leaves the specimen"),
        (["test", "--grid", "1x1", "--fov", "nan"], "fov=nan: expected 1 Angstrom or more"),
        (["test", "--grid", "1x1", "--fov", "10", "--current", "-5"], "current=-5.0: expected 0.001 to 1e+06 pA"),
        (["test", "--grid", "1x1", "--fov", "10", "--current", "nan"], "current=nan: expected"),
        (["test", "--grid", "1x1", "--fov", "10", "--port", "99999"], "--port 99999: expected 0 to 65535"),
        (["test", "--set", "vacancies.rat=0.1"], "did you mean `rate`?"),
        (["test", "--set", "nothing"], "KEY=VALUE"),
    ],
)
def test_errors_of_the_command_are_one_line(words: list[str], says: str, tmp_path: Path) -> None:
    changes = [word for key, value in DYING.items() for word in ("--set", f"{key}={value}")]
    words = [sys.executable, "-m", "stemworlds", "serve", *(() if "--port" in words else ("--port", "0")), *words, *(changes if "--fov" in words else [])]
    run = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, timeout=LONGEST_S)
    assert run.returncode == 1 and says in run.stderr and run.stderr.count("\n") == 1


def test_a_port_that_is_taken_costs_no_specimen(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = [sys.executable, "-m", "stemworlds", "serve", "test", "--grid", "1x1", "--fov", "10", "--port", str(port)]
        run = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, timeout=LONGEST_S)
    assert run.returncode == 1 and run.stderr.startswith(f"stemworlds serve: 127.0.0.1:{port}: Address already in use; --host and --port")
