"""`metapp compare`: two runs side by side."""

from metapp.registry import Entry, Registry


def register(registry: Registry) -> None:
    """Add the command."""
    registry.commands["compare"] = Entry("metapp.extensions.compare.command:command")
