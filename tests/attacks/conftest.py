"""Attacks run commands in the test's folder."""

from tests.cli.conftest import _here

__all__ = ["_here"]
