"""Pictures of interactive pages, for the documents: python tools/screens.py try/try.html docs [NAME[:TASK]...].

The page is that of `metapp try`, or of any run where names and perhaps tasks are given. Needs Chromium and playwright.
"""

from __future__ import annotations

import io
import json
import sys
import time
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.browser import Page, browsing

WIDTH, HEIGHT, QUALITY = 1120, 660, 82
SECONDS = 90.0  # that a picture may improve, at most
# by the application's title as pages have it: what is set, in order
VIEWS = {
    "BRDF": {"light": "map", "behind": True, "show": "wipe", "exposure": -0.4},
    "Illumination (reference)": {"view": "free", "behind": True},
    "svBRDF non-stat. (photo)": {"shape": "plane", "relief": 1.5, "exposure": 0.3},
    "svBRDF stat.": {"shape": "cloth", "light": "map", "repeats": 1, "exposure": 1.0},
    "Texture": {"tiles": 2},
    "Transport": {"show": "all"},
}
NAMES = ("brdf", "illumination", "svbrdf-nonstationary", "svbrdf-stationary", "texture", "transport")


def main() -> None:
    """Write view-<name>.jpg of each application."""
    file, out = Path(sys.argv[1]), Path(sys.argv[2])
    wanted = dict(each.partition(":")[::2] for each in sys.argv[3:] or NAMES)
    with browsing() as browser:
        page = Page(browser, file, WIDTH, HEIGHT, adapts=True)
        groups = page.page.evaluate("DATA.groups.map((group) => [group.section, group.title])")
        for name, (section, settings) in zip(NAMES, VIEWS.items(), strict=True):
            if name not in wanted:
                continue
            task = wanted[name]
            which = next(i for i, (of, title) in enumerate(groups) if of == section and task in ("", title))
            page.page.evaluate(f"metapp.open({which})")
            page.set(**settings)
            begin = time.monotonic()
            page.page.evaluate(f"Promise.race([metapp.settled(), new Promise((r) => setTimeout(r, {1000 * SECONDS}))])")
            print(name, f"{time.monotonic() - begin:.1f} s", json.dumps(page.problems))
            picture = Image.open(io.BytesIO(page.page.screenshot(timeout=120_000))).convert("RGB")
            picture.save(out / f"view-{name}.jpg", quality=QUALITY, optimize=True)


if __name__ == "__main__":
    main()
