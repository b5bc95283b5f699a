"""Pages of `metapp view` in headless Chromium, which draws WebGL in software, for tests and screenshots."""

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

# pages draw fewer pixels on slow machines, and labels in a strip; here at full resolution, and labels over pictures
DRAW_AT_FULL_RESOLUTION = """Object.defineProperty(Viewer.prototype, "strip", { value: false });
DrawnViewer.prototype._details = () => [1, 1];
dispatchEvent(new Event("resize"));"""


@contextlib.contextmanager
def open_browser() -> Iterator[Any]:
    """Open Chromium by playwright; skip the test if either is missing."""
    if not CHROMIUM:
        pytest.skip("no Chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'metapp[dev]'")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS.split())
        yield browser
        browser.close()


def assert_pictures_match(
    screen: np.ndarray,
    expected: Any,
    where: Tensor | None = None,
    *,
    most_mean_difference: float = 2 / 255,
    least_similarity: float = 0.97,
) -> None:
    """Assert that a screenshot [H, W, 3] shows the expected picture [H, W, 3] of display values.

    Args:
        screen: the screenshot, in [0, 1].
        expected: the picture, in [0, 1].
        where: the pixels that count, bool [H, W]; None: all.
        most_mean_difference: the mean absolute difference allowed.
        least_similarity: the mean structural similarity required.
    """
    pair = [torch.as_tensor(np.ascontiguousarray(picture)).float() for picture in (screen, expected)]
    mask = torch.ones(pair[0].shape[:2], dtype=torch.bool) if where is None else where
    similar = ssim(*(torch.where(mask[..., None], picture, 0.5).permute(2, 0, 1)[None] for picture in pair))
    assert float(similar.mean()) >= least_similarity
    assert float((pair[0] - pair[1])[mask].abs().mean()) <= most_mean_difference


LEGEND_PX = 46  # height of the legend below difference pictures
# colours of the page for errors from 0 to the largest
ERROR_COLOURS = np.array([[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]], np.float64) / 255


def error_colours(errors: np.ndarray, largest_error: float) -> np.ndarray:
    """Return display values [H, W, 3] for errors [H, W], as pages colour them up to the largest error."""
    places = np.clip(errors / largest_error, 0, 1) * 4
    return np.stack([np.interp(places, np.arange(5), ERROR_COLOURS[:, c]) for c in range(3)], -1)


class Page:
    """A page that `metapp view` wrote, opened in a browser.

    Attributes:
        page: the page object of playwright.
        problems: errors that the page reported.
    """

    def __init__(
        self, browser: Any, file: Path | str, width: int = 480, height: int = 320, *, adapts: bool = False
    ) -> None:
        """Open a file, or an address, in a window of a size in px.

        With `adapts` the page draws fewer pixels where the machine is slow, and labels above pictures, as for users.
        """
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("console", self._record_message)
        self.page.goto(file.resolve().as_uri() if isinstance(file, Path) else file)
        self.page.evaluate("metapp.ready")
        if not adapts:
            self.page.evaluate(DRAW_AT_FULL_RESOLUTION)

    def _record_message(self, message: Any) -> None:
        if message.type == "error":
            self.problems.append(message.text)

    def resize(self, width: int, height: int) -> None:
        """Set the size of the view in px."""
        style = f"position: fixed; left: 0; top: 0; width: {width}px; height: {height}px; min-height: 0"
        self.page.evaluate(f"document.getElementById('stage').style = '{style}'; dispatchEvent(new Event('resize'))")

    def set(self, **settings: Any) -> None:
        """Change settings, as the controls do."""
        for name, value in settings.items():
            self.page.evaluate("([name, value]) => metapp.set(name, value)", [name, value])

    def settle(self, seconds: float = 120) -> None:
        """Wait until the page has finished drawing."""
        self.page.set_default_timeout(1000 * seconds)
        self.page.evaluate("metapp.settled()")

    def screenshot(self) -> np.ndarray:
        """Return the view as the screen shows it, [H, W, 3] in [0, 1], without labels, lamp, handle and plots."""
        self.page.add_style_tag(content=".label, .lamp, .wipe, .plot { visibility: hidden }")
        picture = Image.open(io.BytesIO(self.page.locator("#stage").screenshot(timeout=120_000)))
        return np.asarray(picture.convert("RGB"), dtype=np.float64) / 255
