"""Readers and writers of files, one module a kind of file."""
