"""Pytest marks for single values of a parametrized test."""

from typing import Any

import pytest


def long(*values: Any) -> Any:
    """Mark values with which a test takes seconds while other values are quicker: `make test-long` runs them."""
    return pytest.param(*values, marks=pytest.mark.long)
