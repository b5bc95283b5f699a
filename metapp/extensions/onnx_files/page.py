"""A page that runs General of flash photographs in a browser, from disk and offline: a folder of four files."""

from __future__ import annotations

import base64
import gzip
import re
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from metapp.extensions.onnx_files.photographs import FEATURES
from metapp.extensions.onnx_files.runtime import VERSION
from metapp.storage.files import write_atomically, write_bytes

SIDES = (256, 512, 1024)  # px of photos, of models that take any


def write_folder(folder: Path, model: bytes, parts: dict[str, bytes], sides: Sequence[int], *, features: bool) -> None:
    """Write index.html, and beside it the scripts that hold onnxruntime-web and the model; the page comes last.

    A page from disk may not read other files, but it may name scripts: so all that is no script is text in one.

    Args:
        folder: made if missing.
        model: the ONNX file of `photographs.photographs_model`.
        parts: of `runtime.runtime`.
        sides: of the photos in px that the model takes and a user chooses from.
        features: whether it reads those of VGG-16.

    Raises:
        OSError: they cannot be written.
    """
    files = {
        "ort.js": parts["script"],
        "runtime.js": packed("wasm", parts["wasm"]) + packed("module", parts["module"]),
        "model.js": packed("model", model),
    }
    for name, content in files.items():
        write_atomically(folder / name, lambda partial, content=content: partial.write_bytes(content))  # type: ignore[misc]
    page = page_of(sides, features)
    write_bytes(folder / "index.html", page.encode())


def packed(name: str, content: bytes) -> bytes:
    """A script that keeps bytes, compressed, as text under a name."""
    text = base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
    return f'(globalThis.packed ??= {{}}).{name} = "{text}";\n'.encode()


def page_of(sides: Sequence[int], features: bool) -> str:
    """The page; arguments as of `write_folder`."""
    parts = {
        "page.css": _text("page.css"),
        "page.js": _text("page.js"),
        "sides": "".join(f'<option value="{side}">{side} x {side} px</option>' for side in sides),
        "features": f"\n<li>Features: {escape(FEATURES)}.</li>" if features else "",
        "version": VERSION,
    }
    return re.sub(r"{{([a-z.]+)}}", lambda name: parts[name[1]], _text("page.html"))


def _text(name: str) -> str:
    return (resources.files("metapp.extensions.onnx_files") / name).read_text(encoding="utf-8")
