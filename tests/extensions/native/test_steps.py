"""The steps of the extension, torch's without it, and those that torch compiles."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from metapp.extensions.native.fastest import COMPILED, can_compile, compiled_steps, steps
from metapp.learning.adjoint import torch_steps
from metapp.paradigms.paradigm import fastest
from tests.learning.conftest import randn
from tests.learning.test_adjoint import assert_alike, brdf_case, value_and_grads

__all__ = ["randn"]


def test_steps_are_those_of_the_extension(monkeypatch: pytest.MonkeyPatch) -> None:
    offered = fastest(compiles=True)
    assert isinstance(offered, functools.partial)
    assert (offered.func, offered.keywords) == (steps, {"compiles": True})
    monkeypatch.setenv("METAPP_WITHOUT", "native")
    assert fastest(compiles=True) is torch_steps


@pytest.mark.long
@pytest.mark.skipif(not (shutil.which("g++") or shutil.which("clang++")), reason="torch.compile needs g++")
def test_steps_that_torch_compiles_are_those_of_torch(randn: Callable[..., Tensor]) -> None:
    phi, mean = brdf_case("meta-curvature", randn)
    assert_alike(*(value_and_grads(mean(2, steps_of), phi) for steps_of in (compiled_steps, torch_steps)))


def test_torch_compiles_where_nobody_else_can_write(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "compile", lambda function: function)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    monkeypatch.setenv(COMPILED, "")
    assert can_compile.__wrapped__()
    assert os.environ[COMPILED] == str(cache / "torch")
    shared = cache / "shared"
    shared.mkdir()
    (shared / "code.py").touch()
    shared.chmod(0o777)
    monkeypatch.setenv(COMPILED, str(shared))
    with pytest.warns(UserWarning, match=f"{shared}: .* open to others, .* {COMPILED} name another place"):
        assert can_compile.__wrapped__()
    assert os.environ[COMPILED] != str(shared)
