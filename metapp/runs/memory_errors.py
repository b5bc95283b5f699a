"""Errors by which memory did not suffice, as lines that say so: each library has other words for them."""

from __future__ import annotations

import re


def describe_short_memory(error: Exception, size: tuple[int, int] | None = None) -> str:
    """Return the line of an error by which memory did not suffice; "" for another error.

    Args:
        error: the error; PyTorch raises a RuntimeError where Python and NumPy raise a MemoryError.
        size: height and width in px of the files that fits write, if a user has chosen them.
    """
    text = str(error)
    is_torch_error = isinstance(error, RuntimeError) and re.search("can't allocate memory|out of memory", text)
    if not (isinstance(error, MemoryError) or is_torch_error):
        return ""
    asked = re.search(r"allocate ([\d.]+) ?(bytes|[KMGT]iB)", text)
    found = f"memory is short: {_format_bytes(asked[1], asked[2])} more are not free" if asked else "memory is short"
    if size is None:
        return f"{found}, expected room for the work; end other programs, or give fewer or smaller inputs at once."
    height, width = (max(1, side // 2) for side in size)
    return f"{found}, expected room for files of {size[0]}x{size[1]} px; --size {height}x{width} takes a quarter of it."


def _format_bytes(number: str, unit: str) -> str:
    """Return a number of bytes in GB, or a number in another unit as it is.

    >>> _format_bytes("3000000000", "bytes"), _format_bytes("2.5", "GiB")
    ('3.0 GB', '2.5 GiB')
    """
    return f"{int(number) / 1e9:.1f} GB" if unit == "bytes" else f"{number} {unit}"
