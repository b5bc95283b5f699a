"""Files in folders whose names are no UTF-8 are read as all others."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from metapp.learning.learn import MetaParameters
from metapp.learning.task import Task
from metapp.storage.checkpoints import load_checkpoint, save_checkpoint
from metapp.storage.files import read_tensors
from metapp.storage.fits import read_fits, read_params, write_fit
from metapp.storage.shards import ShardWriter, read_shard

VALUES = torch.arange(6.0).reshape(2, 3)


@pytest.fixture(params=[b"plain", b"\xff\xfe", "gr\u00fcn \u2708".encode()], ids=["plain", "no UTF-8", "UTF-8"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + request.param))
    path.mkdir()
    return path


def test_parameters_checkpoints_and_data_sets(folder: Path) -> None:
    kept = write_fit(folder / "run", {"name": "gold", "error": 1.0, "seconds": 0.1}, {"w": VALUES})
    assert torch.equal(read_params(kept["folder"])["w"], VALUES)
    assert [record["name"] for record in read_fits(folder / "run")] == ["gold"]
    save_checkpoint(folder / "a.safetensors", MetaParameters(theta={"w": VALUES}), {"app": "brdf"})
    assert torch.equal(load_checkpoint(folder / "a.safetensors")[0].theta["w"], VALUES)
    with ShardWriter(folder / "set", "brdf", {"w": "1"}) as writer:
        writer.add(Task("gold", {"w": VALUES}), "test")
    assert torch.equal(read_shard(folder / "set", "test")[0].data["w"], VALUES)
    with pytest.raises(OSError, match="No such file"):
        read_tensors(folder / "none.safetensors")
