"""The facts of a message: tests of commands compare these, not whole sentences."""


def says(text: str, *facts: str) -> bool:
    """Return whether one line of a text holds all of these facts: names, numbers, values, options and commands."""
    return any(all(fact in line for fact in facts) for line in text.splitlines())
