// The gradient of an outer step of Meta-SGD: in an initialisation theta_0 and a rate for each weight, alpha, through
// inner steps of gradient descent. Each task takes its inner steps, goes back through them by the adjoint recursion, and
// clips its gradient. The network's loss is known by two functions, its gradient and the derivatives of the gradient
// along a direction (nbrdf.c).
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { MOST = 1024, WHERE = 7, TARGET = 3 };  // not less than a network's weights; the numbers of a sample

typedef void (*Gradient)(int tasks, int count, const float *theta, const float *where, const float *target,
                         const float *smoothing, int smoothing_by_task, const float *knots, int knots_by_task,
                         float *gradient, float *losses);
typedef void (*Product)(int tasks, int count, const float *theta, const float *where, const float *target,
                        const float *smoothing, int smoothing_by_task, const float *knots, int knots_by_task,
                        const float *along, float *product, float *by_smoothing, float *by_knots);

typedef struct {
  Gradient gradient;
  Product product;
  int weights, inner_steps, tasks, samples, order;  // order: 2 for exact derivatives, 1 to leave out second ones
  float clip;                                       // the greatest norm of a task's gradient
  const float *smoothing;                           // log s of second derivatives (adjoint.py), or none
} Fits;

// Fit one task, add the gradient of its share of the mean loss to `sum` [2 weights], and return its loss.
// where [inner steps + 1, tasks, WHERE, samples] and target are the samples of the inner steps and of the outer loss;
// `room` holds the parameters and the gradient of each inner step
static float add_task_gradient(const Fits *f, int task, const float *phi, const float *where, const float *target,
                               float *room, float *sum) {
  int n = f->weights;
  float loss, square = 0, by_theta[MOST], by_alpha[MOST] = {0}, along[MOST], bent[MOST];
  const float *alpha = phi + n, limit = f->clip / f->tasks;
  memcpy(room, phi, n * sizeof(float));
  for (int k = 0;; k++) {  // the last batch is that of the outer loss
    float *theta = room + (int64_t)2 * n * k, *gradient = theta + n, *next = gradient + n;
    int64_t batch = ((int64_t)k * f->tasks + task) * f->samples;
    f->gradient(1, f->samples, theta, where + WHERE * batch, target + TARGET * batch, 0, 0, 0, 0, gradient, &loss);
    if (k == f->inner_steps) break;
    for (int i = 0; i < n; i++) next[i] = theta[i] - alpha[i] * gradient[i];
  }
  const float *last = room + (int64_t)2 * n * f->inner_steps + n;
  for (int i = 0; i < n; i++) by_theta[i] = last[i] / f->tasks;
  for (int k = f->inner_steps - 1; k >= 0; k--) {
    const float *theta = room + (int64_t)2 * n * k, *gradient = theta + n;
    int64_t batch = ((int64_t)k * f->tasks + task) * f->samples;
    for (int i = 0; i < n; i++) by_alpha[i] -= by_theta[i] * gradient[i], along[i] = -by_theta[i] * alpha[i];
    if (f->order < 2) continue;
    f->product(1, f->samples, theta, where + WHERE * batch, target + TARGET * batch, f->smoothing, 0, 0, 0, along, bent,
               0, 0);
    for (int i = 0; i < n; i++) by_theta[i] += bent[i];
  }
  for (int i = 0; i < n; i++) square += by_theta[i] * by_theta[i] + by_alpha[i] * by_alpha[i];
  float norm = sqrtf(square), scale = norm > limit ? limit / norm : 1.0f;
  if (!isfinite(norm)) return loss;  // such a gradient says nothing about the direction
  for (int i = 0; i < n; i++) sum[i] += scale * by_theta[i], sum[n + i] += scale * by_alpha[i];
  return loss;
}

// Add the gradient of the mean loss over tasks to `gradient` [2 weights], and write the losses [tasks]
void outer_gradient(const Fits *f, const float *phi, const float *where, const float *target, float *room,
                    float *gradient, float *losses) {
  for (int i = 0; i < f->tasks; i++) losses[i] = add_task_gradient(f, i, phi, where, target, room, gradient);
}
