"""A page that runs General of flash photographs in a browser, from disk and offline: a folder of four files.

onnxruntime-web, which runs models in browsers, is fetched once from the npm registry and kept in the cache. This module
is given the content of a model; it does not know how the model was made.
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
# the digest of the archive, as the npm registry states it
RUNTIME_SHA512 = "q0y+JrrtukXSzsBWEMccVfqX25LRmosXHF+CaRJmg8pZClzcV7svNc4rKY3jL02Vb7QmRMDs1SigqR4CXAfKYQ=="
RUNTIME_PARTS = {  # the files of the archive that a page needs
    "script": "package/dist/ort.wasm.min.js",
    "module": "package/dist/ort-wasm-simd-threaded.mjs",
    "wasm": "package/dist/ort-wasm-simd-threaded.wasm",
}
MODEL_SIDES_PX = (256, 512, 1024)  # sides of photos that a page offers if its model takes photos of any size


def write_page_folder(
    folder: Path, model: bytes, parts: dict[str, bytes], sides: Sequence[int], *, features: bool
) -> None:
    """Write index.html, and beside it the scripts that hold onnxruntime-web and the model; the page is written last.

    Browsers forbid a page from disk to read other files, but not to load scripts: so the model and the runtime are
    text in scripts.

    Args:
        folder: the folder, made if missing.
        model: the content of an ONNX file, see :func:`metapp.extensions.onnx_files.photographs.encode_photo_model`.
        parts: the files of onnxruntime-web, see :func:`provide_runtime`.
        sides: sides in px of the photos that the model takes, from which a user chooses.
        features: whether the model reads features of VGG-16, which the page then credits.

    Raises:
        OSError: the files cannot be written.
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
    """Return the files of onnxruntime-web that a page needs, by the names of RUNTIME_PARTS.

    They come from the archive in the cache, which is fetched if it is missing or damaged.

    Args:
        report: told the bytes that were fetched, and the bytes expected, None if unknown.
        url: the address of the archive, such as one on a mirror of npm.
        sha512: the digest of the archive, as npm writes it.

    Raises:
        ValueError: the archive cannot be fetched, or it is another file than expected.
    """
    path = cache_folder() / RUNTIME_ARCHIVE
    content = read_bytes(path) if path.is_file() else b""
    if npm_digest(content) != sha512:
        try:
            content = download(url, report)
        except ValueError as error:
            remedy = f"expected onnxruntime-web {RUNTIME_VERSION} (33 MB), once; get it elsewhere and put it at {path}"
            raise ValueError(f"{error}, {remedy}.") from None
        digest = npm_digest(content)
        if digest != sha512:
            raise ValueError(f"{url}: SHA-512 {digest[:16]}..., expected {sha512[:16]}...; damaged or another file.")
        write_bytes(path, content)
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as archive:
        members = {name: archive.extractfile(member) for name, member in RUNTIME_PARTS.items()}
        return {name: file.read() for name, file in members.items() if file}


def npm_digest(content: bytes) -> str:
    """Return the SHA-512 of a file as npm writes it, in base64."""
    return base64.b64encode(hashlib.sha512(content).digest()).decode()


def encode_script(name: str, content: bytes) -> bytes:
    """Return a script that keeps bytes, compressed, as text under a name of the global object `packed`."""
    text = base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
    return f'(globalThis.packed ??= {{}}).{name} = "{text}";\n'.encode()


def onnx_page_html(sides: Sequence[int], features: bool) -> str:
    """Return the content of index.html.

    Args:
        sides: sides in px of the photos that the model takes, from which a user chooses.
        features: whether the page credits VGG-16, whose features the model reads.
    """
    parts = {
        "page.css": _read_page_file("page.css"),
        "page.js": _read_page_file("page.js"),
        "sides": "".join(f'<option value="{side}">{side} x {side} px</option>' for side in sides),
        "features": f"\n<li>Features: {escape(VGG_CREDIT)}.</li>" if features else "",
        "version": RUNTIME_VERSION,
    }
    return re.sub(r"{{([a-z.]+)}}", lambda name: parts[name[1]], _read_page_file("page.html"))


def _read_page_file(name: str) -> str:
    return (resources.files("metapp.extensions.onnx_files") / name).read_text(encoding="utf-8")
