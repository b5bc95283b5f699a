"""The commands that ship, but for those of the paradigms."""

from metapp.door import Command

_HERE = "metapp.cli"

OFFERS = (
    Command("evaluate", f"{_HERE}.evaluate:command"),
    Command("export", f"{_HERE}.export:command"),
    Command("synth", f"{_HERE}.data.synth:synth", under="data", bare_is_help=True),
    Command("cornell", f"{_HERE}.data.sets:cornell", under="data", bare_is_help=True),
    Command("join", f"{_HERE}.data.sets:join", under="data", bare_is_help=True),
    Command("check", f"{_HERE}.data.sets:check", under="data", bare_is_help=True),
)
