"""The commands that ship, but for those of the paradigms."""

from metapp.registry import Entry, Registry

_HERE = "metapp.cli"


def register(registry: Registry) -> None:
    """Add them."""
    paradigms = ("general", "overfit", "finetune", "quickft", "meta")
    registry.reserved += [f"commands {name}" for name in (*paradigms, "data")]
    registry.commands["evaluate"] = Entry(f"{_HERE}.evaluate:command")
    registry.commands["export"] = Entry(f"{_HERE}.export:command")
    registry.commands["data synth"] = Entry(f"{_HERE}.data.synth:synth")
    registry.commands["data cornell"] = Entry(f"{_HERE}.data.sets:cornell")
    registry.commands["data join"] = Entry(f"{_HERE}.data.sets:join")
    registry.commands["data check"] = Entry(f"{_HERE}.data.sets:check")
