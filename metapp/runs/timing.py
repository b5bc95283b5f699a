"""Times as people write them."""

from __future__ import annotations

import re

from metapp.runs import BadOption

UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


def seconds_of(text: str) -> float | None:
    """Seconds of a time such as 50ms, 2s or 1.5min; None of "".

    Raises:
        BadOption: it is no time above 0.
    """
    if not text:
        return None
    found = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?|\.\d{1,9}) ?(ms|s|min|h)", text.strip())
    seconds = round(float(found[1]) * UNITS[found[2]], 9) if found else 0.0
    if not seconds:
        raise BadOption(f"--budget '{text}': expected a time above 0 with its unit (ms, s, min or h), such as 50ms.")
    return seconds


def said_time(seconds: float) -> str:
    """A time as `seconds_of` reads it: 50ms, 2s, 1.5min."""
    unit = max((unit for unit in UNITS if UNITS[unit] <= max(seconds, 1e-3)), key=UNITS.__getitem__)
    return f"{seconds / UNITS[unit]:.4g}{unit}"
