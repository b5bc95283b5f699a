"""A report on the installation."""
