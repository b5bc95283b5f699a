"""Golden values: stored results of fits, tables and readers, with which later versions are compared."""
