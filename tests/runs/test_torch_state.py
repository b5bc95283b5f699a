"""Fits are the same whatever a program has set for torch."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

import metapp
from data_tools.synthetic.examples import write_example
from metapp.runs.environment import torch_defaults


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def brdf() -> float:
    fit = metapp.fit("brdf", lambda wi, wo: 0.2 + 0.1 * (wi * wo).sum(1), paradigm="overfit", recipe="quick", steps=20)
    assert fit.error is not None
    return fit.error


@pytest.fixture(scope="module")
def expected() -> float:
    return brdf()


@contextmanager
def setting(
    change: Callable[[Any], object], read: Callable[[], object], value: object, before: object
) -> Iterator[None]:
    """A program that changes a setting of torch, to which fits leave it."""
    change(value)
    try:
        yield
        assert read() == value
    finally:
        change(before)
    assert read() == before


SETTINGS: dict[str, Callable[[], AbstractContextManager[object]]] = {
    "autocast": lambda: torch.autocast("cpu", torch.bfloat16),
    "device meta": lambda: torch.device("meta"),
    "float64": lambda: setting(torch.set_default_dtype, torch.get_default_dtype, torch.float64, torch.float32),
    "low precision": lambda: setting(
        torch.set_float32_matmul_precision, torch.get_float32_matmul_precision, "medium", "highest"
    ),
    "low precision of all": lambda: setting(
        partial(setattr, torch.backends, "fp32_precision"),
        lambda: torch.backends.mkldnn.conv.fp32_precision,
        "bf16",
        "none",
    ),
    "no_grad": torch.no_grad,
    "inference": torch.inference_mode,
}


@pytest.mark.parametrize("setting", SETTINGS.values(), ids=SETTINGS)
def test_a_fit_is_the_same_within_settings_of_the_program(setting: Callable, expected: float) -> None:
    with setting():
        device, dtype = torch.get_default_device(), torch.get_default_dtype()
        assert brdf() == expected
        assert (torch.get_default_device(), torch.get_default_dtype()) == (device, dtype)


def test_a_file_is_fitted_shown_and_kept_within_another_default_device(tmp_path: Path) -> None:
    """What tells inputs apart, reads fits and exports them, too; the device `meta` stands for CUDA."""
    (source,) = write_example("brdf", tmp_path)
    expected = metapp.fit("brdf", source)
    with torch.device("meta"):
        fit = metapp.fit("brdf", source)
        assert fit.error == expected.error
        assert fit.picture().tobytes() == expected.picture().tobytes()
        fit.export("merl", tmp_path / "paint")
        again = metapp.load(fit.save(tmp_path / "paint.safetensors"))
        assert again.parameters["w1"].device.type == "cpu"
        assert torch.get_default_device().type == "meta"
    for key, value in again.parameters.items():
        torch.testing.assert_close(value, expected.parameters[key])


def test_nested_and_failing_work_restores_threads() -> None:
    with torch_defaults(single=False):
        with torch_defaults(single=True):
            assert torch.get_num_threads() == 1
            with torch_defaults(single=False):
                assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    with pytest.raises(ZeroDivisionError), torch_defaults(single=True):
        raise ZeroDivisionError
    assert torch.get_num_threads() == 2
