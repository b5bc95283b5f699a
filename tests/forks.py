"""Programs in forks of a process that has imported torch, for tests that need a process but no fresh Python.

A new process takes 1.3 s to import torch, a fork 0.1 s. A fork has its own environment, streams and exit code too.
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
FORKS.set_forkserver_preload(["torch", "metapp.runs.keeping", "metapp.cli.command_tree", "metapp.apps.brdf.presenter"])
STDOUT_FILE, STDERR_FILE = "out.txt", "err.txt"


class ForkedProgram(NamedTuple):
    """A program that runs in a fork, and the folder to which its output goes."""

    process: ForkServerProcess
    output_folder: Path

    def wait_for_output(self, seconds: float = 600) -> tuple[int | None, str, str]:
        """Wait for the program to end and return its exit code, standard output and standard error.

        The exit code is None if it runs longer than `seconds`.
        """
        self.process.join(seconds)
        return (
            self.process.exitcode,
            (self.output_folder / STDOUT_FILE).read_text(),
            (self.output_folder / STDERR_FILE).read_text(),
        )


def start_in_fork(
    program: Callable[..., Any],
    *arguments: Any,
    output_folder: Path,
    extra_environment: Mapping[str, str] | None = None,
) -> ForkedProgram:
    """Start `program(*arguments)`, a function of a module, in a fork.

    Args:
        output_folder: the folder for its standard output and standard error, out.txt and err.txt.
        extra_environment: variables that its environment has beside those of the test.
    """
    output_folder.mkdir(parents=True, exist_ok=True)
    process = FORKS.Process(
        target=_run_in_fork, args=(program, arguments, output_folder, {**os.environ, **(extra_environment or {})})
    )
    process.start()
    return ForkedProgram(process, output_folder)


def run_script(script: Path, *arguments: str | Path, output_folder: Path) -> tuple[int | None, str, str]:
    """Run a file as `python <script> <arguments>` does; return exit code, standard output and standard error."""
    return start_in_fork(_run_file, str(script), *map(str, arguments), output_folder=output_folder).wait_for_output(300)


def run_metapp(*words: str) -> None:
    """Run the `metapp` command in this process."""
    from metapp.cli import main

    sys.argv = ["metapp", *words]
    main()


def load_compiled_source(source: Path, is_expected: bool) -> None:
    """Load a C source, and fail unless it can be compiled just if `is_expected`."""
    from metapp.extensions.native.compiler import load_library

    assert (load_library(source) is not None) is is_expected


def _run_file(*words: str) -> None:
    sys.argv = [*words]
    sys.path.insert(0, str(Path(words[0]).parent))
    if warning_action := os.environ.get("PYTHONWARNINGS"):
        warnings.simplefilter(warning_action)  # type: ignore[arg-type]  (Python reads it when it starts)
    runpy.run_path(words[0], run_name="__main__")


def _run_in_fork(
    program: Callable[..., Any], arguments: tuple[Any, ...], output_folder: Path, environment: dict[str, str]
) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells have background processes ignore SIGINT
    os.environ.clear()
    os.environ.update(environment)
    for number, name in ((1, STDOUT_FILE), (2, STDERR_FILE)):
        os.dup2(os.open(output_folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    program(*arguments)
