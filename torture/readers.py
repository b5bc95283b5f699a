"""Mutated inputs for all readers, in processes of their own: a crash, abort or hang is a finding and not the end."""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path

from torture.report import Report
from torture.targets import TARGETS

_CHUNK = 2500  # inputs of one process
_STALL_SECONDS = 150.0  # without a word: not even its CPU time ends it
_MOST_DEATHS = 10  # of one chunk; then its rest is left out, with a finding each


def run(report: Report, seed: str, quick: bool, only: list[str], index: int | None = None) -> None:
    """Read mutated inputs with each reader, two processes at a time.

    Args:
        report: gets counts and findings.
        seed: of all draws; input N of a reader depends on it and N alone.
        quick: fewer inputs.
        only: names of readers; all where empty.
        index: this input alone.
    """
    unknown = set(only) - set(TARGETS)
    if unknown:
        raise SystemExit(f"readers {', '.join(sorted(unknown))}: expected some of {', '.join(TARGETS)}.")
    chunks = [
        (name, first, min(_CHUNK, target.inputs[quick] - first))
        for name, target in TARGETS.items()
        if not only or name in only
        for first in range(0, target.inputs[quick], _CHUNK)
    ]
    if index is not None:
        chunks = [(name, index, 1) for name in only]
    with ThreadPoolExecutor(max_workers=2) as pool:
        for done in [pool.submit(_chunk, report, seed, *chunk) for chunk in chunks]:
            done.result()


def _chunk(report: Report, seed: str, name: str, first: int, count: int) -> None:
    end, deaths = first + count, 0
    while first < end:
        last, how = _process(report, seed, name, first, end - first)
        if not how:
            break
        deaths += 1
        report.add(f"readers:{name}", how, _repeat(seed, name, last))
        if deaths == _MOST_DEATHS:
            report.add(f"readers:{name}", f"{deaths} deaths, inputs {last + 1} to {end - 1} left out", "as above")
            report.count(f"readers:{name}", last - end + 1)
            break
        first = last + 1
    report.count(f"readers:{name}", count)


def _process(report: Report, seed: str, name: str, first: int, count: int) -> tuple[int, str]:
    """One process; the last input it said, and how it died, "" for not."""
    folder = tempfile.mkdtemp(prefix="torture-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None)
    words = [sys.executable, "-m", "torture.worker", name, seed, str(first), str(count), folder]
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout
    assert process.stderr
    lines: queue.Queue[bytes] = queue.Queue()
    errors = bytearray()
    threads = [
        threading.Thread(target=lambda: [lines.put(line) for line in chain(process.stdout, [b""])]),
        threading.Thread(target=lambda: [errors.extend(line) for line in process.stderr]),
    ]
    for thread in threads:
        thread.start()
    last, how, is_done = first, "", False
    while True:
        try:
            line = lines.get(timeout=_STALL_SECONDS)
        except queue.Empty:
            how = f"no answer for {_STALL_SECONDS:.0f} s"
            break
        if not line:
            break
        if line.startswith(b"at "):
            last = int(line[3:])
        elif line.startswith(b"{"):
            found = json.loads(line)
            report.add(f"readers:{name}", found["what"], _repeat(seed, name, found["index"]))
        is_done = is_done or line == b"done\n"
    if how:
        os.killpg(process.pid, signal.SIGKILL)
    code = process.wait()
    for thread in threads:
        thread.join()
    shutil.rmtree(Path(folder), ignore_errors=True)
    if not how and not is_done:
        tail = " / ".join(bytes(errors).decode("utf-8", "replace").strip().splitlines()[-2:])[-250:]
        how = f"the process died ({signal.Signals(-code).name if code < 0 else f'exit code {code}'}): {tail}"
    return last, how


def _repeat(seed: str, name: str, index: int) -> str:
    return f"python -m torture --seed {seed} --index {index} readers:{name}"
