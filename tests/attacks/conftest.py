"""Fixtures for attacks: commands run in the test's folder."""

from tests.cli.conftest import _work_in_test_folder

__all__ = ["_work_in_test_folder"]
