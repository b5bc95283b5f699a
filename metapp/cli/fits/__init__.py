"""The commands of the paradigms."""
