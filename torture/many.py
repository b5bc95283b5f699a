"""Thousands of inputs of one run, and 10^5 lines of standard input: memory, handles and time an input must not grow."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torture import commands
from torture.report import Report

SAMPLES = 80  # of a material
MATERIALS = 1000  # of the runs; a tenth with --quick
LINES = 100_000  # a fiftieth with --quick
GOOD = 50  # one of so many lines names a material, in turn one of FEW
FEW = 2
FLAT = 24 * 2**20  # bytes that resident memory may grow by between a tenth of the inputs and the last
TASK = 2**14  # the same for each input of a run without --batch, which holds all tasks: these are of 6 KB
SLOWER = 1.5  # times the CPU time an input of the first half, of the second
EVERY = 0.05  # seconds between two looks


class Look(NamedTuple):
    """A process at some moment.

    Attributes:
        done: inputs that it has answered.
        memory: resident, bytes.
        handles: open files.
        threads: of it.
        seconds: of CPU time.
    """

    done: int
    memory: int
    handles: int
    threads: int
    seconds: float


def run(report: Report, seed: str, quick: bool, only: list[str], ends: float = float("inf")) -> None:
    """Run all cases, or those named; see `torture.kills.run`. With `COUNT` in `many:lines=COUNT`, of so many."""
    place = Path(tempfile.mkdtemp(prefix="torture-many-"))
    counts = dict(word.partition("=")[::2] for word in only)
    try:
        waiting = []
        with ThreadPoolExecutor(max_workers=2) as pool:
            for name, (case, usual, little) in CASES.items():
                if name in counts or not only:
                    folder = place / name
                    folder.mkdir()
                    own = random.Random(f"{seed}/many/{name}")
                    number = int(counts.get(name) or (little if quick else usual))
                    waiting.append(pool.submit(case, report, own, folder, number))
        for done in waiting:
            done.result()
    finally:
        shutil.rmtree(place, ignore_errors=True)


def materials(rng: random.Random, folder: Path, count: int) -> list[Path]:
    """Tables of a goniometer, each of random reflectance at random angles, [SAMPLES] rows."""
    numbers, files = np.random.default_rng(rng.randrange(2**32)), []
    folder.mkdir()
    for index in range(count):
        angles = numbers.random((SAMPLES, 4)) * [89, 360, 89, 360]
        rows = np.concatenate([angles, 0.1 + numbers.random((SAMPLES, 3))], 1)
        text = "\n".join(",".join(f"{value:.5g}" for value in row) for row in rows)
        files.append(folder / f"m{index}.csv")
        files[-1].write_text(f"theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b\n{text}\n")
    return files


def of_folder(report: Report, rng: random.Random, place: Path, count: int, *more: str) -> None:
    """One run of a folder; one input in fifty is damaged, and is named."""
    part, memory = "many:batch" if more else "many:folder", None
    if not more:  # which reads all before the first fit
        few = _looks(report, rng, place / "few", part, count // 10)
        memory = max(look.memory for look in few)
    looks = _looks(report, rng, place / "all", part, count, *more)
    judge(report, part, looks, FLAT + (0 if more else TASK * count), f"{part}={count}", memory)


def _looks(report: Report, rng: random.Random, place: Path, part: str, count: int, *more: str) -> list[Look]:
    """Looks at a run of so many inputs."""
    place.mkdir()
    files = materials(rng, place / "materials", count)
    for file in files[::50]:
        file.write_text("theta_i_deg\n")
    command = _command(place / "materials", "--out", place / "runs", "--json", *more)
    report.count(part, count)
    process = commands.start(command, stderr=subprocess.DEVNULL)
    records = Records(place / "runs")
    watch = Watch(process.pid, records.count)
    document = json.loads(process.communicate()[0] or "{}")
    looks, expected = watch.end(), count - len(files[::50])
    code = 1 if more else 0  # what fails is an error with --batch, and is skipped with a warning without
    if process.returncode != code:
        report.add(part, f"exit code {process.returncode}, expected {code}", commands.shown(command))
    names = [task["name"] for task in document.get("tasks", [])]
    if len(set(names)) != expected or records.count() != expected:
        report.add(part, f"{len(names)} answers and {records.count()} records of {expected}", commands.shown(command))
    return looks


def batch(report: Report, rng: random.Random, place: Path, count: int) -> None:
    """The same with --batch."""
    of_folder(report, rng, place, count, "--batch", "8")


def lines(report: Report, rng: random.Random, place: Path, count: int, each: int = GOOD) -> None:
    """Lines of few materials between missing and damaged files: each is answered, in order."""
    known = materials(rng, place / "materials", FEW)
    bad = [place / "none.csv", place / "empty.csv", place / "empty", Path("\udcff"), Path("x" * 5000), Path("a\x1bb")]
    (place / "empty.csv").write_bytes(b"")
    (place / "empty").mkdir()
    asked = [known[i // each % FEW] if i % each == 0 else bad[i % len(bad)] for i in range(count)]
    command = _command("-", "--out", place / "runs", "--json")
    part = "many:lines" if each > 1 else "many:fits"
    report.count(part, count)
    process = commands.start(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdin
    assert process.stdout
    answered: list[Any] = []
    watch = Watch(process.pid, lambda: len(answered))
    threading.Thread(target=_send, args=(process, asked), daemon=True).start()
    for line in process.stdout:
        answer = json.loads(line)
        answered.append((answer["input"], "failure" in answer))
    process.wait()
    shown = f"{count} lines: {commands.shown(command)}"
    judge(report, part, watch.end(), FLAT, shown)
    expected = [(str(path).encode(errors="backslashreplace").decode(), path not in known) for path in asked]
    if len(answered) != count:
        report.add(part, f"{len(answered)} answers of {count} lines", shown)
    for i, (found, wanted) in enumerate(zip(answered, expected, strict=False)):
        if found[1] != wanted[1] or (wanted[0].isprintable() and found[0].isprintable() and found[0] != wanted[0]):
            report.add(part, f"line {i}: {found}, expected {wanted}", shown)
            break
    code = 1 if each > 1 else 0
    if process.returncode != code:
        report.add(part, f"exit code {process.returncode}, expected {code}", shown)


def fits(report: Report, rng: random.Random, place: Path, count: int) -> None:
    """Lines that all are fits, of the same few materials."""
    lines(report, rng, place, count, 1)


def cut(report: Report, rng: random.Random, place: Path, count: int) -> None:
    """Ctrl-C, or a reader that goes away, amid lines: whatever was answered is kept."""
    known = materials(rng, place / "materials", 20)
    for turn in range(count):
        by_signal, after, out = turn % 2 == 0, rng.randrange(1, len(known)), place / f"runs{turn}"
        command = _command("-", "--out", out, "--json")
        process = commands.start(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
        assert process.stdout
        assert process.stderr
        report.count("many:cut")
        threading.Thread(target=_send, args=(process, known * 50), daemon=True).start()
        answers = [json.loads(process.stdout.readline()) for _ in range(after)]
        time.sleep(rng.random() * 0.1)
        if by_signal:
            process.send_signal(signal.SIGINT)
            answers += [json.loads(line) for line in process.stdout]
        else:
            process.stdout.close()
        error = process.stderr.read().decode("utf-8", "replace")
        ended = commands.Ended(process.wait(commands.SECONDS), error)
        shown = f"{'Ctrl-C' if by_signal else 'a closed pipe'} after {after} answers: {commands.shown(command)}"
        commands.check(report, "many:cut", command, ended, (130,) if by_signal else (1,))
        kept = {name for name, _ in Records(out).lines()}
        lost = [answer["input"] for answer in answers if Path(answer["input"]).stem not in kept]
        if lost:
            report.add("many:cut", f"answered, but not kept: {lost[0]}", shown)


def _command(*words: str | Path) -> list[Any]:
    return [sys.executable, "-m", "torture.small", "meta", "brdf", *words, "--quiet"]


def _send(process: subprocess.Popen[bytes], paths: list[Path]) -> None:
    """Write lines for as long as they are read."""
    assert process.stdin
    try:
        for path in paths:
            process.stdin.write(os.fsencode(path) + b"\n")
        process.stdin.close()
    except OSError:
        pass


class Records:
    """The records of all runs below a folder, as far as they are written."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._size, self._count = folder, 0, 0
        self._file: Path | None = None

    def count(self) -> int:
        """Lines of the first record file."""
        self._file = self._file or next(self.folder.rglob("record.jsonl"), None)
        if self._file:
            with self._file.open("rb") as file:
                file.seek(self._size)
                added = file.read()
            self._size, self._count = self._size + len(added), self._count + added.count(b"\n")
        return self._count

    def lines(self) -> list[tuple[str, float]]:
        """Names and errors."""
        found = [json.loads(line) for file in self.folder.rglob("record.jsonl") for line in file.open()]
        return [(record["name"], record["error"]) for record in found]


class Watch:
    """Looks at a process from time to time, in a thread, until `end`."""

    def __init__(self, process: int, done: Callable[[], int]) -> None:
        self._process, self._done = process, done
        self._looks: list[Look] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        place, tick = Path(f"/proc/{self._process}"), os.sysconf("SC_CLK_TCK")
        while not self._over.wait(EVERY):
            try:
                status = (place / "status").read_text(errors="replace")
                values = dict(line.split(":", 1) for line in status.splitlines())
                times = (place / "stat").read_text(errors="replace").rpartition(")")[2].split()[11:13]
                memory, threads = 1024 * int(values["VmRSS"].split()[0]), int(values["Threads"])
                handles = len(list((place / "fd").iterdir()))
            except (OSError, KeyError, IndexError):
                return
            self._looks.append(Look(self._done(), memory, handles, threads, sum(map(int, times)) / tick))

    def end(self) -> list[Look]:
        """All looks."""
        self._over.set()
        self._thread.join()
        return self._looks


def judge(report: Report, part: str, looks: list[Look], growth: int, repeat: str, memory: int | None = None) -> None:
    """Compare a tenth, the half and the end of the inputs: memory, handles, threads and time an input stay.

    What is done when all are answered, such as a page of all, does not count. `memory` is what a run of a tenth of the
    inputs takes, instead of that of this run after so many.
    """
    last = max((look.done for look in looks), default=0)
    busy = [look for look in looks if 0.1 * last <= look.done <= last]
    if not last or len(busy) < 10:
        report.add(part, f"ended after {last} inputs and {len(busy)} looks", repeat)
        return
    end = next(i for i, look in enumerate(busy) if look.done == last)
    busy = busy[: max(end, 1) + 1]
    first, final = busy[0], busy[-1]
    middle = min(busy, key=lambda look: abs(look.done - (first.done + final.done) / 2))
    memory = first.memory if memory is None else memory
    before, after = ((b.seconds - a.seconds) / max(b.done - a.done, 1) for a, b in ((first, middle), (middle, final)))
    report.notice(
        f"{part}: {final.memory / 2**20:.0f} MiB after {final.done:,} inputs, {memory / 2**20:.0f} MiB after "
        f"{first.done:,}; {1000 * before:.2f} ms of CPU time an input of the first half, {1000 * after:.2f} ms of the "
        f"second; {final.handles} files, {final.threads} threads"
    )
    if final.memory - memory > growth:
        report.add(part, f"memory grew from {memory:,} to {final.memory:,} bytes", repeat)
    if final.handles > first.handles + 2 or final.threads > first.threads + 2:
        report.add(
            part, f"handles {first.handles} to {final.handles}, threads {first.threads} to {final.threads}", repeat
        )
    if after > SLOWER * before and final.seconds - first.seconds > 2:  # of less, the clock says little
        report.add(part, f"{before:.5f} s an input of the first half, {after:.5f} s of the second", repeat)


_Case = Callable[[Report, random.Random, Path, int], None]
CASES: dict[str, tuple[_Case, int, int]] = {
    "lines": (lines, LINES, LINES // 50),
    "folder": (of_folder, MATERIALS, MATERIALS // 10),
    "batch": (batch, MATERIALS, MATERIALS // 10),
    "fits": (fits, MATERIALS, MATERIALS // 10),
    "cut": (cut, 8, 2),
}
