"""What the test of a benchmark's own renderer has of all tests: seeds, an empty cache, Mitsuba."""

from tests.conftest import _caches, _seed, _shared_cache, cache, mi

__all__ = ["_caches", "_seed", "_shared_cache", "cache", "mi"]
