"""Files of the web."""

from __future__ import annotations

import http.client
import urllib.request
from collections.abc import Callable

TIMEOUT_SECONDS, BLOCK_BYTES = 30.0, 1 << 20  # until a silent server is given up; bytes that are read at a time


def download(url: str, report: Callable[[int, int | None], None]) -> bytes:
    """Return the content of a file of the web.

    Args:
        url: its address.
        report: gets the number of bytes that are there and of those expected, None if unknown, as they come.

    Raises:
        ValueError: no answer, or the connection breaks.
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
