"""Steps of learning in C, and by torch, compiled: the same results as the loop by torch, to rounding, but sooner."""
