"""Marks of single values of a parametrized test."""

from typing import Any

import pytest


def long(*values: Any) -> Any:
    """Values with which a test takes seconds, beside others with which it is quicker: run by `make test-long`."""
    return pytest.param(*values, marks=pytest.mark.long)
