// One step of a rule on flat parameters, and its vector-Jacobian product, one task after the other. A step takes Adam's
// directions, multiplies each parameter's direction by matrices from both sides, and goes along it by the rates. Adam
// and the matrices may be missing. In the backward pass, by_x is the cotangent of x.
#include <math.h>
#include <string.h>

#include "vectors.h"

// AT_ONCE: rows that are multiplied at once, whose sums stay in registers. WIDEST and MOST: sizes of buffers, not less
// than the columns of a parameter and the weights of a network.
enum { AT_ONCE = 7, WIDEST = 64, MOST = 4096 };

typedef struct {
  int rows, columns, left, right;  // left, right: whether there is a matrix on that side
} Shape;

// Hyperparameters of a step; a stride is 0 where all tasks, or all weights, share a hyperparameter
typedef struct {
  const float *rate, *adam, *matrices;
  long rate_by_task, rate_by_weight, adam_by_task, matrices_by_task;
} Alpha;

// Cotangents of the hyperparameters
typedef struct {
  float *rate, *adam, *matrices;  // [T, n], [T, 3], [T, M]
} Pulled;

typedef struct {
  float *m, *v, *products;  // Adam's moments [T, n], and the products of its betas [T, 2]
} State;

static void copy(int n, const float *from, float *to) { memcpy(to, from, n * sizeof(float)); }

// Compute c = a b: a [rows, inner] and b [inner, columns] have strides of rows and columns, c [rows, columns] is dense
static void multiply(int rows, int inner, int columns, const float *a, int a_row, int a_column, const float *b,
                     int b_row, int b_column, float *c) {
  float wide[WIDEST][LANES] __attribute__((aligned(64)));
  for (int first = 0; first < columns; first += LANES) {
    int width = columns - first < LANES ? columns - first : LANES;
    for (int k = 0; k < inner; k++) {
      const float *from = b + k * b_row + first * b_column;
      if (width < LANES) memset(wide[k], 0, sizeof wide[k]);
      if (b_column == 1) copy(width, from, wide[k]);
      else for (int j = 0; j < width; j++) wide[k][j] = from[j * b_column];
    }
    for (int i = 0; i < rows; i += AT_ONCE) {
      V sum[AT_ONCE] = {{0}};
      int row[AT_ONCE];
      for (int r = 0; r < AT_ONCE; r++) row[r] = (i + r < rows ? i + r : i) * a_row;
      for (int k = 0; k < inner; k++)
        for (int r = 0; r < AT_ONCE; r++) sum[r] += a[row[r] + k * a_column] * *(const V *)wide[k];
      for (int r = 0; r < AT_ONCE && i + r < rows; r++)
        copy(width, (const float *)(sum + r), c + (i + r) * columns + first);
    }
  }
}

// Compute x = left d right for one parameter after the other; half receives left d, which mix_back needs
static void mix(int parameters, const Shape *shapes, const float *matrices, const float *d, float *half, float *x) {
  for (int p = 0; p < parameters; p++) {
    int r = shapes[p].rows, c = shapes[p].columns, size = r * c;
    const float *left = matrices, *right = left + (shapes[p].left ? r * r : 0);
    if (shapes[p].left) multiply(r, r, c, left, r, 1, d, c, 1, half);
    else copy(size, d, half);
    if (shapes[p].right) multiply(r, c, c, half, c, 1, right, c, 1, x);
    else copy(size, half, x);
    matrices = right + (shapes[p].right ? c * c : 0), d += size, half += size, x += size;
  }
}

// Compute the cotangents of d and of the matrices from the cotangent of x
static void mix_back(int parameters, const Shape *shapes, const float *matrices, const float *d, const float *half,
                     const float *by_x, float *by_d, float *by_matrices) {
  for (int p = 0; p < parameters; p++) {
    int r = shapes[p].rows, c = shapes[p].columns, size = r * c, before = shapes[p].left ? r * r : 0;
    int both = before + (shapes[p].right ? c * c : 0);
    float by_half[MOST];
    if (shapes[p].right) {
      multiply(c, r, c, half, 1, c, by_x, c, 1, by_matrices + before);
      multiply(r, c, c, by_x, c, 1, matrices + before, 1, c, by_half);
    } else copy(size, by_x, by_half);
    if (shapes[p].left) {
      multiply(r, c, r, by_half, c, 1, d, 1, c, by_matrices);
      multiply(r, r, c, matrices, 1, r, by_half, c, 1, by_d);
    } else copy(size, by_half, by_d);
    matrices += both, by_matrices += both, d += size, half += size, by_x += size, by_d += size;
  }
}

static State at(State all, int t, int n) { return (State){all.m + t * n, all.v + t * n, all.products + 2 * t}; }

// Compute Adam's directions d and the state after them; b holds both betas and eps
static void adam(int n, const float *b, const float *g, State before, State after, float *d) {
  for (int i = 0; i < 2; i++) after.products[i] = before.products[i] * b[i];
  float unbias1 = 1 - after.products[0], unbias2 = 1 - after.products[1];
  for (int i = 0; i < n; i++) {
    float m = b[0] * before.m[i] + (1 - b[0]) * g[i], v = b[1] * before.v[i] + (1 - b[1]) * g[i] * g[i];
    after.m[i] = m, after.v[i] = v, d[i] = m / unbias1 / (sqrtf(v / unbias2 + 1e-24f) + b[2]);
  }
}

// Compute the cotangents of the gradient, the state and b from the cotangents of the directions and the state after
static void adam_back(int n, const float *b, const float *g, State before, State after, const float *d,
                      const float *by_d, State by_after, float *by_g, State by_before, float *by_b) {
  float unbias1 = 1 - after.products[0], unbias2 = 1 - after.products[1];
  float by_unbias1 = 0, by_unbias2 = 0, by_beta1 = 0, by_beta2 = 0, by_eps = 0;
#pragma omp simd reduction(+ : by_unbias1, by_unbias2, by_beta1, by_beta2, by_eps)
  for (int i = 0; i < n; i++) {
    float unbiased = after.v[i] / unbias2, root = sqrtf(unbiased + 1e-24f), share = by_d[i] / (root + b[2]);
    float by_root = -share * d[i], by_unbiased = by_root / (2 * root);
    float by_m = by_after.m[i] + share / unbias1, by_v = by_after.v[i] + by_unbiased / unbias2;
    by_unbias1 -= by_d[i] * d[i] / unbias1, by_unbias2 -= by_unbiased * unbiased / unbias2, by_eps += by_root;
    by_beta1 += by_m * (before.m[i] - g[i]), by_beta2 += by_v * (before.v[i] - g[i] * g[i]);
    by_before.m[i] = b[0] * by_m, by_before.v[i] = b[1] * by_v;
    by_g[i] = (1 - b[0]) * by_m + 2 * (1 - b[1]) * g[i] * by_v;
  }
  float by_product1 = by_after.products[0] - by_unbias1, by_product2 = by_after.products[1] - by_unbias2;
  by_before.products[0] = b[0] * by_product1, by_before.products[1] = b[1] * by_product2;
  by_b[0] = by_beta1 + before.products[0] * by_product1, by_b[1] = by_beta2 + before.products[1] * by_product2;
  by_b[2] = by_eps;
}

// Take a step: write theta and the state after it; state and after are not read if there is no Adam
void step(int tasks, int n, int parameters, const Shape *shapes, const Alpha *alpha, const float *theta,
          const float *g, const State *state, float *moved, const State *after) {
  for (int t = 0; t < tasks; t++, theta += n, g += n, moved += n) {
    const float *rate = alpha->rate + t * alpha->rate_by_task, *x = g;
    float d[MOST], half[MOST], mixed[MOST];
    if (alpha->adam) {
      adam(n, alpha->adam + t * alpha->adam_by_task, g, at(*state, t, n), at(*after, t, n), d);
      x = d;
    }
    if (alpha->matrices) {
      mix(parameters, shapes, alpha->matrices + t * alpha->matrices_by_task, x, half, mixed);
      x = mixed;
    }
    for (int i = 0; i < n; i++) moved[i] = theta[i] - rate[i * alpha->rate_by_weight] * x[i];
  }
}

// Compute the cotangents of the gradient, the state and the hyperparameters from the cotangents of a step's results;
// by_moved is the cotangent of theta after the step
void step_back(int tasks, int n, int parameters, const Shape *shapes, const Alpha *alpha, const float *g,
               const State *state, const float *by_moved, const State *by_after, float *by_g, const State *by_state,
               const Pulled *pulled) {
  long matrices = 0;
  for (int p = 0; p < parameters; p++)
    matrices += (shapes[p].left ? shapes[p].rows * shapes[p].rows : 0) +
                (shapes[p].right ? shapes[p].columns * shapes[p].columns : 0);
  for (int t = 0; t < tasks; t++, g += n, by_moved += n, by_g += n) {
    const float *rate = alpha->rate + t * alpha->rate_by_task, *b = alpha->adam + t * alpha->adam_by_task, *x = g;
    const float *mixing = alpha->matrices + t * alpha->matrices_by_task, *unmixed = g;
    float d[MOST], half[MOST], mixed[MOST], m[MOST], v[MOST], products[2], by_x[MOST], by_d[MOST], *by = by_x;
    State after = {m, v, products};
    if (alpha->adam) adam(n, b, g, at(*state, t, n), after, d), x = unmixed = d;
    if (alpha->matrices) mix(parameters, shapes, mixing, unmixed, half, mixed), x = mixed;
    for (int i = 0; i < n; i++) {
      pulled->rate[t * n + i] = -by_moved[i] * x[i];
      by_x[i] = -by_moved[i] * rate[i * alpha->rate_by_weight];
    }
    if (alpha->matrices) {
      mix_back(parameters, shapes, mixing, unmixed, half, by_x, by_d, pulled->matrices + t * matrices);
      by = by_d;
    }
    if (alpha->adam)
      adam_back(n, b, g, at(*state, t, n), after, d, by, at(*by_after, t, n), by_g, at(*by_state, t, n),
                pulled->adam + 3 * t);
    else copy(n, by, by_g);
  }
}
