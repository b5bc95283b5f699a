"""The mark of tests that render: they are skipped where there is no libLLVM that Mitsuba can take."""

import pytest

from metapp.rendering.variant import choose_llvm

try:
    choose_llvm()  # while the tests are collected: whichever of them first imports Mitsuba decides which it takes
    MISSING = ""
except ValueError as error:
    MISSING = str(error)
needs_mitsuba = pytest.mark.skipif(bool(MISSING), reason=MISSING)


def skip_without_mitsuba() -> None:
    """For fixtures that need it."""
    if MISSING:
        pytest.skip(MISSING)
