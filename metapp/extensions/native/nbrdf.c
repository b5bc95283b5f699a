// The loss of the NBRDF network (6-21-21-3, ReLU, exp(.) - 1), its gradient, and the derivatives of the gradient along
// a direction.
//
// Samples lie side by side, LANES in a vector; a block of samples stays in the cache from inputs to gradients. Each
// product of a layer is a function of fixed size, which compiles fast and keeps its sums in registers.
#include <math.h>
#include <string.h>

#include "vectors.h"

enum { BLOCK = 128, VECTORS = BLOCK / LANES, IN = 6, HIDDEN = 21, OUT = 3, KNOTS = 8 };
// Sums that are kept in registers, 3 x 4: with 3 weights and a vector they fill the 16 registers of AVX and SSE
enum { ROWS = 3, ACROSS = 4 };
// Offsets of weights and biases in the flat parameters
enum { W1 = 0, B1 = W1 + HIDDEN * IN, W2 = B1 + HIDDEN, B2 = W2 + HIDDEN * HIDDEN, W3 = B2 + HIDDEN };
enum { B3 = W3 + OUT * HIDDEN, WEIGHTS = B3 + OUT };
#define QUARTER_TURN 1.57079632679f
#define INLINE static inline __attribute__((always_inline))
#define ALONE static __attribute__((noinline))

typedef int I __attribute__((vector_size(4 * LANES)));
typedef float Four __attribute__((vector_size(16)));  // as wide as V on the narrowest CPUs
typedef V Row[VECTORS];  // one number for each sample of a block

// Functions of vectors, accurate to two units in the last place

INLINE V splat(float x) { return x - (V){0}; }
INLINE V pick(I mask, V yes, V no) { return (V)(((I)yes & mask) | ((I)no & ~mask)); }

INLINE V root(V x) {
  for (int l = 0; l < LANES; l++) x[l] = sqrtf(x[l]);
  return x;
}

// Return exp(x) - 1: x = n log 2 + r, and a polynomial in r (Cephes); not finite from x = 88.4 on
INLINE V exp_minus_1(V x) {
  x = pick(x > 89.0f, splat(89.0f), pick(x < -87.0f, splat(-87.0f), x));
  V n = x * 1.44269504f + 12582912.0f - 12582912.0f;  // the nearest whole number
  V r = x - n * 0.693359375f + n * 2.12194440e-4f;
  V p = 1.9875691500e-4f * r + 1.3981999507e-3f;
  p = p * r + 8.3334519073e-3f, p = p * r + 4.1665795894e-2f;
  p = p * r + 1.6666665459e-1f, p = p * r + 5.0000001201e-1f;
  V scale = (V)((__builtin_convertvector(n, I) + 127) << 23);
  return scale * (p * r * r + r) + (scale - 1.0f);
}

// Return log(1 + u): 1 + u = 2^n (1 + f), where f is u itself if u is small, and a polynomial in f (Cephes)
INLINE V log_1_plus(V u) {
  I exponent = ((I)(u + 1.0f) - 0x3f3504f3) >> 23;
  V shrink = (V)((127 - exponent) << 23), f = u * shrink + (shrink - 1.0f), n = __builtin_convertvector(exponent, V);
  V p = 7.0376836292e-2f * f - 1.1514610310e-1f, square = f * f;
  p = p * f + 1.1676998740e-1f, p = p * f - 1.2420140846e-1f, p = p * f + 1.4249322787e-1f;
  p = p * f - 1.6668057665e-1f, p = p * f + 2.0000714765e-1f, p = p * f - 2.4999993993e-1f;
  p = p * f + 3.3333331174e-1f;
  V result = n * 0.693359375f + (f - 0.5f * square + (p * f * square - n * 2.12194440e-4f));
  return pick(u > -1.0f, result, splat(-INFINITY));
}

// Return arccos(x), x clamped to [-1, 1], by arcsin on [0, 1/2] (Cephes)
INLINE V arc_cosine(V x) {
  V a = pick(x < 0.0f, -x, x);
  a = pick(a > 1.0f, splat(1.0f), a);
  I large = a > 0.5f;
  V z = pick(large, 0.5f * (1.0f - a), a * a), s = pick(large, root(z), a);
  V p = 4.2163199048e-2f * z + 2.4181311049e-2f;
  p = p * z + 4.5470025998e-2f, p = p * z + 7.4953002686e-2f, p = p * z + 1.6666752422e-1f;
  V arc = p * z * s + s, result = pick(large, 2.0f * arc, QUARTER_TURN - arc);
  return pick(x < 0.0f, 2 * QUARTER_TURN - result, result);
}

// Products of a layer

// Compute out[o] = start + sum over i of w[o * row + i * column] x[i], where start is a bias, 0, or, if more is set,
// the value that out holds. Results are 0 where a ReLU is closed: the ReLU whose outputs are `open`, or, if open is
// out, the ReLU of the results themselves; none if open is 0. NaN stays NaN.
INLINE void multiply(int outs, int ins, int row, int column, const float *w, const float *bias, int more, Row *x,
                     Row *out, Row *open) {
  for (int o = 0; o < outs; o += ROWS)
    for (int v = 0; v < VECTORS; v += ACROSS) {
      V sum[ROWS][ACROSS];
      for (int a = 0; a < ROWS; a++)
        for (int b = 0; b < ACROSS; b++) sum[a][b] = more ? out[o + a][v + b] : splat(bias ? bias[o + a] : 0);
      for (int i = 0; i < ins; i++) {
        V weight[ROWS];
        for (int a = 0; a < ROWS; a++) weight[a] = splat(w[(o + a) * row + i * column]);
        for (int b = 0; b < ACROSS; b++)
          for (int a = 0; a < ROWS; a++) sum[a][b] += weight[a] * x[i][v + b];
      }
      if (open == out)
        for (int a = 0; a < ROWS; a++)
          for (int b = 0; b < ACROSS; b++) sum[a][b] = pick(sum[a][b] < 0.0f, splat(0), sum[a][b]);
      else if (open)
        for (int a = 0; a < ROWS; a++)
          for (int b = 0; b < ACROSS; b++) sum[a][b] = pick(open[o + a][v + b] > 0.0f, sum[a][b], splat(0));
      for (int a = 0; a < ROWS; a++)
        for (int b = 0; b < ACROSS; b++) out[o + a][v + b] = sum[a][b];
    }
}

// Add to sums[o][i] the sum over the block of d[o] x[i]
INLINE void outer(int outs, int ins, Row *d, Row *x, V *sums) {
  for (int o = 0; o < outs; o += ROWS)
    for (int i = 0; i < ins; i += ROWS) {
      V sum[ROWS][ROWS];
      for (int a = 0; a < ROWS; a++)
        for (int b = 0; b < ROWS; b++) sum[a][b] = sums[(o + a) * ins + i + b];
      for (int v = 0; v < VECTORS; v++)
        for (int a = 0; a < ROWS; a++)
          for (int b = 0; b < ROWS; b++) sum[a][b] += d[o + a][v] * x[i + b][v];
      for (int a = 0; a < ROWS; a++)
        for (int b = 0; b < ROWS; b++) sums[(o + a) * ins + i + b] = sum[a][b];
    }
}

#define MULTIPLY(name, outs, ins, row, column)                                                \
  ALONE void name(const float *w, const float *bias, int more, Row *x, Row *out, Row *open) { \
    multiply(outs, ins, row, column, w, bias, more, x, out, open);                           \
  }
MULTIPLY(layer_1, HIDDEN, IN, IN, 1)
MULTIPLY(layer_2, HIDDEN, HIDDEN, HIDDEN, 1)
MULTIPLY(layer_3, OUT, HIDDEN, HIDDEN, 1)
MULTIPLY(back_2, HIDDEN, HIDDEN, 1, HIDDEN)
MULTIPLY(back_3, HIDDEN, OUT, 1, HIDDEN)

#define OUTER(name, outs, ins) \
  ALONE void name(Row *d, Row *x, V *sums) { outer(outs, ins, d, x, sums); }
OUTER(outer_1, HIDDEN, IN)
OUTER(outer_2, HIDDEN, HIDDEN)
OUTER(outer_3, OUT, HIDDEN)

INLINE void total(int rows, Row *d, V *sums) {
  for (int o = 0; o < rows; o++)
    for (int v = 0; v < VECTORS; v++) sums[o] += d[o][v];
}

INLINE float reduced(const V *x) {
  const Four *p = (const Four *)x;
  Four sum = p[0];
  for (int i = 1; i < LANES / 4; i++) sum += p[i];
  return (sum[0] + sum[2]) + (sum[1] + sum[3]);
}

// The samples of a task, and a block of them in the network, which both functions of the library share

typedef struct {
  const float *where, *target;  // [IN + 1, count], [OUT, count]
  float smoothing;              // s of sqrt(d^2 + s^2) - s; below 0 for the plain absolute difference
  const float *knots;           // [KNOTS] log weights of samples at knots over theta_h, or none
  int count;
} Samples;

typedef struct {
  Row in[IN], one[HIDDEN], two[HIDDEN], out[OUT], cosine, target[OUT], weight, hat[KNOTS];
} Block;

INLINE Samples samples_of(int t, int count, const float *where, const float *target, const float *smoothing,
                          int smoothing_by_task, const float *knots, int knots_by_task) {
  return (Samples){where + (long)t * (IN + 1) * count, target + (long)t * OUT * count,
                   smoothing ? expf(smoothing[t * smoothing_by_task]) : -1, knots ? knots + t * knots_by_task : 0,
                   count};
}

INLINE void read(Row to, const float *from, int count) {
  memset(to, 0, sizeof(Row)), memcpy(to, from, count * sizeof(float));
}

// Evaluate the network on the block that begins at sample `at`; places beyond the last sample have the weight 0
ALONE void forward(const float *theta, const Samples *s, int at, Block *b) {
  int n = s->count, count = n - at < BLOCK ? n - at : BLOCK;
  for (int i = 0; i < IN; i++) read(b->in[i], s->where + i * n + at, count);
  read(b->cosine, s->where + IN * n + at, count);
  for (int c = 0; c < OUT; c++) read(b->target[c], s->target + c * n + at, count);
  for (int v = 0; v < VECTORS; v++)
    for (int l = 0; l < LANES; l++) b->weight[v][l] = v * LANES + l < count ? 1.0f / (OUT * n) : 0.0f;
  if (s->knots)
    for (int v = 0; v < VECTORS; v++) {
      V position = arc_cosine(b->in[2][v]) * ((KNOTS - 1) / QUARTER_TURN), logarithm = splat(0);
      for (int k = 0; k < KNOTS; k++) {
        V away = position - (float)k, hat = 1.0f - pick(away < 0.0f, -away, away);
        b->hat[k][v] = pick(hat > 0.0f, hat, splat(0));
        logarithm += s->knots[k] * b->hat[k][v];
      }
      b->weight[v] *= exp_minus_1(logarithm) + 1.0f;
    }
  layer_1(theta + W1, theta + B1, 0, b->in, b->one, b->one);
  layer_2(theta + W2, theta + B2, 0, b->one, b->two, b->two);
  layer_3(theta + W3, theta + B3, 0, b->two, b->out, 0);
}

// The comparison of an output with its target: the norm of the difference d = log(1 + f) - target, where
// f = cosine (exp(out) - 1). q is the derivative of log(1 + f) in out, with the derivative q (1 - q); slope and bend
// are the first and second derivative of the norm in d, and by_log is its derivative in d and log s.
typedef struct {
  V q, norm, slope, bend, by_log;
} Compared;

INLINE Compared compare(const Block *b, int c, int v, float s) {
  V f = exp_minus_1(b->out[c][v]) * b->cosine[v], q = (f + b->cosine[v]) / (1.0f + f);
  V d = log_1_plus(f) - b->target[c][v];
  if (s < 0) {
    V sign = pick(d > 0.0f, splat(1), pick(d < 0.0f, splat(-1), d));
    return (Compared){q, d * sign, sign, splat(0), splat(0)};
  }
  V length = root(d * d + s * s), inverse = 1.0f / length, slope = d * inverse, square = s * s * inverse * inverse;
  return (Compared){q, length - s, slope, square * inverse, -slope * square};
}

// Compute gradients [T, WEIGHTS] and losses [T]. smoothing holds log s; a stride is 0 where tasks share smoothing or
// knots
void nbrdf_gradient(int tasks, int count, const float *theta, const float *where, const float *target,
                    const float *smoothing, int smoothing_by_task, const float *knots, int knots_by_task,
                    float *gradient, float *losses) {
  for (int t = 0; t < tasks; t++, theta += WEIGHTS, gradient += WEIGHTS) {
    Samples s = samples_of(t, count, where, target, smoothing, smoothing_by_task, knots, knots_by_task);
    V sums[WEIGHTS], loss = splat(0);
    memset(sums, 0, sizeof sums);
    for (int at = 0; at < count; at += BLOCK) {
      Block b;
      Row d3[OUT], d2[HIDDEN], d1[HIDDEN];  // derivatives of the loss in what goes into a layer's ReLU
      forward(theta, &s, at, &b);
      for (int c = 0; c < OUT; c++)
        for (int v = 0; v < VECTORS; v++) {
          Compared by = compare(&b, c, v, s.smoothing);
          loss += b.weight[v] * by.norm, d3[c][v] = b.weight[v] * by.slope * by.q;
        }
      back_3(theta + W3, 0, 0, d3, d2, b.two);
      back_2(theta + W2, 0, 0, d2, d1, b.one);
      outer_3(d3, b.two, sums + W3), total(OUT, d3, sums + B3);
      outer_2(d2, b.one, sums + W2), total(HIDDEN, d2, sums + B2);
      outer_1(d1, b.in, sums + W1), total(HIDDEN, d1, sums + B1);
    }
    for (int i = 0; i < WEIGHTS; i++) gradient[i] = reduced(sums + i);
    losses[t] = reduced(&loss);
  }
}

// Compute the derivatives of the product gradient . along in theta [T, WEIGHTS], in log s [T] and in the knots
// [T, KNOTS]
void nbrdf_product(int tasks, int count, const float *theta, const float *where, const float *target,
                   const float *smoothing, int smoothing_by_task, const float *knots, int knots_by_task,
                   const float *along, float *product, float *by_smoothing, float *by_knots) {
  for (int t = 0; t < tasks; t++, theta += WEIGHTS, along += WEIGHTS, product += WEIGHTS) {
    Samples s = samples_of(t, count, where, target, smoothing, smoothing_by_task, knots, knots_by_task);
    V sums[WEIGHTS], bent = splat(0), tilted[KNOTS];
    memset(sums, 0, sizeof sums), memset(tilted, 0, sizeof tilted);
    for (int at = 0; at < count; at += BLOCK) {
      Block b;
      Row one[HIDDEN], two[HIDDEN], out[OUT];  // derivatives of the layers' values along the direction
      Row d3[OUT], d2[HIDDEN];                 // derivatives of the loss in what goes into a layer's ReLU
      Row e3[OUT], e2[HIDDEN], e1[HIDDEN];     // derivatives of d3, d2 and d1 along the direction
      forward(theta, &s, at, &b);
      layer_1(along + W1, along + B1, 0, b.in, one, b.one);
      layer_2(along + W2, along + B2, 0, b.one, two, 0), layer_2(theta + W2, 0, 1, one, two, b.two);
      layer_3(along + W3, along + B3, 0, b.two, out, 0), layer_3(theta + W3, 0, 1, two, out, 0);
      for (int v = 0; v < VECTORS; v++) {
        V first = splat(0), w = b.weight[v];
        for (int c = 0; c < OUT; c++) {
          Compared by = compare(&b, c, v, s.smoothing);
          V moved = by.q * out[c][v];
          d3[c][v] = w * by.slope * by.q;
          e3[c][v] = w * moved * (by.bend * by.q + by.slope * (1.0f - by.q));
          first += w * by.slope * moved, bent += w * by.by_log * moved;
        }
        if (s.knots)
          for (int k = 0; k < KNOTS; k++) tilted[k] += first * b.hat[k][v];
      }
      back_3(theta + W3, 0, 0, d3, d2, b.two);
      back_3(along + W3, 0, 0, d3, e2, 0), back_3(theta + W3, 0, 1, e3, e2, b.two);
      back_2(along + W2, 0, 0, d2, e1, 0), back_2(theta + W2, 0, 1, e2, e1, b.one);
      outer_3(e3, b.two, sums + W3), outer_3(d3, two, sums + W3), total(OUT, e3, sums + B3);
      outer_2(e2, b.one, sums + W2), outer_2(d2, one, sums + W2), total(HIDDEN, e2, sums + B2);
      outer_1(e1, b.in, sums + W1), total(HIDDEN, e1, sums + B1);
    }
    for (int i = 0; i < WEIGHTS; i++) product[i] = reduced(sums + i);
    if (by_smoothing) by_smoothing[t] = reduced(&bent);
    for (int k = 0; k < KNOTS && by_knots; k++) by_knots[t * KNOTS + k] = reduced(tilted + k);
  }
}

int nbrdf_lanes(void) { return LANES; }
