"""Checkpoint files: they read back as written, and take the encoder of the General that belongs to them."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import save

from metapp.learning.learn import MetaParameters
from metapp.storage.checkpoint_files import (
    CHECKPOINT_SCHEMA,
    load_checkpoint,
    save_checkpoint,
    tensor_digest,
)
from metapp.storage.files import content_digest, file_digest

START = MetaParameters(
    {"w1": torch.arange(6.0).reshape(2, 3)},
    {"rate.w1": torch.full((1, 2, 3), -1e-3), "beta1": torch.tensor([0.5, 0.25], dtype=torch.float64)},
    {"in.w": torch.ones(3, 2).T.requires_grad_()},
)


def test_checkpoints_read_back_as_written(tmp_path: Path) -> None:
    path, info = (
        tmp_path / "größe" / "start.safetensors",
        {"app": "brdf", "training": {"steps": 3}, "curve": [1.5, None]},
    )
    save_checkpoint(path, START, info)
    start, output = load_checkpoint(path)
    assert output == {**info, "schema": CHECKPOINT_SCHEMA}
    for part, expected in zip(start, START, strict=True):
        torch.testing.assert_close(part, dict(expected), rtol=0, atol=0)  # of the same keys and types
    assert [file.name for file in path.parent.iterdir()] == ["start.safetensors"]
    row = torch.arange(3.0)
    save_checkpoint(tmp_path / "s.safetensors", MetaParameters({"a": row.expand(2, 3), "b": row, "c": row[1:]}), {})
    start, _ = load_checkpoint(tmp_path / "s.safetensors")
    assert start.theta["a"].tolist() == [[0, 1, 2], [0, 1, 2]]
    assert start.theta["c"].tolist() == [1, 2]


def test_missing_and_newer_checkpoints_say_so(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.safetensors: no such checkpoint; give --checkpoint"):
        load_checkpoint(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="no such checkpoint"):
        load_checkpoint(tmp_path)
    path = tmp_path / "start.safetensors"
    path.write_bytes(save({"theta.x": torch.ones(1)}, {"metapp": json.dumps({"schema": CHECKPOINT_SCHEMA + 1})}))
    with pytest.raises(
        ValueError, match=rf"schema {CHECKPOINT_SCHEMA + 1}, expected at most {CHECKPOINT_SCHEMA}; update metapp"
    ):
        load_checkpoint(path)


def test_a_checkpoint_takes_the_encoder_of_the_general_beside_it(tmp_path: Path) -> None:
    encoder = {"w": torch.arange(3.0)}
    save_checkpoint(tmp_path / "general.safetensors", MetaParameters(encoder=encoder), {"app": "brdf"})
    path, general = tmp_path / "meta.safetensors", tensor_digest(encoder)
    save_checkpoint(path, MetaParameters(alpha={"rate": torch.ones(1)}), {"general": general})
    assert torch.equal(load_checkpoint(path)[0].encoder["w"], encoder["w"])
    save_checkpoint(tmp_path / "general.safetensors", MetaParameters(encoder={"w": torch.zeros(3)}), {})
    with pytest.raises(ValueError, match=f"meta.safetensors: goes on from General {general}, which is not beside it"):
        load_checkpoint(path)
    for named in ("0123456789ab", 7, None, {"a": 1}):  # one that names itself
        save_checkpoint(tmp_path / "general.safetensors", START, {"general": named})
        with pytest.raises(ValueError, match="goes on from General"):
            load_checkpoint(tmp_path / "general.safetensors")


def test_a_checkpoint_takes_the_general_of_its_protocol(tmp_path: Path) -> None:
    """Other files beside it, such as a training checkpoint, do not count."""
    encoder, other = {"w": torch.arange(3.0)}, {"w": torch.zeros(3)}
    (tmp_path / "general-photo.training.safetensors").write_bytes(b"no checkpoint")
    for name, saved_encoder in (("general", other), ("general-photo", encoder)):
        save_checkpoint(tmp_path / f"{name}.safetensors", MetaParameters(encoder=saved_encoder), {"app": "brdf"})
    path = tmp_path / "meta-encoder-photo.safetensors"
    save_checkpoint(path, MetaParameters(alpha={"rate": torch.ones(1)}), {"general": tensor_digest(encoder)})
    assert torch.equal(load_checkpoint(path)[0].encoder["w"], encoder["w"])


def test_digests_change_with_content_and_not_with_key_order(tmp_path: Path) -> None:
    assert content_digest({"a": 1, "b": [2]}) == content_digest({"b": [2], "a": 1})
    assert content_digest({"a": 1}) != content_digest({"a": 2})
    assert len(content_digest({})) == 12
    (tmp_path / "x").write_bytes(b"1")
    before = file_digest(tmp_path / "x")
    (tmp_path / "x").write_bytes(b"2")
    assert file_digest(tmp_path / "x") != before
