"""The command line: ``stemworlds`` on the path, or ``python -m stemworlds``."""

from __future__ import annotations

import importlib
import signal
import sys

from . import _core

#: Commands that are written in Python: module, and what each is for.
_COMMANDS = {
    "bench": (".bench.command", "Run agents in worlds, and report what they found for their dose"),
    "serve": (".serving.command", "Serve a microscope that other programs drive over a socket"),
}


def main() -> int:
    """Runs the command line with the arguments of this process; returns the exit code."""
    words = sys.argv[1:]
    if words and words[0] in _COMMANDS:
        module = importlib.import_module(_COMMANDS[words[0]][0], __package__)
        code: int = module.main(words[1:])
        return code
    if words in ([], ["help"], ["-h"], ["--help"]):
        code = _run(words)
        print("\nAlso, in this package:")
        print("\n".join(f"  {name:<12} {about}" for name, (_, about) in _COMMANDS.items()))
        return code
    return _run(words)


def _run(words: list[str]) -> int:
    """The command line of the program."""
    # This process is the program, which listens to signals itself.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.main(words, [sys.executable, "-m", "stemworlds"])


if __name__ == "__main__":
    sys.exit(main())
