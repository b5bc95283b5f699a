"""Findings, and what every message to a user must be."""

from __future__ import annotations

import re
import sys
import threading
from pathlib import Path
from typing import NamedTuple

MAX_CHARACTERS = 300
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f-\x9f]")


class Finding(NamedTuple):
    """Something that must not happen.

    Attributes:
        part: of the harness, with the case: "readers:merl".
        what: happened, in one line.
        repeat: the command, or input, that shows it again.
    """

    part: str
    what: str
    repeat: str


class Report:
    """Counts and findings of all parts; many findings of one kind are shown once, with their number."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []
        self.counts: dict[str, int] = {}
        self.notices: list[str] = []
        self._lock = threading.Lock()

    def count(self, part: str, number: int = 1) -> None:
        """Say that so many things were tried."""
        with self._lock:
            self.counts[part] = self.counts.get(part, 0) + number

    def add(self, part: str, what: str, repeat: str) -> None:
        """Keep a finding."""
        with self._lock:
            self.findings.append(Finding(part, " ".join(what.split())[:400], repeat))
        print(f"found by {part}: {what[:120]!a}; {repeat}", file=sys.stderr, flush=True)

    def notice(self, line: str) -> None:
        """Keep a line on what could not be tried."""
        with self._lock:
            self.notices.append(line)

    def lines(self) -> list[str]:
        """The whole report."""
        lines = [f"{part}: {number:,} tried" for part, number in sorted(self.counts.items())]
        lines += [f"notice: {notice}" for notice in self.notices]
        kinds: dict[tuple[str, str], list[Finding]] = {}
        for finding in self.findings:
            kinds.setdefault((finding.part, re.sub(r"0x[0-9a-f]+|\d+", "#", finding.what)[:80]), []).append(finding)
        for alike in kinds.values():
            first = alike[0]
            more = f" ({len(alike)} alike)" if len(alike) > 1 else ""
            lines += [f"FINDING {first.part}{more}: {first.what}", f"  repeat: {first.repeat}"]
        return [*lines, f"{len(self.findings)} findings of {len(kinds)} kinds"]


def fault_of_message(message: str, name: str = "", folder: Path | None = None) -> str:
    """What is wrong with a message to a user; "" where nothing is.

    Args:
        message: one line, without "error: ".
        name: the file's, or a part of it, that the message must hold; "" for any.
        folder: the input's place; its length does not count, since a user's own path may be short.
    """
    shown = message.replace(str(folder), "") if folder else message
    if _CONTROL.search(message):
        return f"control characters in the message {message[:200]!a}"
    if len(shown) > MAX_CHARACTERS:
        return f"a message of {len(shown)} characters: {shown[:200]!a}"
    if name and name not in message:
        return f"the message does not name {name}: {message[:200]!a}"
    return ""
