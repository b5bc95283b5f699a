"""Blocks of code in pages, and the marks of those that no test runs.

A mark is a comment in the line before a block:

    <!-- not run: takes hours -->
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent
FENCE = re.compile(
    r"^(?P<before>(?: *<!--[^\n]*-->\n)?)(?P<indent> *)```(?P<kind>\w*)\n(?P<code>.*?)^(?P=indent)```$", re.M | re.S
)
MARK = re.compile(r"<!-- not run: (.+) -->")
RUN = ("bash", "python")
SHOWN = ("console", "text", "toml", "ini", "json", "yaml", "")  # what is printed, or lies in a file


class Block(NamedTuple):
    """A block of code.

    Attributes:
        page: its file.
        line: of its first line of code.
        kind: its language.
        code: as a reader would paste it.
        reason: why no test runs it; "" where one does.
    """

    page: Path
    line: int
    kind: str
    code: str
    reason: str

    def script(self) -> str:
        """What bash runs: the code, or of Python a file of it."""
        python = f"cat > block.py <<'END OF BLOCK'\n{self.code}END OF BLOCK\npython block.py"
        return python if self.kind == "python" else self.code

    def commands(self) -> list[str]:
        """Its lines without comments, those that go on in one."""
        lines = re.sub(r"\\\n\s*", "", self.code).splitlines()
        return [command for line in lines if (command := re.sub(r"\s*#.*", "", line).strip())]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks_of(page: Path) -> Iterator[Block]:
    """The blocks of code of a page, in order."""
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        line = text.count("\n", 0, found.start("code")) + 1
        mark = MARK.search(found["before"])
        yield Block(page, line, found["kind"], textwrap.dedent(found["code"]), mark[1] if mark else "")
