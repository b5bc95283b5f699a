"""The paper's tables and figures, and the report, made of fits.

Read in this order: `evaluation_run` (reads fits, and makes missing ones), `error_statistics`, `rows`,
`table`, then `tables` (a module for each of the paper's comparisons) and `figures` with `style`. Nothing here
prints: :mod:`metapp.cli.evaluation_output` does.
"""
