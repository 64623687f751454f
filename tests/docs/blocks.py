"""The code blocks of the documents."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

REPO = Path(__file__).resolve().parent.parent.parent
PAGES = [REPO / "README.md", *sorted((REPO / "docs").glob("*.md"))]
_BLOCK = re.compile(
    r"(?:<!-- not run: (?P<why>[^\n]*?) -->\n)?^```(?P<language>\w*)[^\n]*\n(?P<code>.*?)^```$", re.S | re.M
)


@dataclass(frozen=True)
class Block:
    """A fenced block; `why` says why it is not run, where that is so."""

    page: Path
    line: int
    language: str
    code: str
    why: str | None

    @property
    def place(self) -> str:
        """For messages."""
        return f"{self.page.relative_to(REPO)}:{self.line}"


def blocks_of(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(page, text.count("\n", 0, found.start("code")), found["language"], found["code"], found["why"])
        for found in _BLOCK.finditer(text)
    ]


def script(page: Path, language: str) -> str:
    """The blocks of a page in one language that are to be run, one after the other."""
    chosen = [block for block in blocks_of(page) if block.language == language and block.why is None]
    return "\n".join(f"# {block.place}\n{block.code}" for block in chosen)


def pages_with(language: str) -> list[Path]:
    """Pages that have something to run in a language."""
    return [page for page in PAGES if script(page, language)]
