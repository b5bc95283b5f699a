"""A mark for tests that render with Mitsuba: they are skipped where there is no libLLVM that Mitsuba can use."""

import pytest

from metapp.rendering.variant import choose_llvm

try:
    choose_llvm()  # before any test runs, since the first import of Mitsuba decides which libLLVM it loads
    REASON_TO_SKIP = ""
except ValueError as error:
    REASON_TO_SKIP = str(error)
needs_mitsuba = pytest.mark.skipif(bool(REASON_TO_SKIP), reason=REASON_TO_SKIP)


def skip_without_mitsuba() -> None:
    """Skip the test whose fixture calls this where Mitsuba has no libLLVM."""
    if REASON_TO_SKIP:
        pytest.skip(REASON_TO_SKIP)
