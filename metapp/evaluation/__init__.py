"""The paper's tables and figures, and the report, made of records of fits.

Read in this order: `evaluation_run` (an evaluation reads records, and fits what has none), `error_statistics`, `rows`,
`table`, then `tables` (a module for each of the paper's comparisons) and `figures` with `style`. Nothing here
prints: :mod:`metapp.cli.evaluation_output` does.
"""
