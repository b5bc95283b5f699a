"""Training on two processes: the checkpoint of one; a rank that dies ends the run in one line, which can go on."""

import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from metapp.paradigms import ranks
from metapp.storage.checkpoint_files import read_headers
from tests import forks
from tests.learning.parabolas import EXACT_LOSS
from tests.small_spheres import run_with_small_spheres


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.fixture(scope="module")
def materials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set of twelve synthetic materials."""
    folder = tmp_path_factory.mktemp("ranks") / "data"
    run_with_small_spheres("data", "synth", "brdf", "--count", 12, "--out", folder)
    return folder


@pytest.fixture
def train(materials: Path, compiled_in_cache: None) -> Callable[..., list[forks.ForkedProgram]]:
    """Start the ranks of one training on few small materials: train(ranks, folder, steps)."""

    def start(count: int, out: Path, steps: int, **environment: str) -> list[forks.ForkedProgram]:
        command = ["meta", "brdf", "--recipe", "quick", "--train", "--train-steps", str(steps)]
        command += ["--data", str(materials), "--out", str(out), "--quiet"]
        shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port()), "WORLD_SIZE": str(count)}
        shared["LOCAL_WORLD_SIZE"] = str(count)
        started = []
        for rank in range(count):
            output, rank_environment = out.with_name(f"{out.name}-{rank}"), {**shared, **environment, "RANK": str(rank)}
            started.append(
                forks.start_in_fork(
                    forks.run_metapp, *command, output_folder=output, extra_environment=rank_environment
                )
            )
        return started

    return start


def checkpoint_in(folder: Path) -> Path:
    (path,) = folder.rglob("checkpoints/*.safetensors")
    return path


@pytest.mark.long
def test_two_ranks_train_the_same_checkpoint_as_one(
    train: Callable[..., list[forks.ForkedProgram]], tmp_path: Path
) -> None:
    for count in (1, 2):
        for rank in train(count, tmp_path / str(count), 4):
            code, output, errors = rank.wait_for_output()
            assert code == 0, errors
        assert (output, errors) == ("", "") or count == 1
    one, two = (checkpoint_in(tmp_path / str(count)) for count in (1, 2))
    assert read_headers(one).keys() == read_headers(two).keys() == {"general", "meta-curvature"}
    expected, actual = load_file(one), load_file(two)
    assert expected.keys() == actual.keys()
    for key, value in expected.items():
        away = float((actual[key].double() - value.double()).abs().max())
        assert away < 1e-6 * max(1.0, float(value.abs().max())), key
    assert read_headers(two)["meta-curvature"]["best_step"] > 0  # what is compared was trained


@pytest.mark.long
def test_a_rank_that_dies_ends_the_run(train: Callable[..., list[forks.ForkedProgram]], tmp_path: Path) -> None:
    first, second = train(2, tmp_path / "out", 10**6, METAPP_CHECKPOINT_SECONDS="0")
    until = time.monotonic() + 300
    while not list(tmp_path.rglob("*.training.safetensors")) and time.monotonic() < until:
        time.sleep(0.1)
    second.process.kill()
    code, output, errors = first.wait_for_output()
    assert code == 1
    assert output == ""
    (line,) = errors.strip().splitlines()[-1:]
    assert line.startswith("error: rank 0 of 2: another rank has ended")
    assert "Traceback" not in errors
    assert list(tmp_path.rglob("*.training.safetensors"))


def test_more_ranks_than_tasks_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WORLD_SIZE", "8")
    loss = ranks.LossOverRanks(EXACT_LOSS.draw, EXACT_LOSS.value, shared=True)
    with pytest.raises(ValueError, match="8 ranks: an outer step has 4 tasks, expected at most as many ranks"):
        loss.gradient({"x": torch.zeros(4, 3)}, {"c": torch.zeros(4, 3)}, {}, graph=False)
