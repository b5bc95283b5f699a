"""Programs in forks of a process that has imported torch: for tests of processes, but not of how they start.

A process of its own takes 1.3 s to import torch, a fork 0.1 s. Forks have an environment, streams and an exit code too.
"""

import multiprocessing
import os
import runpy
import signal
import sys
import warnings
from collections.abc import Callable, Mapping
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any, NamedTuple

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    ["torch", "metapp.runs.execution", "metapp.cli.command_tree", "metapp.apps.brdf.presenter"]
)
OUT, ERR = "out.txt", "err.txt"


class Running(NamedTuple):
    """A program in a fork, and the folder of what it says."""

    process: ForkServerProcess
    said: Path

    def end(self, seconds: float = 600) -> tuple[int | None, str, str]:
        """Its exit code, standard output and standard error, once it has ended; no code where it takes longer."""
        self.process.join(seconds)
        return self.process.exitcode, (self.said / OUT).read_text(), (self.said / ERR).read_text()


def start(program: Callable[..., Any], *arguments: Any, said: Path, more: Mapping[str, str] | None = None) -> Running:
    """Start `program(*arguments)`, a function of a module, in a fork.

    Args:
        said: a folder for what it says: out.txt and err.txt.
        more: what its environment has beside that of the test.
    """
    said.mkdir(parents=True, exist_ok=True)
    process = FORKS.Process(target=_begin, args=(program, arguments, said, {**os.environ, **(more or {})}))
    process.start()
    return Running(process, said)


def run_script(script: Path, *arguments: str | Path, said: Path) -> tuple[int | None, str, str]:
    """Run a file as `python <script> <arguments>` does: exit code, standard output, standard error."""
    return start(_script, str(script), *map(str, arguments), said=said).end(300)


def metapp(*words: str) -> None:
    """Be the `metapp` command."""
    from metapp.cli import main

    sys.argv = ["metapp", *words]
    main()


def compiles(source: Path, found: bool) -> None:
    """Load a C source, and fail where its functions were to be had or not against `found`."""
    from metapp.extensions.native.compiler import load_library

    assert (load_library(source) is not None) is found


def _script(*words: str) -> None:
    sys.argv = [*words]
    sys.path.insert(0, str(Path(words[0]).parent))
    if chosen := os.environ.get("PYTHONWARNINGS"):
        warnings.simplefilter(chosen)  # type: ignore[arg-type]  (Python reads it when it starts)
    runpy.run_path(words[0], run_name="__main__")


def _begin(program: Callable[..., Any], arguments: tuple[Any, ...], said: Path, environment: dict[str, str]) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has its background processes ignore it
    os.environ.clear()
    os.environ.update(environment)
    for number, name in ((1, OUT), (2, ERR)):
        os.dup2(os.open(said / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    program(*arguments)
