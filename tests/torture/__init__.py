"""Attempts to break metapp: mutated files, kills, full disks; `python -m tests.torture`, docs/reliability.md."""
