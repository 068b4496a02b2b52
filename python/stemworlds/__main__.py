"""The command line: ``stemworlds`` on the path, or ``python -m stemworlds``."""

from __future__ import annotations

import signal
import sys

from . import _core


def main() -> int:
    """Runs the command line with the arguments of this process; returns the exit code."""
    # This process is the program, which listens to signals itself.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _core.main(sys.argv[1:], [sys.executable, "-m", "stemworlds"])


if __name__ == "__main__":
    sys.exit(main())
