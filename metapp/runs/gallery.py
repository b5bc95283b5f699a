"""The page of a run of many inputs: a small picture of each fit beside what it should show, its error, what failed."""

from __future__ import annotations

import io
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.runs.naming import caption_of, title_of
from metapp.runs.pictures import to_srgb
from metapp.runs.reporter import number
from metapp.storage.files import write_atomically
from metapp.storage.records import RunFolder, file_name, summary

SIDE = 128  # px, the height of a picture
FOLDER = "thumbnails"
STYLE = """
body { margin: 2rem; font: 15px/1.5 system-ui, sans-serif; color: #1d1d1f; background: #fbfbfa; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(17rem, 1fr)); gap: 1rem; }
figure { margin: 0; padding: .6rem; background: #fff; border: 1px solid #e3e3e0; border-radius: 8px; }
img { max-width: 100%; height: auto; display: block; margin: auto; }
figcaption { font-size: .85rem; overflow-wrap: anywhere; } small, p { color: #5c5f66; }
"""


def write_thumbnail(app: App, task: Task, theta: Params, folder: Path) -> None:
    """Write the picture of a fit, parameters without a task axis, into a run's folder: reference left, fit right."""
    from PIL import Image

    shown = []
    for linear in presentation_of(app).outputs(theta, task).values():
        image = Image.fromarray((np.clip(to_srgb(linear), 0, 1) * 255 + 0.5).astype(np.uint8))
        shown.append(image.resize((max(1, round(SIDE * image.width / image.height)), SIDE), Image.Resampling.BICUBIC))
    strip = Image.new("RGB", (sum(image.width for image in shown) + 4 * (len(shown) - 1), SIDE), "white")
    left = 0
    for image in shown:
        strip.paste(image, (left, 0))
        left += image.width + 4
    buffer = io.BytesIO()
    strip.save(buffer, "PNG")
    write_atomically(folder / FOLDER / f"{file_name(task.name)}.png", lambda file: file.write_bytes(buffer.getvalue()))


def write_gallery(app: App, paradigm: str, folder: RunFolder, failures: Sequence[Any]) -> Path:
    """Write `gallery.html` of all fits of a run's folder, whichever machine made them, those of large errors first.

    Args:
        app: the application.
        paradigm: its name.
        folder: the run's.
        failures: what this program could not fit, with `source` and `reason`.

    Returns:
        The file.
    """
    records = sorted(folder.finished().values(), key=lambda record: (-(record["error"] or 0.0), record["name"]))
    total = summary(records)
    title = escape(f"{title_of(app)}, {paradigm}: {len(records)} fits")
    mean = f"Mean {number(total['error'], '.3f')}, median {total['seconds']:.4g} s a fit; "
    listed = "".join(f"<li>{escape(failure.source)}<br><small>{escape(failure.reason)}</small>" for failure in failures)
    failed = f"<h2>{len(failures)} failed</h2><ul>{listed}</ul>" if failures else ""
    page = (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>"
        f"<h1>{title}</h1><p>{escape(mean + caption_of(app))}. Reference left, fit right; large errors first.</p>"
        f"{failed}<main>{''.join(_figure(record) for record in records)}</main></html>"
    )
    file = folder.path / "gallery.html"
    write_atomically(file, lambda partial: partial.write_text(page, encoding="utf-8", errors="backslashreplace"))
    return file


def _figure(record: dict[str, Any]) -> str:
    name = escape(record["name"])
    error = "" if record["error"] is None else f"error {record['error']:.3f}, "
    warning = f"<br><small>warning: {escape(record['warning'])}</small>" if record.get("warning") else ""
    image = f"<img loading='lazy' src='{FOLDER}/{escape(file_name(record['name']))}.png' alt='{name}'>"
    told = f"{name}<br><small>{error}{record['seconds']:.3g} s</small>{warning}"
    return f"<figure>{image}<figcaption>{told}</figcaption></figure>"
