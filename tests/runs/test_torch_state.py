"""Fits are the same whatever a program has set for torch, and whatever else it fits at the same time."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import pytest
import torch

import metapp
from metapp.runs.torch_state import _State, threads

RNG = np.random.default_rng(1)
PICTURE = RNG.random((96, 96, 3), dtype=np.float32)


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def brdf() -> float:
    fit = metapp.fit(
        "brdf", lambda wi, wo: np.full(len(wi), 0.2, np.float32) + 0.1 * (wi * wo).sum(1, keepdims=True)[:, 0]
    )
    assert fit.error is not None
    return fit.error


@contextmanager
def default_dtype() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


@contextmanager
def low_precision() -> Iterator[None]:
    torch.set_float32_matmul_precision("medium")
    try:
        yield
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision("highest")


@contextmanager
def low_precision_of_all() -> Iterator[None]:
    torch.backends.fp32_precision = "bf16"
    try:
        yield
        assert torch.backends.mkldnn.conv.fp32_precision == "bf16"
    finally:
        torch.backends.fp32_precision = "none"
    assert torch.backends.mkldnn.conv.fp32_precision == "none"


SETTINGS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "autocast": lambda: torch.autocast("cpu", torch.bfloat16),
    "device meta": lambda: torch.device("meta"),
    "float64": default_dtype,
    "low precision": low_precision,
    "low precision of all": low_precision_of_all,
    "no_grad": torch.no_grad,
    "inference": torch.inference_mode,
}


@pytest.mark.parametrize("setting", SETTINGS.values(), ids=SETTINGS)
def test_a_fit_is_the_same_within_settings_of_the_program(setting: Callable) -> None:
    expected = brdf()
    with setting():
        assert brdf() == expected
        device, dtype = torch.get_default_device(), torch.get_default_dtype()
    with setting():
        assert (torch.get_default_device(), torch.get_default_dtype()) == (device, dtype)


def counts_of(*wanted: int | None) -> list[int]:
    """Threads that torch works with in pieces of work that all begin at once."""
    begin = threading.Barrier(len(wanted))

    def work(count: int | None) -> int:
        begin.wait()
        with threads(count):
            first = torch.get_num_threads()
            time.sleep(0.02)
            assert torch.get_num_threads() == first
            torch.ones(4).sum()
            return first

    with ThreadPoolExecutor(len(wanted)) as pool:
        return list(pool.map(work, wanted))


def test_work_has_its_count_of_threads_whatever_runs_beside_it() -> None:
    assert counts_of(1, None, 1, None, None, 1) == [1, 2, 1, 2, 2, 1]
    assert torch.get_num_threads() == 2
    assert counts_of(None, 1) == [2, 1]


def test_work_of_one_count_runs_at_the_same_time() -> None:
    together = threading.Barrier(3)

    def work(_: int) -> None:
        with threads(1):
            together.wait(timeout=20)

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(work, range(3)))


def test_work_within_work_has_its_count_at_once() -> None:
    with threads(None):
        with threads(1):
            assert torch.get_num_threads() == 1
            with threads(None):
                assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 2


def test_what_failed_holds_nothing() -> None:
    with pytest.raises(ZeroDivisionError), threads(1):
        raise ZeroDivisionError
    assert counts_of(None) == [2]


def test_a_forked_process_works_by_one_thread(capfd: pytest.CaptureFixture[str]) -> None:
    """By several it would wait for threads that only its parent has."""
    with threads(None):
        torch.ones(512, 512) @ torch.ones(512, 512)
    child = os.fork()
    if child == 0:
        with threads(None):
            right = torch.get_num_threads() == 1 and float((torch.ones(512, 512) @ torch.ones(512, 512))[0, 0]) == 512
        os._exit(0 if right else 1)
    deadline = time.monotonic() + 30
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < deadline:
        time.sleep(0.01)
    if ended[0] == 0:
        os.kill(child, 9)
    assert ended == (child, 0)


def test_a_fork_amid_work_goes_on_with_it() -> None:
    state = _State()
    with state.held(1):
        state.after_fork()
        assert torch.get_num_threads() == 1
    with state.held(None):
        pass
    assert torch.get_default_dtype() == torch.float32
