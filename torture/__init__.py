"""Attempts to break metapp: mutated files, kills, full disks; `python -m torture`, docs/reliability.md."""
