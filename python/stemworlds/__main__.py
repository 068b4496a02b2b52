"""The command line: ``stemworlds`` on the path, or ``python -m stemworlds``."""

from __future__ import annotations

import importlib
import signal
import sys

from . import _core

#: Commands of this package alone: the modules that hold their ``main``, and what each does.
COMMANDS = {"bench": (".bench.command", "runs agents in worlds, and reports what they found for their dose")}


def main() -> int:
    """Runs the command line with the arguments of this process; returns the exit code."""
    words = sys.argv[1:]
    if words and words[0] in COMMANDS:
        code: int = importlib.import_module(COMMANDS[words[0]][0], __package__).main(words[1:])
        return code
    # This process is the program, which listens to signals itself.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = _core.main(words, [sys.executable, "-m", "stemworlds"])
    if words in (["-h"], ["--help"]) and code == 0:
        print("\nOf this package alone:")
        for name, (_, does) in COMMANDS.items():
            print(f"  {name:<13} {does}")
    return code


if __name__ == "__main__":
    sys.exit(main())
