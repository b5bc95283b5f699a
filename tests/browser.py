"""Pages in headless Chromium, which draws WebGL by SwiftShader."""

import contextlib
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from metapp.appearance.metrics import ssim

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
ARGUMENTS = (
    "--no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist"
)

# draw at full resolution, however busy this machine is, and labels over pictures
WHOLE = """Object.defineProperty(Viewer.prototype, "strip", { value: false });
DrawnViewer.prototype._details = () => [1, 1];
dispatchEvent(new Event("resize"));"""


@contextlib.contextmanager
def browsing() -> Iterator[Any]:
    """A browser of playwright's; skips the test where there is none."""
    if not CHROMIUM:
        pytest.skip("no Chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'metapp[dev]'")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS.split())
        yield browser
        browser.close()


def assert_alike(
    seen: np.ndarray, wanted: Any, where: Tensor | None = None, *, mean: float = 2 / 255, least: float = 0.97
) -> None:
    """Assert that the screen shows a picture [H, W, 3] of display values, where `where` [H, W] is true.

    To a mean difference of at most `mean` and a structural similarity of `least` or more.
    """
    pair = [torch.as_tensor(np.ascontiguousarray(each)).float() for each in (seen, wanted)]
    mask = torch.ones(pair[0].shape[:2], dtype=torch.bool) if where is None else where
    similar = ssim(*(torch.where(mask[..., None], each, 0.5).permute(2, 0, 1)[None] for each in pair))
    assert float(similar.mean()) >= least
    assert float((pair[0] - pair[1])[mask].abs().mean()) <= mean


LEGEND = 46  # px below differences
# of errors, from none to all
HEAT = np.array([[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]], np.float64) / 255


def false_colours(errors: np.ndarray, most: float) -> np.ndarray:
    """Display values [H, W, 3] of errors [H, W], as pages colour them up to `most`."""
    places = np.clip(errors / most, 0, 1) * 4
    return np.stack([np.interp(places, np.arange(5), HEAT[:, c]) for c in range(3)], -1)


class Page:
    """A page that `metapp view` wrote, opened from disk; `adapts`: it draws fewer pixels where the machine is slow,
    and labels stand above pictures, not over them.

    Attributes:
        page: playwright's.
        problems: errors that the page reported.
    """

    def __init__(
        self, browser: Any, file: Path | str, width: int = 480, height: int = 320, *, adapts: bool = False
    ) -> None:
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("console", self._heard)
        self.page.goto(file.resolve().as_uri() if isinstance(file, Path) else file)
        self.page.evaluate("metapp.ready")
        if not adapts:
            self.page.evaluate(WHOLE)

    def _heard(self, message: Any) -> None:
        if message.type == "error":
            self.problems.append(message.text)

    def sized(self, width: int, height: int) -> None:
        """Give the view a size in px."""
        style = f"position: fixed; left: 0; top: 0; width: {width}px; height: {height}px; min-height: 0"
        self.page.evaluate(f"document.getElementById('stage').style = '{style}'; dispatchEvent(new Event('resize'))")

    def set(self, **settings: Any) -> None:
        """Change settings, as the controls do."""
        for name, value in settings.items():
            self.page.evaluate("([name, value]) => metapp.set(name, value)", [name, value])

    def settle(self, seconds: float = 120) -> None:
        """Wait until the picture does not improve any more."""
        self.page.set_default_timeout(1000 * seconds)
        self.page.evaluate("metapp.settled()")

    def screenshot(self) -> np.ndarray:
        """The view as the screen shows it, [H, W, 3] in [0, 1], without what lies over it."""
        self.page.add_style_tag(content=".label, .lamp, .wipe, .plot { visibility: hidden }")
        picture = Image.open(io.BytesIO(self.page.locator("#stage").screenshot(timeout=120_000)))
        return np.asarray(picture.convert("RGB"), dtype=np.float64) / 255
