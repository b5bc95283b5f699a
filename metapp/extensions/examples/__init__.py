"""Commands that work as they are, and the input files that they name."""
