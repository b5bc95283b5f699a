"""Downloads of files from the web, with progress and with errors that name the address.

Callers check what arrived, by its hash, and keep it; nothing is written here.
"""

from __future__ import annotations

import http.client
import urllib.request
from collections.abc import Callable

TIMEOUT_SECONDS = 30.0  # without an answer, after which a server is given up
BLOCK_BYTES = 1 << 20  # read at a time


def download(url: str, report: Callable[[int, int | None], None]) -> bytes:
    """Download a file from the web and return its content.

    Args:
        url: the address.
        report: a function that is called after each block with the number of bytes that have arrived and the number of
            all bytes, None if the server does not say it.

    Raises:
        ValueError: the server does not answer, or the connection breaks.
    """
    content = bytearray()
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_SECONDS) as response:
            total = int(response.headers.get("Content-Length") or 0) or None
            while block := response.read(BLOCK_BYTES):
                content += block
                report(len(content), total)
    except (OSError, http.client.HTTPException) as error:
        raise ValueError(f"{url}: {getattr(error, 'reason', None) or error or type(error).__name__}") from None
    return bytes(content)
