"""Texts of strangers, on their way to a terminal or a table."""

from __future__ import annotations

from typing import Any

#: Spreadsheets take a cell that begins with one of these for a formula.
_FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n")


def printable(text: str, longest: int | None = None) -> str:
    """A text on one line, without characters that a terminal obeys: those are shown as Python escapes them. At most so many characters."""
    if longest is not None and len(text) > longest:
        text = text[:longest] + " ..."
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def table_cell(value: Any) -> Any:
    """A cell of a table as CSV: numbers stay numbers, and a text that a spreadsheet would compute gets an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULAS) else value
