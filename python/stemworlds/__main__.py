"""Runs the installed programs: ``stemgen``, and ``stemworlds`` with the commands written in Python. ``python -m stemworlds`` runs both."""

from __future__ import annotations

import importlib
import signal
import sys

from . import _core

#: Commands that are written in Python: the module of each, and its line in the help.
_COMMANDS = {
    "bench": (".bench.command", "Run agents in worlds, and report their scores as a function of dose"),
    "serve": (".serving.command", "Serve a simulated microscope that other programs control over a socket"),
    "train": (".train.command", "Train networks that find atomic columns and their defects"),
}


def main() -> int:
    """Runs ``stemworlds`` with the arguments of this process; returns the exit code."""
    words = sys.argv[1:]
    if words and words[0] in _COMMANDS:
        module = importlib.import_module(_COMMANDS[words[0]][0], __package__)
        code: int = module.main(words[1:])
        return code
    if words in ([], ["help"], ["-h"], ["--help"]):
        print("The Python package's own commands; `stemworlds COMMAND --help` explains each:")
        print("\n".join(f"  {name:<8} {about}" for name, (_, about) in _COMMANDS.items()))
        print("\nWorlds and images are made by `stemgen` (or, where another program has that name, `python -m stemworlds`).")
        return 0 if words else 2
    return program(words)


def program(words: list[str] | None = None) -> int:
    """Runs ``stemgen`` with these arguments, or the arguments of this process; returns the exit code."""
    # The compiled program handles Ctrl-C, so Python's own handler is removed.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.main(sys.argv[1:] if words is None else words, [sys.executable, "-m", "stemworlds"])


if __name__ == "__main__":
    sys.exit(main())
