// Vectors of floats as wide as the CPU's registers. A compiler splits wider vectors and spills them to memory, which is
// 20 to 30 times as slow.
#if defined __AVX512F__
enum { LANES = 16 };
#elif defined __AVX__
enum { LANES = 8 };
#else
enum { LANES = 4 };  // SSE, NEON
#endif
typedef float V __attribute__((vector_size(4 * LANES)));
