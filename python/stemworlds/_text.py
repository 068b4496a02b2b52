"""Makes untrusted texts safe for a terminal or a table."""

from __future__ import annotations

from typing import Any

#: Spreadsheets read a cell that begins with one of these characters as a formula.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n")


def printable(text: str, longest: int | None = None) -> str:
    """Returns a text on one line, of at most ``longest`` characters. Control characters of terminals are replaced by their Python
    escapes."""
    if longest is not None and len(text) > longest:
        text = text[:longest] + " ..."
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def table_cell(value: Any) -> Any:
    """Returns a cell of a CSV table. Numbers are unchanged; a text that a spreadsheet would read as a formula gets a leading apostrophe."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value
