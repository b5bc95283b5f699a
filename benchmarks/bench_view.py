"""Interactive pages: bytes, seconds of a frame of all pixels, and frames a second while something moves.

    python -m benchmarks.bench_view try/try.html

The pages run in headless Chromium, where SwiftShader draws on the processor. Viewers without WebGL are left out, since
they draw only what changes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from metapp.extensions.viewer import viewer_page as pages
from tests.browser import Page, open_browser

WINDOW_WIDTH_PX, WINDOW_HEIGHT_PX = 1280, 720
# returns milliseconds of a frame at rest, the resolution while moving and frames a second while moving, or null
MEASURING_SCRIPT = """async () => {
  const viewer = metapp.viewer;
  if (!viewer.renderer) return null;
  const still = viewer.cost;
  viewer.moving(true);
  const before = metapp.drawn, begin = performance.now();
  while (performance.now() - begin < 5000) {
    viewer.restart();
    await new Promise((done) => requestAnimationFrame(done));
  }
  const seconds = (performance.now() - begin) / 1000;
  return [still, viewer.detail, (metapp.drawn - before) / seconds];
}"""


def main() -> None:
    """Print the table as Markdown, row by row."""
    file = Path(sys.argv[1])
    empty_bytes = len(pages.viewer_html(pages.page_document("", [])))
    print(f"{file}: {file.stat().st_size / 1e6:.2f} MB, of which {empty_bytes / 1e6:.2f} MB are scripts and three.js\n")
    print("| view | frame at rest, ms | resolution while moving | frames/s while moving |")
    print("|---|---|---|---|")
    with open_browser() as browser:
        page = Page(browser, file, WINDOW_WIDTH_PX, WINDOW_HEIGHT_PX, adapts=True)
        for index, section in enumerate(page.page.evaluate("DATA.groups.map((group) => group.section)")):
            page.page.evaluate(f"metapp.open({index})")
            page.page.wait_for_timeout(6000)
            if figures := page.page.evaluate(MEASURING_SCRIPT):
                cost, resolution, rate = figures
                print(f"| {section} | {cost:.0f} | {resolution:.2f} | {rate:.1f} |")


if __name__ == "__main__":
    main()
