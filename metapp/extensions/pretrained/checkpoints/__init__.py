"""The checkpoint that ships, and its card."""
