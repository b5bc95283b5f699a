"""The HTML file of a page: fits as JSON, the scripts that show them, and three.js, all in one file.

Pages are opened from disk, where browsers forbid scripts to read other files; so all that a page needs is in it. This
module does not know what views mean.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.extensions.viewer.view import View
from metapp.storage import Document
from metapp.storage.files import write_bytes
from metapp.storage.image_writers import jpeg_data_url, png_data_url, to_8_bit_image

VIEWER_KINDS = ("brdf", "surface", "light", "pictures")  # the viewers; each has a script of its name
_DRAWING_SCRIPTS = ("core", "panes", "shading", "shapes", "overlay", "comparing", "drawing", "framing", "stage")
_SHARED_SCRIPTS = (*_DRAWING_SCRIPTS, "raster", "polar", "relit")
PAGE_SCRIPTS = (*_SHARED_SCRIPTS, *VIEWER_KINDS, "listing", "main")  # in the order in which a page runs them
ARRAY_TYPES = {torch.float16: "float16", torch.float32: "float32", torch.uint8: "uint8"}  # as scripts name them

HTML_HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
"""
HTML_BODY = """<header>
<h1></h1><p class="caption"></p><span class="spacer"></span>
<button id="options" type="button" aria-controls="controls" aria-expanded="false">Controls</button>
<button id="save" type="button" title="Save this view as PNG, with its labels">Save PNG</button>
<button id="help" type="button" title="Keys and pointer" aria-label="Help: keys and pointer">?</button>
</header>
<main>
<nav aria-label="Fits"></nav>
<section id="stage" aria-label="View"><p class="problem" hidden></p></section>
<form id="controls" aria-label="Controls"></form>
</main>
<footer><span class="said" role="status"></span><output class="numbers"></output></footer>
<noscript>This page draws with WebGL 2 and needs JavaScript.</noscript>"""


class FitGroup(NamedTuple):
    """A group of fits of one task, which one viewer shows side by side.

    Attributes:
        title: the name of the task.
        section: the heading in the list of fits, such as the title of the application.
        views: the views of one fit or more.
    """

    title: str
    section: str
    views: Sequence[View]


def page_document(title: str, groups: Sequence[FitGroup]) -> Document:
    """Return the content of a page as the document that its scripts read."""
    shared: dict[str, Document] = {}
    documents: list[Document] = []
    for group in groups:
        fits: list[Document] = []
        for view in group.views:
            shared |= {name: encode_array(values) for name, values in view.shared.items() if name not in shared}
            arrays = {name: encode_array(values) for name, values in view.arrays.items()}
            pictures = {
                name: encode_picture(pixels, lossy=name in view.lossy) for name, pixels in view.pictures.items()
            }
            thumbnail = "" if view.thumbnail is None else encode_picture(view.thumbnail)
            fits.append({"label": view.label, "caption": view.caption, "facts": dict(view.facts), "arrays": arrays,
                         "pictures": pictures, "thumbnail": thumbnail})  # fmt: skip
        kind = group.views[0].kind
        documents.append({"title": group.title, "section": group.section, "kind": kind, "fits": fits})
    return {"title": title, "groups": documents, "shared": shared}


def encode_array(values: Tensor) -> Document:
    """Return an array as text, deflated and in base64, with its type and shape."""
    content = zlib.compress(values.detach().cpu().contiguous().numpy().tobytes(), 6)
    return {"type": ARRAY_TYPES[values.dtype], "shape": list(values.shape), "data": base64.b64encode(content).decode()}


def encode_picture(pixels: Tensor, *, lossy: bool = False) -> str:
    """Return display values [H, W, 1, 3 or 4] in [0, 1] in a URL that holds a PNG of 8 bits, or a JPEG if lossy."""
    image = to_8_bit_image(pixels.detach().cpu().numpy())
    return jpeg_data_url(image) if lossy else png_data_url(image)


def viewer_html(data: Document) -> str:
    """Return the HTML of a page.

    Args:
        data: the content of the page, see :func:`page_document`.

    Raises:
        ValueError: a number in it is not finite.
    """
    facets = (resources.files("metapp.appearance") / "facets.hlsl").read_text(encoding="utf-8").replace("NAME_", "")
    scripts = [
        f"const FACETS = {json.dumps(facets)};",
        *(_read_page_file(f"scripts/{name}.js") for name in PAGE_SCRIPTS),
    ]
    content = json.dumps(data, allow_nan=False).replace("<", "\\u003c")  # no text can end the script
    lines = [
        f"{HTML_HEAD}<title>{escape(data['title'])}</title>",
        f"<style>{_read_page_file('page.css')}</style>",
        f"</head>\n<body>\n{HTML_BODY}",
        f"<script>{_read_page_file('three.min.js')}</script>",
        f'<script type="application/json" id="data">{content}</script>',
        *("<script>", *scripts, "</script>"),
        "</body>\n</html>\n",
    ]
    return "\n".join(lines)


def write_page(title: str, groups: Sequence[FitGroup], path: Path) -> Path:
    """Write a page of fits, whole or not at all, and return its path.

    Args:
        title: the title of the page.
        groups: the fits, in the order of the list.
        path: the HTML file.

    Raises:
        OSError: the file cannot be written.
    """
    text = viewer_html(page_document(title, groups))
    write_bytes(path, text.encode(errors="backslashreplace"))
    return path


def _read_page_file(name: str) -> str:
    return (resources.files("metapp.extensions.viewer") / name).read_text(encoding="utf-8")
