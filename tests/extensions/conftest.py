"""Fixtures that tests of extensions share with tests of the core's commands."""

from tests.cli.conftest import _work_in_test_folder, fit_networks, networks

__all__ = ["_work_in_test_folder", "fit_networks", "networks"]
