"""Readers of files and generators of synthetic data, which turn both into tasks.

`converters` holds the options of the commands that convert files, `readers` one module a file format, and `synthetic`
the generators of each application's data. `random_streams` gives all of them their random numbers.
"""
