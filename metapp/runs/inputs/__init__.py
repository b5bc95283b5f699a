"""Inputs of fits: from what a user names to tasks.

In order of reading: `finding` tells which format reads a path, `refusals` says why a path is none, and `run_inputs`
reads tasks of files, data sets and objects in memory.
"""
