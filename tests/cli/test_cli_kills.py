"""Commands that end while they train, by a signal or a full disk: the same command goes on."""

import os
import re
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from metapp.runs import checkpoint_training
from tests import forks

pytestmark = pytest.mark.usefixtures("compiled_in_cache")


class Command(NamedTuple):
    """A command that trains, and writes a training checkpoint every 50 ms."""

    arguments: tuple[str | Path, ...]
    out: Path

    def start(self, program: Callable[..., None] = forks.run_metapp) -> forks.ForkedProgram:
        output_folder = self.out.with_name(f"{self.out.name}-said")
        line = [*map(str, self.arguments), "--out", str(self.out), "--quiet"]
        often = {"METAPP_CHECKPOINT_SECONDS": "0.05"}
        return forks.start_in_fork(program, *line, output_folder=output_folder, extra_environment=often)

    def run(self) -> str:
        """Run the command to its end and return what it prints."""
        code, _, output = self.start().wait_for_output()
        assert code == 0, output
        return output

    def starts(self) -> dict[str, bytes]:
        """The files of starts, whatever else is there."""
        return {
            str(path.relative_to(self.out)): path.read_bytes()
            for path in self.out.rglob("checkpoints/*.safetensors")
            if path.suffixes == [".safetensors"]
        }


@pytest.fixture
def command(ten_materials: Path, tmp_path: Path) -> Callable[..., Command]:
    """Makes a command that trains on ten small materials, whose runs go to a folder of their own."""
    data = shutil.copytree(ten_materials, tmp_path / "data")

    arguments = ("general", "brdf", "--recipe", "quick", "--data", data, "--train", "--train-steps", "12")
    return lambda out: Command(arguments, tmp_path / out)


def _killed_when_it_is_done(*words: str) -> None:
    unlink = Path.unlink
    Path.unlink = lambda path, **how: (
        os._exit(9) if re.fullmatch(r"data-.*\.general\.training\.safetensors", path.name) else unlink(path, **how)
    )
    forks.run_metapp(*words)


def test_killed_after_writing_the_checkpoint_the_rerun_keeps_one(command: Callable[..., Command]) -> None:
    """The command, run again, writes an equal checkpoint, which does not count as one that replaces another."""
    general = command("general")
    assert general.start(_killed_when_it_is_done).wait_for_output()[0] == 9
    ((name, before),) = general.starts().items()
    general.run()
    (found,) = (path for path in general.out.rglob("checkpoints/*") if path.is_file())
    assert (found.name, found.read_bytes()) == (Path(name).name, before)


def _stops_once_kept(*words: str) -> None:
    """Be the command, and stop where a training checkpoint is first written after a validation, until it may go on."""
    write = checkpoint_training.save_training_state

    def written(path: Path, fields: dict[str, Any], settings: dict[str, Any]) -> None:
        write(path, fields, settings)
        if path.is_file() and fields["curve"]:
            checkpoint_training.save_training_state = write
            os.kill(os.getpid(), signal.SIGSTOP)

    checkpoint_training.save_training_state = written
    forks.run_metapp(*words)


def stopped_once_kept(command: Command) -> forks.ForkedProgram:
    """The command, stopped by itself: what it has left to do does not depend on how busy the machine is."""
    running = command.start(_stops_once_kept)
    state = Path(f"/proc/{running.process.pid}/stat")
    while (letter := state.read_text().rsplit(")", 1)[1].split()[0]) != "T":
        assert letter not in "ZX", "it ended before it stopped"
        time.sleep(0.005)
    return running


def test_sigterm_acts_like_ctrl_c(command: Callable[..., Command]) -> None:
    stopped = command("stopped")
    running = stopped_once_kept(stopped)
    os.kill(running.process.pid, signal.SIGCONT)
    os.kill(running.process.pid, signal.SIGTERM)
    code, _, output = running.wait_for_output()
    assert code == 130
    assert "Traceback" not in output
    assert output.splitlines()[-1].startswith("interrupted; ")
    assert list(stopped.out.rglob("*.general.interrupted.safetensors"))
    assert "going on from step" in stopped.run()
