"""Commands that work as they are, and the input files that they name."""

from metapp.registry import Entry, Registry


def register(registry: Registry) -> None:
    """Add the command."""
    registry.commands["examples"] = Entry("metapp.extensions.examples.commands:command")
