"""What tests of benchmarks have of all tests: seeds, an empty cache, Mitsuba, commands, networks."""

from tests.conftest import _caches, _seed, _shared_cache, cache, metapp, mi, neural_fits

__all__ = ["_caches", "_seed", "_shared_cache", "cache", "metapp", "mi", "neural_fits"]
