"""What tests of extensions share with those of the core's commands."""

from tests.cli.conftest import _here, fitted, networks

__all__ = ["_here", "fitted", "networks"]
