"""onnxruntime-web, which runs models in browsers: fetched once from the npm registry, kept in the cache."""

from __future__ import annotations

import base64
import hashlib
import io
import tarfile
from collections.abc import Callable

from metapp.storage.cache import cache_folder, download
from metapp.storage.files import read_bytes, write_bytes

VERSION = "1.30.0"
ARCHIVE = f"onnxruntime-web-{VERSION}.tgz"
URL = f"https://registry.npmjs.org/onnxruntime-web/-/{ARCHIVE}"
SHA512 = "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ=="  # as npm has it
PARTS = {  # what a page needs, in the archive
    "script": "package/dist/ort.wasm.min.js",
    "module": "package/dist/ort-wasm-simd-threaded.mjs",
    "wasm": "package/dist/ort-wasm-simd-threaded.wasm",
}

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
        try:
            content = download(URL, report)
        except ValueError as error:
            wanted = f"expected onnxruntime-web {VERSION} (33 MB), once; get it elsewhere and put it at {path}"
            raise ValueError(f"{error}, {wanted}.") from None
        found = digest(content)
        if found != SHA512:
            raise ValueError(f"{URL}: SHA-512 {found[:16]}..., expected {SHA512[:16]}...; damaged or another file.")
        write_bytes(path, content)
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
        members = {name: archive.extractfile(member) for name, member in PARTS.items()}
        return {name: file.read() for name, file in members.items() if file}


def digest(content: bytes) -> str:
    """SHA-512 as npm writes it."""
    return base64.b64encode(hashlib.sha512(content).digest()).decode()
