"""Domes for training: photographs that agree with the maps beside them, equal ones for equal materials."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.rti.recipe import RTI
from metapp.learning.app import stack_tasks
from metapp.learning.task import problems_of
from metapp.storage.shards import read_data_set
from tests.needs_mitsuba import needs_mitsuba
from tests.pictures import write_image

pytestmark = [needs_mitsuba, pytest.mark.long]


def test_photographs_agree_with_the_maps_beside_them(metapp: Callable, tmp_path: Path) -> None:
    row, column = np.mgrid[:64, :64] / 64 * 2 * np.pi
    normal = np.stack([-0.4 * np.cos(2 * column), 0.4 * np.sin(row), np.ones_like(row)], 2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    write_image(tmp_path / "waves/waves_normal.png", np.round((normal + 1) * 127.5).astype(np.uint8))
    write_image(tmp_path / "waves/waves_diffuse.png", np.full((64, 64, 3), 150, np.uint8))
    write_image(tmp_path / "waves/waves_roughness.png", np.full((64, 64, 3), 200, np.uint8))
    for out in ("first", "second"):
        options = ["--size", 32, "--lamps", 12, "--split", "train", "--out", tmp_path / out]
        assert metapp("data", "domes", tmp_path / "waves", *options).code == 0
    (task,), (again,) = (read_data_set(tmp_path / out, app="svbrdf_nonstationary") for out in ("first", "second"))
    assert problems_of(task, RTI.app.tensors) == []
    assert task.data["lit"].shape == (12, 3, 32, 32)
    assert torch.equal(task.data["lamps"], again.data["lamps"])
    assert float((task.data["lit"].float() - again.data["lit"].float()).abs().mean()) < 1
    theta = RTI.app.init(torch.Generator().manual_seed(0), 1)  # least squares
    true_normal = unpack_maps(task.data["maps"].float()).normal
    flat = torch.rad2deg(true_normal[2].clamp(-1, 1).acos()).mean()
    assert float(RTI.app.errors(theta, stack_tasks(RTI.app, [task]))["normal"]) < 0.5 * float(flat)
