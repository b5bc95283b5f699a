"""Three small materials as a data set."""

from __future__ import annotations

from tests.evaluation.cli.conftest import data

__all__ = ["data"]
