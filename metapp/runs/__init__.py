"""Runs: a request, its plan, its execution, checkpoints, outputs. Nothing here prints, exits or knows typer or rich."""


class BadOption(ValueError):
    """An option or argument that cannot be used as it is given."""
