"""Take pictures of interactive pages for the documents: python tools/screens.py try/try.html docs [NAME[:TASK]...].

The page is the one of `metapp try`, or of any run if names and perhaps tasks are given. It needs Chromium and
playwright.
"""

from __future__ import annotations

import io
import json
import sys
import time
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.browser import Page, open_browser

SCREEN_WIDTH_PX, SCREEN_HEIGHT_PX, JPEG_QUALITY = 1120, 660, 82
MAX_PICTURE_SECONDS = 90.0  # that a page may take to refine a picture
# names of pictures by the title of an application in pages
PICTURE_NAMES = {
    "BRDF": "brdf",
    "Illumination (reference)": "illumination",
    "svBRDF non-stat. (photo)": "svbrdf-nonstationary",
    "svBRDF stat.": "svbrdf-stationary",
    "Texture": "texture",
    "Transport": "transport",
}


def main() -> None:
    """Write view-<name>.jpg of each application, as its page opens."""
    file, out = Path(sys.argv[1]), Path(sys.argv[2])
    task_by_name = dict(word.partition(":")[::2] for word in sys.argv[3:] or PICTURE_NAMES.values())
    with open_browser() as browser:
        page = Page(browser, file, SCREEN_WIDTH_PX, SCREEN_HEIGHT_PX, adapts=True)
        groups = page.page.evaluate("DATA.groups.map((group) => [group.section, group.title])")
        for section, name in PICTURE_NAMES.items():
            if name not in task_by_name:
                continue
            task = task_by_name[name]
            group_index = next(
                i for i, (group_section, title) in enumerate(groups) if group_section == section and task in ("", title)
            )
            page.page.evaluate(f"metapp.open({group_index})")
            begin = time.monotonic()
            page.page.evaluate(
                f"Promise.race([metapp.settled(), new Promise((r) => setTimeout(r, {1000 * MAX_PICTURE_SECONDS}))])"
            )
            print(name, f"{time.monotonic() - begin:.1f} s", json.dumps(page.problems))
            picture = Image.open(io.BytesIO(page.page.screenshot(timeout=120_000))).convert("RGB")
            picture.save(out / f"view-{name}.jpg", quality=JPEG_QUALITY, optimize=True)


if __name__ == "__main__":
    main()
