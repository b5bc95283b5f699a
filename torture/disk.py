"""Full and read-only disks, two writers, no home, closed streams, broken pipes, strange names, odd inputs."""

from __future__ import annotations

import contextlib
import os
import random
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from torture import commands, kills
from torture.commands import metapp
from torture.report import Report

_FULL = {"fit": 60, "export": 200, "synth": 3000, "convert": 1500, "general": 200, "evaluate": 40}  # KB that are free
_NAMES = (b"a\nb", b"\xff\xfe", b"-q", b"x" * 230, "\N{GRINNING FACE}\u202e".encode(), b"\x1b[31mred", b" ", b"...",
          b"a;b'c\"d", b"con.", b"%s%n{}")  # fmt: skip
_SIZES = (0, 4, 16)  # KB; and the case's own


def run(report: Report, seed: str, quick: bool, only: list[str], ends: float = float("inf")) -> None:
    """Run all cases, or those named; see `torture.kills.run`."""
    place = Path(tempfile.mkdtemp(prefix="torture-disk-"))
    try:
        data = kills._make_data(report, place)
        waiting = []
        with ThreadPoolExecutor(max_workers=2) as pool:
            for name, case in CASES.items():
                if not only or name in only:
                    folder = place / name
                    folder.mkdir()
                    own = random.Random(f"{seed}/disk/{name}")
                    waiting.append(pool.submit(case, report, own, data, folder, quick))
        for done in waiting:
            done.result()
    finally:
        shutil.rmtree(place, ignore_errors=True)


@contextlib.contextmanager
def _mounted(report: Report, place: Path, options: str) -> Iterator[bool]:
    """A tmpfs at a place; False where that is not allowed."""
    place.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", place]
    mounted = subprocess.run(mount, capture_output=True, text=True)
    if mounted.returncode:
        report.notice(f"disk: {options} not tried, mounting a tmpfs is not allowed ({mounted.stderr.strip()})")
    try:
        yield not mounted.returncode
    finally:
        if not mounted.returncode:
            subprocess.run(["umount", "-l", place], check=True)


def full(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """A disk that is full: one line that names a place on it, and earlier files as they were."""
    for name, own in list(_FULL.items())[:: 3 if quick else 1]:
        for size in (own // 2,) if quick else (*_SIZES, own // 2, rng.randrange(20, own + 20)):
            with _small_disk(report, place / "small", size) as disk:
                if disk is None:
                    return
                part, earlier = f"disk:full:{name}", disk / "earlier"
                earlier.write_bytes(b"kept")
                command = metapp(*kills.CASES[name](data, disk / "out"))
                ended = commands.run(report, part, command, (0, 1))
                repeat = f"{commands.shown(command)}, on a tmpfs with {size} KB"
                if ended.code == 1 and str(disk) not in ended.error:
                    report.add(part, f"the message names no place on the full disk: {ended.error!a}", repeat)
                if earlier.read_bytes() != b"kept":
                    report.add(part, "an earlier file changed", repeat)
                for path in disk.rglob(".partial-*"):
                    report.add(part, f"left over: {path.name}", repeat)


@contextlib.contextmanager
def _small_disk(report: Report, place: Path, size: int) -> Iterator[Path | None]:
    with _mounted(report, place, f"size={size + 64}k") as allowed:
        if allowed:
            (place / "filler").write_bytes(bytes(60 * 1024))
        yield place if allowed else None


def full_again(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """A training whose disk is full at the end keeps the checkpoint that was there."""
    with _small_disk(report, place / "small", 4000) as disk:
        if disk is None:
            return
        command = metapp(*kills.CASES["general"](data, disk / "out"))
        commands.run(report, "disk:full_again", command, (0,))
        before = {name: held for name, held in kills.results(disk).items() if name.endswith(".safetensors")}
        free = shutil.disk_usage(disk).free
        (disk / "more").write_bytes(bytes(max(free - 40_000, 0)))
        ended = commands.run(report, "disk:full_again", [*command, "--seed", "0"], (0, 1))
        after = kills.results(disk)
        lost = [name for name, held in before.items() if held not in after.values()]
        if lost:
            report.add("disk:full_again", f"lost: {lost[0]}, exit code {ended.code}", commands.shown(command))


def two_writers(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """Two commands into one folder: fits lose no record; of data sets one may be refused, and one is there."""
    for name in ("fit", "synth", "general"):
        for turn in range(1 if quick else 4):
            out = place / f"{name}{turn}"
            command = metapp(*kills.CASES[name](data, out))
            both = [commands.start(command) for _ in range(2)]
            report.count(f"disk:two_writers:{name}", 2)
            ends = [commands.Ended(p.wait(commands.SECONDS), p.stdout.read().decode("utf-8", "replace"))  # type: ignore[union-attr]
                    for p in both]  # fmt: skip
            part = f"disk:two_writers:{name}"
            for ended in ends:
                commands.check(report, part, command, ended, (0, 1))
            if all(ended.code for ended in ends):
                report.add(part, "both failed", f"{commands.shown(command)}, twice at once")
            alone = place / f"{name}-alone"
            if not alone.exists():
                commands.run(report, part, metapp(*kills.CASES[name](data, alone)), (0,))
            for fault in kills.differences(kills.results(alone), kills.results(out)):
                report.add(part, fault, f"{commands.shown(command)}, twice at once")


def read_only(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """A folder that cannot be written to; a file in its place."""
    disk, file = place / "locked", place / "file"
    file.write_text("x")
    with _mounted(report, disk, "ro") as allowed:
        for name in list(kills.CASES)[:: 3 if quick else 1]:
            for out in (*([disk / "out"] if allowed else []), file, file / "below"):
                part = f"disk:read_only:{name}"
                ended = commands.run(report, part, metapp(*kills.CASES[name](data, out)), (1, 2))
                if str(out.parent) not in ended.output.replace("\n", "") and ended.code == 1:
                    report.add(part, f"the message names no path: {ended.error!a}", str(out))


def no_home(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """No HOME, one that is not there, one that is a file; the cache in none of them."""
    fit = kills.CASES["fit"](data, place / "runs")
    draw = ["data", "synth", "brdf", "--count", "2"]  # into the user's cache
    for home, commands_ in ((None, [fit]), ("/proc/none", [fit, draw, ["doctor"]]), ("/dev/null", [draw]), ("", [fit])):
        variables = commands.environment(**({} if home is None else {"HOME": home}))
        for name in ("XDG_CACHE_HOME", "METAPP_CACHE", *(["HOME"] if home is None else [])):
            variables.pop(name, None)
        for words in commands_:
            codes = (0,) if words is fit else commands.CODES
            commands.run(report, "disk:no_home", metapp(*words), codes, env=variables, cwd=place)


def streams(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """Closed streams and readers that go away."""
    fit = kills.CASES["fit"](data, place / "runs")
    check = ["data", "check", data, "--json"]
    for words in (fit, check, ["--help"], [*fit, "--json"], ["meta", "nothing"])[: 2 if quick else None]:
        line = shlex.join([sys.executable, "-m", "metapp", *map(str, words)])
        for end in (">&-", "2>&-", "<&-", ">&- 2>&-", ">&- 2>&- <&-", "| head -c 1", "2>&1 | head -c 1", ">/dev/full",
                    "2>/dev/full"):  # fmt: skip
            shell = ["bash", "-c", f"{line} {end}"]
            ended = commands.run(report, "disk:streams", shell)
            if "closed" in ended.output and "Exception ignored" in ended.output:
                report.add("disk:streams", f"Python's own words: {ended.output[-200:]!a}", shlex.join(shell))


def names(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """Files under strange names, as inputs and as folders to write to."""
    network = next((data.parent / "networks").iterdir())
    for name in _NAMES[:: 3 if quick else 1]:
        folder = Path(os.fsdecode(os.fsencode(place) + b"/" + name))
        shutil.copytree(network, folder)
        commands.run(report, "disk:names", metapp("meta", "texture", "--out", place / "runs", "--", folder), (1,))
        for words in (
            ["meta", "brdf", "--out", place / "runs", "--", folder],
            ["meta", "brdf", "--export", "merl", "--out", place / "runs2", "--", folder],
            ["data", "nbrdf", "--samples", "4096", "--out", place / "data" / str(len(name)), "--", folder],
            ["meta", "brdf", "--data", data, "--out", folder / "out"],
        )[:: 2 if quick else 1]:
            commands.run(report, "disk:names", metapp(*words), (0,) if name.strip() else (0, 1), cwd=place)


def odd_inputs(report: Report, rng: random.Random, data: Path, place: Path, quick: bool) -> None:
    """What is no file with an end: FIFOs, devices, folders, links to themselves; a working folder that is gone."""
    os.mkfifo(place / "pipe")
    (place / "loop").symlink_to("loop")
    (place / "empty").mkdir()
    devices = Path("/dev/null"), Path("/proc/self/mem")
    places = [place / "pipe", Path("/dev/zero"), place / "loop", place / "empty", *devices]
    apps = ("transport", "brdf", "texture", "svbrdf_stationary", "svbrdf_nonstationary", "illumination")
    for app in apps[:: 3 if quick else 1]:
        for odd in places[: 2 if quick else None]:
            commands.run(report, "disk:odd_inputs", metapp("meta", app, odd, "--out", place / "runs"), (1, 2))
    readers = {".xml": "transport", ".json": "transport", ".png": "texture", ".exr": "illumination", ".binary": "brdf"}
    for suffix, app in list(readers.items())[:: 2 if quick else 1]:
        os.mkfifo(place / f"pipe{suffix}")
        (place / f"zero{suffix}").symlink_to("/dev/zero")
        for odd in (place / f"pipe{suffix}", place / f"zero{suffix}"):
            commands.run(report, "disk:odd_inputs", metapp("meta", app, odd, "--out", place / "runs"), (1,))
    for option in ("--checkpoint", "--data"):
        for odd in places[: 2 if quick else None]:
            command = metapp("meta", "brdf", option, odd, "--out", place / "runs")
            commands.run(report, "disk:odd_inputs", command, (1, 2))
    gone = place / "gone"
    gone.mkdir()
    for words in (["meta", "brdf", "--data", data], ["data", "check", data], ["--help"]):
        line = shlex.join([sys.executable, "-m", "metapp", *map(str, words)])
        gone.mkdir(exist_ok=True)
        commands.run(report, "disk:odd_inputs", ["bash", "-c", f"rmdir {gone}; {line}"], cwd=gone)


_CASES = (full, full_again, two_writers, read_only, no_home, streams, names, odd_inputs)
CASES: dict[str, Callable[[Report, random.Random, Path, Path, bool], Any]] = {case.__name__: case for case in _CASES}
