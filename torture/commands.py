"""Running metapp as a user does, and what holds for every command: no traceback, a known exit code, an end in time."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from torture.report import Report, fault_of_message

CODES = (0, 1, 2, 130)
SECONDS = 180.0  # on a busy machine the slowest takes a quarter of it


class Ended(NamedTuple):
    """How a command ended, with what it printed on both streams."""

    code: int
    output: str

    @property
    def error(self) -> str:
        """The line that says what failed; "" for none."""
        found = re.search(r"^error: (.*)$", self.output, re.MULTILINE)
        return found[1] if found else ""


def metapp(*words: str | Path | bytes) -> list[Any]:
    """The command line."""
    return [sys.executable, "-m", "metapp", *words]


def shown(command: list[Any]) -> str:
    """As one types it."""
    return shlex.join(["metapp", *(os.fsdecode(word) for word in command[3:])])


def environment(**more: str) -> dict[str, str]:
    """The variables of a command: this checkout's code, one thread."""
    own = {"PYTHONPATH": str(Path(__file__).parents[1]), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    return {**os.environ, **own, **more}


def start(command: list[Any], **more: Any) -> subprocess.Popen[bytes]:
    """Start a command in a session of its own, both streams in one pipe, unless told otherwise."""
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    return subprocess.Popen(command, start_new_session=True, **{**streams, "env": environment(), **more})


def run(report: Report, part: str, command: list[Any], codes: tuple[int, ...] = CODES, **more: Any) -> Ended:
    """Run a command to its end, or kill it; add what must not be to the report."""
    report.count(part)
    process = start(command, **more)
    try:
        output = process.communicate(timeout=SECONDS)[0]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        report.add(part, f"did not end within {SECONDS:.0f} s", shown(command))
        return Ended(-9, "")
    ended = Ended(process.returncode, (output or b"").decode("utf-8", "replace"))
    check(report, part, command, ended, codes)
    return ended


def check(report: Report, part: str, command: list[Any], ended: Ended, codes: tuple[int, ...] = CODES) -> None:
    """Add to the report what holds for no good command."""
    tail = " / ".join(ended.output.strip().splitlines()[-3:])[-250:]
    if "Traceback" in ended.output:
        report.add(part, f"a traceback: {tail}", shown(command))
    elif "unexpected: please report" in ended.output:
        report.add(part, f"an error that nobody foresaw: {tail}", shown(command))
    elif ended.code not in codes:
        report.add(part, f"exit code {ended.code}, expected {' or '.join(map(str, codes))}: {tail}", shown(command))
    elif ended.error:
        fault = fault_of_message(ended.error)
        if fault:
            report.add(part, fault, shown(command))
