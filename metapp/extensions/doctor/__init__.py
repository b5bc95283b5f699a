"""A report on the installation, for the command `metapp doctor`.

`installation` examines it, and `doctor_command` prints the report.
"""
