"""Interactive pages: bytes, seconds of a frame of all pixels, and frames a second while something moves.

    python -m benchmarks.bench_view try/try.html

In headless Chromium, where SwiftShader draws on the processor. Viewers without WebGL draw what changes alone: they are
left out.
"""

from __future__ import annotations

import sys
from pathlib import Path

from metapp.extensions.viewer import viewer_page as pages
from tests.browser import Page, browsing

WINDOW_WIDTH_PX, WINDOW_HEIGHT_PX = 1280, 720
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
    """Print a table."""
    file = Path(sys.argv[1])
    empty = len(pages.viewer_html(pages.page_document("", [])))
    print(f"{file}: {file.stat().st_size / 1e6:.2f} MB, of which {empty / 1e6:.2f} MB are scripts and three.js\n")
    print("| view | frame at rest, ms | resolution while moving | frames/s while moving |")
    print("|---|---|---|---|")
    with browsing() as browser:
        page = Page(browser, file, WINDOW_WIDTH_PX, WINDOW_HEIGHT_PX, adapts=True)
        for i, section in enumerate(page.page.evaluate("DATA.groups.map((group) => group.section)")):
            page.page.evaluate(f"metapp.open({i})")
            page.page.wait_for_timeout(6000)
            if measured := page.page.evaluate(MEASURING_SCRIPT):
                cost, detail, rate = measured
                print(f"| {section} | {cost:.0f} | {detail:.2f} | {rate:.1f} |")


if __name__ == "__main__":
    main()
