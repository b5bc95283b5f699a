"""Inputs of fits: from what a user names to tasks.

In order of reading: `finding` tells which format reads a path, `embedded` makes the data sets that metapp draws itself,
`run_inputs` reads tasks of files, data sets and objects in memory. `conversion`, `joining` and `checking` make, join
and verify data sets.
"""
