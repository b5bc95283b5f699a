"""A page that runs General of flash photographs in a browser, from disk and offline: a folder of four files."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path

from metapp.extensions.onnx_files.photographs import FEATURES
from metapp.extensions.onnx_files.runtime import VERSION
from metapp.storage.files import write_atomically
from metapp.storage.html import data_script, element, page, write_page

TITLE = "Material maps of a flash photo"
MAPS = {  # what a map is, and how its picture shows it
    "diffuse": "Diffuse: albedo, sRGB",
    "specular": "Specular: F0, sRGB",
    "roughness": "Roughness: linear",
    "normal": "Normal: x right, y up",
}
SIDES = (256, 512, 1024)  # px of photos, of models that take any
MIT = """\
Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions: The above copyright notice
and this permission notice shall be included in all copies or substantial portions of the Software. THE SOFTWARE IS
PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF
MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR COPYRIGHT
HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE,
ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE."""


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
    write_page(page_of(sides, features), folder / "index.html")


def packed(name: str, content: bytes) -> bytes:
    """A script that keeps bytes, compressed, as text under a name."""
    text = base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
    return f'(globalThis.packed ??= {{}}).{name} = "{text}";\n'.encode()


def page_of(sides: Sequence[int], features: bool) -> str:
    """The page; arguments as of `write_folder`."""
    choices = "".join(element("option", f"{each} x {each} px", value=str(each)) for each in sides)
    figures = "".join(_figure(name, title) for name, title in MAPS.items())
    return page(
        TITLE,
        _text("page.css"),
        element("header", element("h1", TITLE), element("p", "By General of metapp. The photo stays on this machine.")),
        "<main>",
        '<label id="drop"><input id="file" type="file" accept="image/*" title="Choose a photo">'
        '<canvas id="photo" width="256" height="256" hidden></canvas>'
        "<span>Choose a photo, or drop one here: a flat surface from above, lit by the flash. "
        "Its central square counts.</span></label>",
        element("div", figures, id="maps"),
        "</main>",
        f'<footer><p id="said" role="status">Loads the model.</p><label>Maps of <select id="side">{choices}</select>'
        '</label><button id="all" type="button" disabled>Save all as PNG</button></footer>',
        _licences(features),
        data_script("about", {"maps": list(MAPS)}),
        *(f'<script src="{name}"></script>' for name in ("ort.js", "runtime.js", "model.js")),
        element("script", _text("page.js")),
    )


def _figure(name: str, title: str) -> str:
    canvas = element("canvas", id=name, width="256", height="256", role="img", aria_label=title)
    save = f'<button type="button" data-map="{name}" disabled>Save PNG</button>'
    return element("figure", canvas, element("figcaption", element("span", escape(title)), save))


def _licences(features: bool) -> str:
    parts = ["metapp and its network: copyright 2026 the metapp authors, MIT licence."]
    if features:
        parts.append(f"Features: {FEATURES}.")
    parts.append(
        f"onnxruntime-web {VERSION}: copyright Microsoft Corporation, MIT licence; of the parts in it: "
        f"ThirdPartyNotices.txt of github.com/microsoft/onnxruntime, v{VERSION}."
    )
    items = element("ul", *(element("li", escape(part)) for part in parts))
    full = element("details", element("summary", "The MIT licence"), element("p", escape(MIT)))
    return element("section", element("h2", "Licences"), items, full, id="licences")


def _text(name: str) -> str:
    return (resources.files("metapp.extensions.onnx_files") / name).read_text(encoding="utf-8")
