"""Commands killed at random moments: the same command must end afterwards, with the results of one never killed."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from torture import commands
from torture.commands import metapp
from torture.report import Report

POINTS, QUICK_POINTS = 100, 10
_SPANS = ((0.1, 1.05), (0.6, 1.0))  # shares of a whole run; its first half is mostly imports
_A_ROW = 5  # kills before a command may end
_TASKS = "40"  # enough that fits and conversions are seen half done


Case = Callable[[Path, Path], list[Any]]  # words after `metapp`, of a data set and a folder to write to
CASES: dict[str, Case] = {
    "fit": lambda data, out: ["meta", "brdf", "--data", data, "--out", out],
    "overfit": lambda data, out: ["overfit", "brdf", "--steps", "200", "--data", data, "--out", out],
    "export": lambda data, out: ["meta", "brdf", "--export", "nbrdf", "--data", data, "--out", out],
    "synth": lambda data, out: ["data", "synth", "brdf", "--count", _TASKS, *_into(out)],
    "convert": lambda data, out: ["data", "nbrdf", data.parent / "networks", "--samples", "4096", *_into(out)],
    "general": lambda data, out: [*_train("general", data, out), "--train-steps", "60"],
    "meta": lambda data, out: [*_train("meta", data, out), "--rule", "meta-sgd", "--train-steps", "12"],
    "evaluate": lambda data, out: ["evaluate", "brdf", "--which", "quickft", "--data", data, "--out", out],
}


def _into(out: Path) -> list[Any]:
    """A kill may come when all is written already."""
    return ["--overwrite", "--out", out]


def _train(paradigm: str, data: Path, out: Path) -> list[Any]:
    return [paradigm, "brdf", "--train", "--data", data, "--out", out]


def run(report: Report, seed: str, quick: bool, only: list[str], ends: float = float("inf")) -> None:
    """Kill commands at random moments, SIGTERM a quarter of the time, else SIGKILL.

    Args:
        report: gets counts and findings.
        seed: of moments and signals; what a moment hits depends on the machine.
        quick: fewer kill points.
        only: cases; all where empty.
        ends: no further kill point after this moment of the monotonic clock.
    """
    place = Path(tempfile.mkdtemp(prefix="torture-kills-"))
    try:
        data = _make_data(report, place)
        chosen = only or list(CASES)[:: 2 if quick else 1]
        cases = [name for name in CASES if name in chosen]
        points = QUICK_POINTS if quick else POINTS
        shares = {name: points // len(cases) + (i < points % len(cases)) for i, name in enumerate(cases)}

        def kill(name: str) -> None:
            rng = random.Random(f"{seed}/kills/{name}")
            _kill_one(report, rng, name, data, place, shares[name], ends)

        with ThreadPoolExecutor(max_workers=2) as pool:
            list(pool.map(kill, cases))
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _make_data(report: Report, place: Path) -> Path:
    data = place / "data"
    commands.run(report, "kills:data", metapp("data", "synth", "brdf", "--count", _TASKS, "--out", data), (0,))
    made = metapp("meta", "brdf", "--export", "nbrdf", "--data", data, "--out", place / "made", "-q")
    commands.run(report, "kills:data", made, (0,))
    next((place / "made").rglob("nbrdf")).rename(place / "networks")
    return data


def _kill_one(report: Report, rng: random.Random, name: str, data: Path, place: Path, points: int, ends: float) -> None:
    if not points:
        return
    part, case = f"kills:{name}", CASES[name]
    whole = metapp(*case(data, place / f"{name}-whole"))
    began = time.monotonic()
    if commands.run(report, part, whole, (0,)).code:
        return
    seconds = time.monotonic() - began
    expected = results(place / f"{name}-whole")
    out, moments = place / f"{name}-killed", []
    command = metapp(*case(data, out))
    for point in range(points):
        if time.monotonic() > ends:
            report.notice(f"{part}: {points - point} kill points left out, the time was over")
            break
        moment = rng.uniform(*rng.choice(_SPANS)) * seconds
        number = rng.choice((signal.SIGKILL,) * 3 + (signal.SIGTERM,))
        files = rng.randint(1, 2 * len(expected) + 1) if rng.random() < 0.5 else None
        moments.append(f"{number.name} after {f'{files} names of files' if files else f'{moment:.2f} s'}")
        _kill(report, part, command, moment, number, (out, files) if files else None)
        if (point + 1) % _A_ROW and point + 1 < points:
            continue
        ended = commands.run(report, part, command, (0,))
        for fault in differences(expected, results(out)) if ended.code == 0 else ["no end"]:
            repeat = f"{commands.shown(command)}, killed: {', '.join(moments)}"
            report.add(part, f"{fault}, after {len(moments)} kills", repeat)
        shutil.rmtree(out, ignore_errors=True)
        moments = []


def _wait_for_files(process: Any, out: Path, count: int) -> None:
    """Wait until so many further names of files were seen in a folder, temporary ones too, or the process has ended."""
    before = _files_in(out)
    seen: set[str] = set()
    ends = time.monotonic() + commands.SECONDS
    while len(seen) < count and process.poll() is None and time.monotonic() < ends:
        seen |= _files_in(out) - before


def _files_in(out: Path) -> set[str]:
    return {os.path.join(folder, name) for folder, _, names in os.walk(out) for name in names}


def _kill(
    report: Report, part: str, command: list[Any], moment: float, number: signal.Signals, files: tuple[Path, int] | None
) -> None:
    """Start a command and kill it after some seconds, or as soon as so many files were seen in a folder."""
    report.count(f"{part} (points)")
    process = commands.start(command)
    if files:
        _wait_for_files(process, *files)
        moment = 0.0
    try:
        output = process.communicate(timeout=moment)[0]
    except commands.subprocess.TimeoutExpired:
        process.send_signal(number)
        try:
            output = process.communicate(timeout=60)[0]
        except commands.subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            output = process.communicate()[0]
            report.add(part, f"did not end within 60 s of {number.name}", commands.shown(command))
    ended = commands.Ended(process.returncode, output.decode("utf-8", "replace"))
    commands.check(report, part, command, ended, (*commands.CODES, -number, 128 + number))


def results(out: Path) -> dict[str, Any]:
    """What must not depend on kills: bytes of parameters, checkpoints and data, errors of records."""
    found: dict[str, Any] = {}
    for path in sorted(path for path in out.rglob("*") if path.is_file()):
        name = str(path.relative_to(out))
        if path.name == "record.jsonl":
            lines = [json.loads(line) for line in path.read_text().splitlines()]
            found[name] = {line["name"]: line["error"] for line in lines}  # a task's last line counts
        elif path.suffix in (".safetensors", ".npy", ".json") and ".previous." not in path.name:
            found[name] = path.read_bytes()
        elif path.name.startswith(".partial-"):
            found[name] = "left over"
    return found


def differences(expected: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """What is missing, more or other than expected; empty where all is alike."""
    ignored = (".interrupted.", ".checkpoint", ".partial-", ".lock")
    more = [name for name in set(found) - set(expected) if not any(word in name for word in ignored)]
    lines = [f"{name} is missing" for name in sorted(set(expected) - set(found))]
    lines += [f"{name} is not there without kills" for name in sorted(more)]
    lines += [f"{name} differs" for name in sorted(set(expected) & set(found)) if expected[name] != found[name]]
    return lines[:3]
