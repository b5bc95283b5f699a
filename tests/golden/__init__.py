"""Golden values: what fits, tables and readers gave at a commit; a rebuild gives the same."""
