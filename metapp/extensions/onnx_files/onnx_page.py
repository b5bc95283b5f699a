"""A page that runs General of flash photographs in a browser, from disk and offline: a folder of four files.

onnxruntime-web, which runs models there, is fetched once from the npm registry and kept in the cache.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import io
import re
import tarfile
from collections.abc import Callable, Sequence
from html import escape
from importlib import resources
from pathlib import Path

from metapp.extensions.onnx_files.photographs import VGG_CREDIT
from metapp.storage.cache_folders import cache_folder
from metapp.storage.downloads import download
from metapp.storage.files import read_bytes, write_bytes

RUNTIME_VERSION = "1.30.0"
RUNTIME_ARCHIVE = f"onnxruntime-web-{RUNTIME_VERSION}.tgz"
RUNTIME_URL = f"https://registry.npmjs.org/onnxruntime-web/-/{RUNTIME_ARCHIVE}"
RUNTIME_SHA512 = (
    "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ=="  # as npm has it
)
RUNTIME_PARTS = {  # what a page needs, in the archive
    "script": "package/dist/ort.wasm.min.js",
    "module": "package/dist/ort-wasm-simd-threaded.mjs",
    "wasm": "package/dist/ort-wasm-simd-threaded.wasm",
}
MODEL_SIDES_PX = (256, 512, 1024)  # px of photos, of models that take any


def write_page_folder(
    folder: Path, model: bytes, parts: dict[str, bytes], sides: Sequence[int], *, features: bool
) -> None:
    """Write index.html, and beside it the scripts that hold onnxruntime-web and the model; the page comes last.

    A page from disk may not read other files, but it may name scripts: so all that is no script is text in one.

    Args:
        folder: made if missing.
        model: the ONNX file of `photographs.photographs_model`.
        parts: of `provide_runtime`.
        sides: of the photos in px that the model takes and a user chooses from.
        features: whether it reads those of VGG-16.

    Raises:
        OSError: they cannot be written.
    """
    files = {
        "ort.js": parts["script"],
        "runtime.js": encode_script("wasm", parts["wasm"]) + encode_script("module", parts["module"]),
        "model.js": encode_script("model", model),
    }
    for name, content in files.items():
        write_bytes(folder / name, content)
    page = onnx_page_html(sides, features)
    write_bytes(folder / "index.html", page.encode())


def provide_runtime(
    report: Callable[[int, int | None], None], *, url: str = RUNTIME_URL, sha512: str = RUNTIME_SHA512
) -> dict[str, bytes]:
    """Return the files PARTS of onnxruntime-web, of the cache's archive or of one that is fetched into it.

    Args:
        report: told the bytes that are there and those expected; None if that is unknown.
        url: where the archive is fetched, such as a mirror of npm.
        sha512: its digest, as npm writes it.

    Raises:
        ValueError: neither is to be had; the registry's is another file than expected.
    """
    path = cache_folder() / RUNTIME_ARCHIVE
    content = read_bytes(path) if path.is_file() else b""
    if npm_digest(content) != sha512:
        try:
            content = download(url, report)
        except ValueError as error:
            wanted = f"expected onnxruntime-web {RUNTIME_VERSION} (33 MB), once; get it elsewhere and put it at {path}"
            raise ValueError(f"{error}, {wanted}.") from None
        found = npm_digest(content)
        if found != sha512:
            raise ValueError(f"{url}: SHA-512 {found[:16]}..., expected {sha512[:16]}...; damaged or another file.")
        write_bytes(path, content)
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
        members = {name: archive.extractfile(member) for name, member in RUNTIME_PARTS.items()}
        return {name: file.read() for name, file in members.items() if file}


def npm_digest(content: bytes) -> str:
    """SHA-512 as npm writes it."""
    return base64.b64encode(hashlib.sha512(content).digest()).decode()


def encode_script(name: str, content: bytes) -> bytes:
    """A script that keeps bytes, compressed, as text under a name."""
    text = base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
    return f'(globalThis.packed ??= {{}}).{name} = "{text}";\n'.encode()


def onnx_page_html(sides: Sequence[int], features: bool) -> str:
    """The page; arguments as of `write_page_folder`."""
    parts = {
        "page.css": _text("page.css"),
        "page.js": _text("page.js"),
        "sides": "".join(f'<option value="{side}">{side} x {side} px</option>' for side in sides),
        "features": f"\n<li>Features: {escape(VGG_CREDIT)}.</li>" if features else "",
        "version": RUNTIME_VERSION,
    }
    return re.sub(r"{{([a-z.]+)}}", lambda name: parts[name[1]], _text("page.html"))


def _text(name: str) -> str:
    return (resources.files("metapp.extensions.onnx_files") / name).read_text(encoding="utf-8")
