"""The cache folder: files that can be had again, by a download or by computing."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """METAPP_CACHE if set, else the user's cache folder of this system."""
    import platformdirs

    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))
