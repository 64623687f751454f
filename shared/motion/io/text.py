"""Text of motion files as exporters write it: any usual encoding, any line ending, either decimal mark."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from shared.errors import InvalidInputError

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
"""Byte-order marks; that of UTF-32 begins with that of UTF-16, so it comes first."""


def decode(data: bytes) -> str:
    """Text of a file: by its byte-order mark, else UTF-16 where every other byte is zero, UTF-8, Windows' Latin-1."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return data[len(mark) :].decode(encoding, errors="replace")
    head = data[:400]
    if len(head) >= 4:
        for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
            if head[first::2].count(0) > 0.4 * len(head[first::2]) and not head[1 - first :: 2].count(0):
                return data.decode(encoding, errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, without their ends.

    Raises:
        InvalidInputError: the file is empty or cannot be opened.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InvalidInputError(f"{path.name}: cannot be opened ({error.strerror})", field="path") from error
    if not data.strip(b" \t\r\n\0"):
        raise InvalidInputError(f"{path.name}: the file is empty", field="path")
    # Only these end a line: str.splitlines would also cut at characters that occur in names. Some programs fill the
    # last block of a file with zeros, or end it as DOS did.
    return re.split(r"\r\n|\r|\n", decode(data).rstrip("\0\x1a"))


def number(word: str) -> float:
    """A number with a decimal point or a decimal comma; separators that trail it are ignored.

    Raises:
        ValueError: it is none.
    """
    word = word.rstrip(",;")
    if "_" in word:
        raise ValueError(f"{word!r} is not a number")
    return float(word.replace(",", ".") if "." not in word else word)


def numbers(line: str, count: int | None = None) -> list[float]:
    """The numbers of a line, separated by blanks, semicolons or commas. `count`: how many are expected.

    A comma is a decimal comma where the blanks alone separate as many numbers as expected.

    Raises:
        ValueError: a word is not a number; the message names it.
    """
    words = line.split()
    if count is not None and len(words) != count and ("," in line or ";" in line):
        apart = re.split(r"[\s,;]+", line.strip().strip(",;"))
        semicolons = re.split(r"[\s;]+", line.strip().strip(";"))
        words = next((w for w in (semicolons, apart) if len(w) == count), words)
    if "_" not in line and "," not in line:
        try:
            return [float(word) for word in words]
        except ValueError:
            pass  # found again below, to be named
    out = []
    for word in words:
        try:
            out.append(number(word))
        except ValueError:
            raise ValueError(f"{word[:40]!r} is not a number") from None
    return out
