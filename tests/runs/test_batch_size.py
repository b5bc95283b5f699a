"""How batches grow: by what they took and by the memory that is left, both made up."""

from __future__ import annotations

import pytest
import torch

from metapp.runs import BadOption
from metapp.runs.fits import batch_size
from metapp.runs.fits.batch_size import MOST, BatchSize, bytes_left, check_batch, peak_bytes

CPU = torch.device("cpu")


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """The peak so far and what is left, bytes."""
    state = {"peak": 1000, "left": 10**9}
    monkeypatch.setattr(batch_size, "peak_bytes", lambda device: state["peak"])
    monkeypatch.setattr(batch_size, "bytes_left", lambda device: state["left"])
    return state


def grown(size: BatchSize, seconds: dict[int, float], memory: dict[str, int], each: int = 0) -> list[int]:
    """The numbers of the next batches, where a batch takes so many seconds, a task so many bytes."""
    found = []
    for _ in range(12):
        memory["peak"] = max(memory["peak"], 1000 + each * size.now)
        size.note(size.now, seconds[size.now])
        found.append(size.now)
    return found


def test_batches_double_until_that_does_not_pay(memory: dict[str, int]) -> None:
    """1, 2 and 4 at once save time; 8 cost as much a task as 4: 8 stay, as they were no slower."""
    seconds = {1: 1.0, 2: 1.2, 4: 1.6, 8: 3.2}
    assert grown(BatchSize(None, CPU), seconds, memory)[:4] == [2, 4, 8, 8]


def test_a_batch_that_is_slower_a_task_is_halved(memory: dict[str, int]) -> None:
    seconds = {1: 1.0, 2: 1.2, 4: 4.0}
    assert grown(BatchSize(None, CPU), seconds, memory)[:4] == [2, 4, 2, 2]


def test_batches_take_half_of_the_memory_that_is_left_at_most(memory: dict[str, int]) -> None:
    memory["left"] = 4_000
    seconds = {2**i: 1.0 for i in range(9)}
    # 16 took 800 bytes more than 8, so that 32 take 1600 more and 64 would take 3200: more than half of 4000
    assert max(grown(BatchSize(None, CPU), seconds, memory, each=100)) == 32


def test_batches_do_not_grow_without_end(memory: dict[str, int]) -> None:
    seconds = {2**i: 1.0 for i in range(20)}
    assert grown(BatchSize(None, CPU), seconds, memory)[-1] == MOST


def test_a_number_that_was_asked_for_stays_unless_memory_runs_out(memory: dict[str, int]) -> None:
    size = BatchSize(64, CPU)
    size.note(64, 100.0)
    assert size.now == 64
    size.failed()
    assert size.now == 32


def test_a_last_batch_that_is_not_full_says_nothing(memory: dict[str, int]) -> None:
    size = BatchSize(None, CPU)
    size.note(1, 1.0)
    size.note(1, 100.0)
    assert size.now == 2


def test_memory_is_measured() -> None:
    before = peak_bytes(CPU)
    block = torch.ones(before // 4 + 50_000_000, dtype=torch.uint8)
    assert peak_bytes(CPU) >= before
    assert bytes_left(CPU) > 0
    assert block[0] == 1


def test_numbers_of_batches() -> None:
    assert [check_batch(text) for text in ("1", "64", "auto", "")] == [1, 64, None, None]
    for text in ("0", "-1", "many", "1.5", "1000000"):
        with pytest.raises(BadOption, match="expected a number of tasks"):
            check_batch(text)
