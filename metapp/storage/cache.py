"""The cache folder: files that can be had again, by a download or by computing; code only in a folder of one's own."""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.storage.files import opened_tensors, write_bytes

if TYPE_CHECKING:
    from torch import Tensor

SECONDS, BLOCK = 30.0, 1 << 20  # until a silent server is given up; bytes that are read at a time


def cache_folder() -> Path:
    """METAPP_CACHE if set, else the user's cache folder of this system."""
    import platformdirs

    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


def download(url: str, report: Callable[[int, int | None], None]) -> bytes:
    """The content of a file of the web; `report` gets bytes that are there and those expected, None if unknown.

    Raises:
        ValueError: no answer, or the connection breaks.
    """
    import http.client
    import urllib.request

    content = bytearray()
    try:
        with urllib.request.urlopen(url, timeout=SECONDS) as response:
            total = int(response.headers.get("Content-Length") or 0) or None
            while block := response.read(BLOCK):
                content += block
                report(len(content), total)
    except (OSError, http.client.HTTPException) as error:
        raise ValueError(f"{url}: {getattr(error, 'reason', None) or error or type(error).__name__}") from None
    return bytes(content)


@functools.cache
def code_folder(folder: Path, variable: str) -> Path:
    """A folder for compiled code that its user alone can write to, made if missing.

    Args:
        folder: its place.
        variable: of the environment, that names it.

    Returns:
        `folder`, with mode 0700, or, with a warning, one of this process, removed at its end, if `folder` is a link,
        another user's or can be written to by others.

    Raises:
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    mine = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    if stat.S_ISDIR(state.st_mode) and mine:
        folder.chmod(0o700)
        return folder
    warnings.warn(
        f"{folder}: a link, another user's or open to others, expected a folder that its user alone can write to; code "
        f"is compiled for this run alone. Remove it, or let {variable} name another place.",
        stacklevel=2,
    )
    alone = tempfile.mkdtemp(prefix="metapp-")
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    return Path(alone)


def cached_tensors(name: str, sources: Sequence[str], make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Tensors from the cache, if the same code made them; else made, and kept there if that can be.

    Args:
        name: of the file.
        sources: paths of the code that makes them.
        make: makes them.
    """
    from safetensors import SafetensorError
    from safetensors.torch import save

    path, maker = cache_folder() / f"{name}.safetensors", {"maker": _maker(sources)}
    with contextlib.suppress(OSError, SafetensorError), opened_tensors(path) as stored:
        if stored.metadata() == maker:
            return {key: stored.get_tensor(key) for key in stored.keys()}  # noqa: SIM118  (not a mapping)
    tensors = {key: value.contiguous() for key, value in make().items()}
    with contextlib.suppress(OSError):
        write_bytes(path, save(tensors, maker))
    return tensors


def _maker(sources: Sequence[str]) -> str:
    """A digest of code, and torch's version."""
    import torch

    digest = hashlib.sha256(b"".join(Path(file).read_bytes() for file in sources))
    return f"{digest.hexdigest()[:16]} {torch.__version__}"
