"""Runs side by side, for the command `metapp compare`.

`comparison` reads and compares runs and draws their picture, `side_by_side` makes the table, and `compare_command` is
the command.
"""
