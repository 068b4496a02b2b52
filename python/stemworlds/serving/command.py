"""Implements ``stemworlds serve``, a simulated microscope on a socket."""

from __future__ import annotations

import argparse
import sys
import tomllib
from typing import Any

import numpy as np

from .. import errors
from .._text import printable
from ..live import LiveWorld
from ..recipes import Recipe
from .microscope import Microscope, checked_current, checked_fov, specimen_size_nm, view_nm
from .server import ADDRESS, Server

_EXAMPLES = """
examples:
  stemworlds serve srtio3 --difficulty easy
  stemworlds serve mine.toml --port 9001 --profile routine --current 50

The beam changes the specimen as the table [damage] of the recipe specifies. Clients: docs/serve.md.
"""


def parser() -> argparse.ArgumentParser:
    """Returns the parser of the command line."""
    made = argparse.ArgumentParser(
        prog="stemworlds serve",
        description="Serve a simulated microscope with a specimen. Other programs control it over a socket.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    made.add_argument("recipe", help="name of a recipe, or its TOML file")
    made.add_argument("--difficulty", choices=["easy", "medium", "hard"], help="tier of the recipe, if it has tiers")
    made.add_argument("--grid", metavar="RxC", help="build the central tiles only, R rows and C columns")
    made.add_argument("--seed", type=int, help="seed of the specimen")
    made.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value of the recipe (TOML)")
    made.add_argument("--host", default=ADDRESS[0], help="address for connections (default: %(default)s, from this computer only)")
    made.add_argument("--port", type=int, default=ADDRESS[1], help="port (default: %(default)s; 0 chooses a free port)")
    made.add_argument(
        "--profile", choices=["ideal", "routine", "poor"], default="ideal", help="errors of scan and detector (default: %(default)s)"
    )
    made.add_argument(
        "--fov", type=float, default=50.0, metavar="ANGSTROM", help="edge of the field of view in Angstrom (default: %(default)s)"
    )
    made.add_argument("--current", type=float, default=20.0, metavar="PA", help="current of the beam in pA (default: %(default)s)")
    made.add_argument(
        "--most-dose",
        type=float,
        default=1e6,
        help="greatest total dose of a place, in electrons per square Angstrom; a smaller dose starts sooner (default: 1e6)",
    )
    made.add_argument("--threads", type=int, help="number of threads (default: all processors)")
    return made


def main(arguments: list[str]) -> int:
    """Serves until Ctrl-C. Returns the exit code."""
    given = parser().parse_args(arguments)
    try:
        grid = None if given.grid is None else _grid(given.grid)
        changes = dict(_change(text) for text in given.set)
        changed = Recipe(given.recipe, given.difficulty, grid=grid, seed=given.seed, set=changes)
        view_nm(specimen_size_nm(changed), np.zeros(2), checked_fov(given.fov))
        checked_current(given.current)

        def microscope() -> Microscope:
            print(
                f"making the specimen of {changed['id']}: library images that are neither installed nor cached take minutes; "
                "a smaller --most-dose needs fewer",
                file=sys.stderr,
            )
            world = LiveWorld(changed, most_dose=given.most_dose, threads=given.threads, progress=True)
            return Microscope(world, profile=given.profile, fov_angstrom=given.fov, current_pa=given.current)

        # The server opens its port before it makes the specimen, which may take minutes, so that a used port is reported at once.
        server = Server(microscope, (given.host, given.port))
    except (errors.StemworldsError, ValueError, OSError, OverflowError) as error:
        print(f"stemworlds serve: {printable(_told(error, given.host, given.port))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command goes on with the library", file=sys.stderr)
        return 130
    with server:
        try:
            print(f"listening on {given.host}:{server.port}; Ctrl-C ends it", flush=True)
            server.serve_forever()
        except KeyboardInterrupt:
            print("ended", file=sys.stderr)
    return 0


def _told(error: Exception, host: str, port: int) -> str:
    """Returns the message of an error. For an error of the socket it contains the address and a remedy."""
    if isinstance(error, OSError) and not isinstance(error, errors.StemworldsError):
        return f"{host}:{port}: {error.strerror or error}; --host and --port name another address"
    if isinstance(error, OverflowError):
        return f"--port {port}: expected 0 to 65535"
    return str(error)


def _change(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"--set {text}: expected KEY=VALUE, as phonons.configurations=4")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        # A word without quotes is no TOML, and is used as a text.
        return key.strip(), value.strip()


def _grid(text: str) -> tuple[int, int]:
    rows, _, columns = text.lower().partition("x")
    if not (rows.isdigit() and columns.isdigit()):
        raise ValueError(f"--grid {text}: expected rows x columns, as 4x4")
    return int(rows), int(columns)
