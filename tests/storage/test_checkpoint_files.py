"""Checkpoints: entries read back as written, and share the encoders that they have in common."""

import json
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save

from metapp.learning.learn import MetaParameters
from metapp.storage.checkpoint_files import (
    CHECKPOINT_SCHEMA,
    phi_digest,
    read_entry,
    read_headers,
    write_entry,
)
from metapp.storage.files import content_digest, file_digest

PHI = MetaParameters(
    {"w1": torch.arange(6.0).reshape(2, 3)},
    {"rate.w1": torch.full((1, 2, 3), -1e-3), "beta1": torch.tensor([0.5, 0.25], dtype=torch.float64)},
    {"in.w": torch.ones(3, 2).T.requires_grad_()},
)
ENCODER = {"w": torch.arange(3.0)}
GENERAL, RULE = MetaParameters(encoder=ENCODER), MetaParameters(alpha={"rate": torch.ones(1)}, encoder=ENCODER)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The place of a checkpoint, in a folder that is not there yet."""
    return tmp_path / "größe" / "quick.safetensors"


def test_entries_read_back_as_written(path: Path) -> None:
    header = {"app": "brdf", "training": {"steps": 3}, "curve": [1.5, None]}
    write_entry(path, "ridge", PHI, header)
    phi, output = read_entry(path, "ridge")
    assert output == {**header, "digest": phi_digest(phi)}
    for part, expected in zip(phi, PHI, strict=True):
        torch.testing.assert_close(part, dict(expected), rtol=0, atol=0)  # of the same keys and types
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    row = torch.arange(3.0)
    write_entry(path, "views", MetaParameters({"a": row.expand(2, 3), "b": row, "c": row[1:]}), {})
    phi, _ = read_entry(path, "views")
    assert phi.theta["a"].tolist() == [[0, 1, 2], [0, 1, 2]]
    assert phi.theta["c"].tolist() == [1, 2]


def test_tensors_in_half_precision_stay_so_in_the_file(path: Path) -> None:
    write_entry(path, "general", MetaParameters(encoder={"w": torch.ones(3).half()}), {})
    write_entry(path, "other", PHI, {})
    assert load_file(path)["general:encoder.w"].dtype == torch.half
    assert read_entry(path, "general")[0].encoder["w"].dtype == torch.float32


def test_an_entry_that_is_written_leaves_the_others(path: Path) -> None:
    previous = path.with_name("previous.safetensors")
    write_entry(path, "general", GENERAL, {"app": "brdf"}, previous)
    write_entry(path, "ridge", PHI, {"app": "brdf"}, previous)
    assert not previous.exists()
    before = path.read_bytes()
    write_entry(path, "ridge", PHI._replace(theta={}), {"app": "brdf", "seed": 1}, previous)
    assert previous.read_bytes() == before
    assert list(read_headers(path)) == ["general", "ridge"]
    assert read_headers(path)["ridge"]["seed"] == 1
    assert not read_entry(path, "ridge")[0].theta
    torch.testing.assert_close(read_entry(path, "general")[0].encoder, ENCODER, rtol=0, atol=0)


def test_an_encoder_that_entries_share_is_stored_once(path: Path) -> None:
    """Whichever comes first; an entry keeps its encoder when the one that holds it is replaced."""
    write_entry(path, "ridge", RULE, {})
    write_entry(path, "general", GENERAL, {})
    assert sorted(load_file(path)) == ["general:encoder.w", "ridge:alpha.rate"]
    assert (read_headers(path)["ridge"]["encoder_of"], read_headers(path)["general"].get("encoder_of")) == (
        "general", None,
    )  # fmt: skip
    digest = read_headers(path)["ridge"]["digest"]
    write_entry(path, "general", MetaParameters(encoder={"w": torch.zeros(3)}), {})
    phi, header = read_entry(path, "ridge")
    assert torch.equal(phi.encoder["w"], ENCODER["w"])
    assert header == {"digest": digest}
    assert digest == phi_digest(RULE) != phi_digest(GENERAL)


def test_missing_and_newer_checkpoints_say_so(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.safetensors: no such checkpoint; give --checkpoint"):
        read_entry(tmp_path / "none.safetensors", "general")
    with pytest.raises(ValueError, match=r"a folder, expected a checkpoint; name the \.safetensors file in it"):
        read_headers(tmp_path)
    path = tmp_path / "start.safetensors"
    write_entry(path, "ridge", PHI, {})
    with pytest.raises(ValueError, match=r"start.safetensors: holds ridge, expected general"):
        read_entry(path, "general")
    for schema, remedy in ((CHECKPOINT_SCHEMA + 1, "update metapp"), (CHECKPOINT_SCHEMA - 1, "train one again")):
        path.write_bytes(save({"theta.x": torch.ones(1)}, {"metapp": json.dumps({"schema": schema})}))
        with pytest.raises(ValueError, match=rf"schema {schema}, expected {CHECKPOINT_SCHEMA}; {remedy}"):
            read_headers(path)


def test_digests_change_with_content_and_not_with_key_order(tmp_path: Path) -> None:
    assert content_digest({"a": 1, "b": [2]}) == content_digest({"b": [2], "a": 1})
    assert content_digest({"a": 1}) != content_digest({"a": 2})
    assert len(content_digest({})) == 12
    (tmp_path / "x").write_bytes(b"1")
    before = file_digest(tmp_path / "x")
    (tmp_path / "x").write_bytes(b"2")
    assert file_digest(tmp_path / "x") != before
