"""Commands that are killed while they train: the same command goes on, and ends with the same bytes."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from metapp.storage.files import PARTIAL
from metapp.storage.training_checkpoint import TrainingCheckpoint
from tests import forks

pytestmark = pytest.mark.usefixtures("compiled")


class Running(NamedTuple):
    """A command in a process of its own."""

    process: Any
    said: Path  # a folder

    def end(self) -> tuple[int, str]:
        """Its exit code and what it said, once it has ended."""
        self.process.join()
        return self.process.exitcode, (self.said / forks.ERR).read_text()


class Command(NamedTuple):
    """A command that trains, and writes five training checkpoints in the longest time that a kill waits for."""

    arguments: tuple[str | Path, ...]
    out: Path
    wait: float  # s

    def start(self, program: Callable[..., None] = forks.metapp) -> Running:
        said = self.out.with_name(f"{self.out.name}-said")
        line = [*map(str, self.arguments), "--out", str(self.out), "--quiet"]
        often = {"METAPP_CHECKPOINT_SECONDS": str(self.wait / 5)}
        return Running(forks.start(program, *line, said=said, more=often), said)

    def run(self) -> str:
        """To its end; what it says."""
        code, said = self.start().end()
        assert code == 0, said
        return said

    def starts(self) -> dict[str, bytes]:
        """The files of starts, whatever else is there."""
        return {
            str(path.relative_to(self.out)): path.read_bytes()
            for path in self.out.rglob("checkpoints/**/*.safetensors")
            if path.suffixes == [".safetensors"]
        }

    def train_until(self, running: Running, seconds: float) -> bool:
        """Wait until it has kept something new and so long after that; whether it still runs."""
        before = self._written()
        while running.process.is_alive() and self._written() == before:
            time.sleep(0.01)
        running.process.join(seconds)
        return running.process.is_alive()

    def _written(self) -> list[tuple[str, int]]:
        found = []
        for path in self.out.rglob("*.training.safetensors"):
            if path.name.startswith(PARTIAL):  # not there to go on from yet
                continue
            try:
                found.append((path.name, path.stat().st_mtime_ns))
            except FileNotFoundError:
                continue
        return found

    def kill(self, count: int, chance: random.Random) -> tuple[int, list[str]]:
        """Run it and kill it at random moments of its training, up to so many times, then to its end.

        Returns:
            How often it was killed, and what it said about going on.
        """
        killed, lines = 0, []
        while killed < count:
            running = self.start()
            killed += (alive := self.train_until(running, chance.uniform(0, self.wait)))
            running.process.kill()
            _, said = running.end()
            assert "Traceback" not in said
            lines += [line for line in said.splitlines() if line.startswith("going on")]
            if not alive:
                break
        self.run()
        return killed, lines


@pytest.fixture
def command(ten_materials: Path, tmp_path: Path) -> Callable[..., Command]:
    """Makes a command that trains on ten small materials, whose runs go to a folder of their own."""
    data = shutil.copytree(ten_materials, tmp_path / "data")

    def make(out: str, paradigm: str = "general", steps: int = 12, wait: float = 0.25) -> Command:
        arguments = (paradigm, "brdf", "--recipe", "quick", "--data", data, "--train", "--train-steps", str(steps))
        return Command(arguments, tmp_path / out, wait)

    return make


def kill_often(command: Callable[..., Command], seed: int, count: int, paradigm: str, steps: int, wait: float) -> None:
    """Train General and what goes on from it, kill all of it so often, and compare what is kept."""
    whole = command("whole", paradigm, steps, wait)
    whole.run()
    expected, chance = whole.starts(), random.Random(seed)
    assert len(expected) == 2
    total, i = 0, 0
    while total < count:
        again = command(f"killed-{i}", paradigm, steps, wait)
        killed, lines = again.kill(count - total, chance)
        print(f"seed {seed}, {paradigm} {i}: {killed} kills;", "; ".join(line.split(" (")[0] for line in lines))
        assert again.starts() == expected
        assert not list(again.out.rglob("*.training.safetensors"))
        assert not list(again.out.rglob("*.previous.safetensors"))
        assert not list(again.out.rglob(".partial-*"))
        total, i = total + killed, i + 1


@pytest.mark.long
def test_killed_trainings_go_on(command: Callable[..., Command]) -> None:
    kill_often(command, seed=1, count=3, paradigm="quickft", steps=40, wait=0.25)


def _killed_when_it_is_done(*words: str) -> None:
    TrainingCheckpoint.remove = lambda self: os._exit(9)
    forks.metapp(*words)


def test_a_kill_after_the_checkpoint_is_written_keeps_it_once(command: Callable[..., Command]) -> None:
    """The same command again writes the same checkpoint, which is none that it replaces."""
    general = command("general")
    assert general.start(_killed_when_it_is_done).end()[0] == 9
    (before,) = general.starts().values()
    general.run()
    (found,) = (path for path in general.out.rglob("checkpoints/**/*") if path.is_file())
    assert (found.name, found.read_bytes()) == ("general.safetensors", before)


def _stops_once_kept(*words: str) -> None:
    """Be the command, and stop where a training checkpoint is first written after a validation, until it may go on."""
    write = TrainingCheckpoint.write

    def written(self: TrainingCheckpoint) -> None:
        write(self)
        if self.path.is_file() and self.progress.best and self.progress.best.curve:
            TrainingCheckpoint.write = write
            os.kill(os.getpid(), signal.SIGSTOP)

    TrainingCheckpoint.write = written
    forks.metapp(*words)


def stopped_once_kept(command: Command) -> Running:
    """The command, stopped by itself: what it has left to do does not depend on how busy the machine is."""
    running = command.start(_stops_once_kept)
    state = Path(f"/proc/{running.process.pid}/stat")
    while (letter := state.read_text().rsplit(")", 1)[1].split()[0]) != "T":
        assert letter not in "ZX", "it ended before it stopped"
        time.sleep(0.005)
    return running


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_sigterm_acts_like_ctrl_c(command: Callable[..., Command], number: signal.Signals) -> None:
    stopped = command("stopped")
    running = stopped_once_kept(stopped)
    os.kill(running.process.pid, signal.SIGCONT)
    os.kill(running.process.pid, number)
    code, said = running.end()
    assert code == 130
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith("interrupted; the same command goes on")
    assert list(stopped.out.rglob("general.interrupted.safetensors"))
    assert "going on from step" in stopped.run()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 16 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        pytest.skip("needs root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_is_one_line_and_loses_nothing(command: Callable[..., Command], small_disk: Path) -> None:
    """The start that was there stays, what was trained is in the training checkpoint, and both say where."""
    trained = command("disk/runs")
    trained.run()
    before = trained.starts()
    (file,) = (trained.out / each for each in before)
    running = stopped_once_kept(trained)  # with no file half written, whose space would be free again later
    with suppress(OSError), open(small_disk / "filler", "wb", buffering=0) as filler:
        while True:
            filler.write(bytes(4096))
    os.kill(running.process.pid, signal.SIGCONT)
    code, said = running.end()
    assert code == 1
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith(f"error: {file.parent}: No space left on device; {file.name} was not")
    assert f"warning: no training checkpoint: {file.parent}: No space left" in said
    assert trained.starts() == before
    assert not list(trained.out.rglob(".partial-*"))
    (small_disk / "filler").unlink()
    assert "going on from step" in trained.run()
    assert trained.starts() == before  # the same training again
