"""Runs that are over: `metapp rerun` repeats their rows, `metapp compare` puts two side by side."""

from metapp.door import Command

_HERE = "metapp.extensions.reruns"
OFFERS = (
    Command("rerun", f"{_HERE}.rerun_command:command"),
    Command("compare", f"{_HERE}.compare_command:command"),
)
