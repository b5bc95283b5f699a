"""Run folders that somebody sent, with links, pipes and sockets: commands change nothing outside of them."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import random
import shutil
import socket
import sys
from pathlib import Path

import pytest

from torture import commands
from torture.child import BadResult, in_child, place_of_process, remove
from torture.report import Report
from torture.seeds import Files

CASE, PRINTED = "case.json", "printed"
IN_RUN = ("record.jsonl", "params", "params/{task}.safetensors", "params/x", "outputs", "outputs/{task}.png",
          "thumbnails", "pictures.png", "view.html", "gallery.html", "index.html", "x", "merl", "nbrdf",
          "nbrdf/{task}", "nbrdf/{task}/fc1.npy", "merl/{task}.binary", "mitsuba", "mitsuba/{task}", "bsdf",
          "bsdf/{task}.bsdf", ".partial-1-record.jsonl")  # fmt: skip
ABOVE = ("brdf", "brdf/meta", "{run}", "brdf/general", "checkpoints", "training")  # in the folder that --out names
FIT = "meta brdf --data {data} --out runs -q"
COMMANDS = (
    *(FIT, f"{FIT} --batch 2", f"{FIT} --export {{kind}}", f"{FIT} --batch 2 --export {{kind}}"),
    "general brdf --train --train-steps 1 --recipe quick --data {data} --out runs -q",
    *("export {run} {kind} -q", "view {run} --no-open -q", "view {run} --no-open -q --out {run}/x/a.html --overwrite"),
    "compare {run} {run} -q --out {run}/x/a.pdf",
)
KINDS = ("nbrdf", "merl", "mitsuba", "bsdf")


def cases() -> list[Files]:
    """None, as all are drawn; what they are made of is fitted now."""
    _words()
    return []


@functools.cache
def _words() -> dict[str, str]:
    """What the words of commands and places stand for: a data set, its run and a task, made once."""
    from metapp.cli.commands import app
    from tests.small_spheres import shrink_spheres

    shrink_spheres(pytest.MonkeyPatch())  # for the whole process
    place = place_of_process()
    words = {"data": f"{place}/data", "place": str(place)}
    with contextlib.chdir(place):
        app(f"data synth brdf --count 6 --out {place}/data -q".split(), standalone_mode=False)
        app(FIT.format(**words).split(), standalone_mode=False)
        words["run"] = str(next(Path("runs").glob("brdf/meta/*")))
        words["task"] = next(Path("runs").rglob("params/*")).stem
    return words


def write(rng: random.Random, folder: Path) -> Path:
    """A run with one to four strange things in it, beside files that nobody may touch, and a command."""
    words = _words() | {"kind": rng.choice(KINDS)}
    command = rng.choice(COMMANDS)
    shutil.copytree(Path(words["place"]) / "runs", folder / "runs")
    home, run = folder / "home", folder / words["run"]
    shutil.copytree(run, home / "run")
    (home / "keys").write_text("first\nlast")
    above = ABOVE if command.startswith(("meta", "general")) else ()  # else the user names a folder below these
    for _ in range(rng.choice((1, 1, 2, 4))):
        name = rng.choice((*above, *IN_RUN)).format(**words)
        path = folder / name if name == words["run"] else (folder / "runs" if name in above else run) / name
        with contextlib.suppress(OSError, RuntimeError):  # below a link or a file of an earlier turn
            if path.parent.resolve().is_relative_to(folder / "runs"):
                _become(rng, path, home)
    (folder / CASE).write_text(json.dumps(command.format(**words).split()))
    return folder / CASE


def _become(rng: random.Random, path: Path, home: Path) -> None:
    """Make a link or something else of what is at a place."""
    path.parent.mkdir(parents=True, exist_ok=True)
    remove(path)
    kind = rng.randrange(10)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        with socket.socket(socket.AF_UNIX) as unix, contextlib.chdir(path.parent):
            unix.bind(path.name[-80:])
    elif kind == 2:
        path.mkdir()
    elif kind == 3:
        path.write_bytes(rng.randbytes(30))
    else:
        like = home / "run" / (path.name if path.parent.name != "params" else f"params/{path.name}")
        target = rng.choice((home / "keys", home, home / "new", home / "run", like, path, home / "none" / "new"))
        if kind == 4:  # a chain
            (home / "chain").unlink(missing_ok=True)
            (home / "chain").symlink_to(target)
            target = home / "chain"
        path.symlink_to(target if kind < 7 else os.path.relpath(target, path.parent))


def read(folder: Path, file: Path) -> None:
    """As a shell does, in a process of its own."""
    command, printed = json.loads(file.read_text()), folder / PRINTED

    def work() -> int:
        from metapp.cli import main

        os.chdir(folder)
        for stream in (1, 2):
            os.dup2(os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_APPEND), stream)
        sys.argv = ["metapp", *command]
        try:
            main()
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    before = _content(folder)
    code = in_child(folder / "said", work)
    report, output = Report(), printed.read_text(errors="replace")
    commands.check(report, "links", commands.metapp(*command), commands.Ended(code, output), (0, 1, 2))
    changed = [name for name, held in {**before, **_content(folder)}.items() if before.get(name) != held]
    if changed:
        raise BadResult(f"{changed[0]} has changed by {command}")
    if report.findings:
        raise BadResult(f"{report.findings[0].what}, by {command}")
    if code == 1 and output.count("error: ") != 1:
        raise BadResult(f"{output[-200:]!a}, by {command}")


def _content(folder: Path) -> dict[str, str]:
    """What is at home and beside: type, mode and content of each."""
    state = {}
    for path in [*folder.iterdir(), *(folder / "home").rglob("*")]:
        if path.name not in (PRINTED, "said", "runs"):
            what = (
                os.readlink(path)
                if path.is_symlink()
                else hashlib.sha256(path.read_bytes()).hexdigest()
                if path.is_file()
                else ""
            )
            state[str(path.relative_to(folder))] = f"{path.lstat().st_mode} {what}"
    return state
