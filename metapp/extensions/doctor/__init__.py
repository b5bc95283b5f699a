"""What this installation has and lacks."""

from metapp.registry import Entry, Registry


def register(registry: Registry) -> None:
    """Add the command."""
    registry.commands["doctor"] = Entry("metapp.extensions.doctor.commands:command")
