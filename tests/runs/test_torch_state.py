"""Fits are the same whatever a program has set for torch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import pytest
import torch

import metapp
from metapp.runs.surroundings import threads

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
    assert torch.get_num_threads() == 2
