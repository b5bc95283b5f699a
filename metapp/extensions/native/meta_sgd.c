// Outer steps of Meta-SGD: learn an initialisation theta_0 and a rate for each weight, alpha, through inner steps of
// gradient descent, by Adam. Each outer step draws its tasks and samples by numbers that the caller has drawn, takes the
// inner steps of each task, goes back through them by the adjoint recursion, clips the task's gradient, and takes one
// step of Adam on the mean over tasks. The network's loss is known by two functions, its gradient and the derivatives of
// the gradient along a direction (nbrdf.c).
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
  float clip, weight_decay;                         // clip: the greatest norm of a task's gradient
  const float *smoothing;                           // log s of second derivatives (adjoint.py), or none
  const float *where, *target;                      // samples of all tasks, [M, N, WHERE] and [M, N, TARGET]
  int64_t where_by_task, target_by_task;            // strides, 0 where tasks share them
} Training;

// Phi, theta_0 and alpha side by side, and Adam's state, which outer steps change in place
typedef struct {
  float *phi, *m, *v, *products;  // [2 weights] each, and the products of both betas
} State;

static const float BETA[2] = {0.9f, 0.999f}, EPS = 1e-8f;

// One inner step of a task: parameters, the gradient at them, and the samples of the loss, as nbrdf.c reads them
typedef struct {
  float *theta, *gradient, *where, *target;  // [weights] each, [WHERE, samples], [TARGET, samples]
} Inner;

static Inner inner_step(const Training *t, float *room, int k) {
  float *theta = room + (int64_t)k * (2 * t->weights + (WHERE + TARGET) * t->samples), *where = theta + 2 * t->weights;
  return (Inner){theta, theta + t->weights, where, where + WHERE * t->samples};
}

static void gather(const Training *t, int64_t task, const int64_t *numbers, Inner to) {
  const float *where = t->where + task * t->where_by_task, *target = t->target + task * t->target_by_task;
  int n = t->samples;
  for (int j = 0; j < n; j++) {
    for (int i = 0; i < WHERE; i++) to.where[i * n + j] = where[numbers[j] * WHERE + i];
    for (int i = 0; i < TARGET; i++) to.target[i * n + j] = target[numbers[j] * TARGET + i];
  }
}

// Fit one task, add the gradient of its share of the mean loss to `sum` [2 weights], and return its loss
static float add_task_gradient(const Training *t, const float *phi, int64_t task, const int64_t *numbers, float *room,
                               float *sum) {
  int n = t->weights;
  float loss, square = 0, by_theta[MOST], by_alpha[MOST] = {0}, along[MOST], bent[MOST];
  const float *alpha = phi + n, limit = t->clip / t->tasks;
  memcpy(inner_step(t, room, 0).theta, phi, n * sizeof(float));
  for (int k = 0;; k++) {  // the last batch is that of the outer loss
    Inner now = inner_step(t, room, k);
    gather(t, task, numbers + (int64_t)k * t->tasks * t->samples, now);
    t->gradient(1, t->samples, now.theta, now.where, now.target, 0, 0, 0, 0, now.gradient, &loss);
    if (k == t->inner_steps) break;
    float *next = inner_step(t, room, k + 1).theta;
    for (int i = 0; i < n; i++) next[i] = now.theta[i] - alpha[i] * now.gradient[i];
  }
  for (int i = 0; i < n; i++) by_theta[i] = inner_step(t, room, t->inner_steps).gradient[i] / t->tasks;
  for (int k = t->inner_steps - 1; k >= 0; k--) {
    Inner now = inner_step(t, room, k);
    for (int i = 0; i < n; i++) by_alpha[i] -= by_theta[i] * now.gradient[i], along[i] = -by_theta[i] * alpha[i];
    if (t->order < 2) continue;
    t->product(1, t->samples, now.theta, now.where, now.target, t->smoothing, 0, 0, 0, along, bent, 0, 0);
    for (int i = 0; i < n; i++) by_theta[i] += bent[i];
  }
  for (int i = 0; i < n; i++) square += by_theta[i] * by_theta[i] + by_alpha[i] * by_alpha[i];
  float norm = sqrtf(square), scale = norm > limit ? limit / norm : 1.0f;
  if (!isfinite(norm)) return loss;  // such a gradient says nothing about the direction
  for (int i = 0; i < n; i++) sum[i] += scale * by_theta[i], sum[n + i] += scale * by_alpha[i];
  return loss;
}

// Take a step of Adam along the gradient g
static void step_adam(int n, float rate, float weight_decay, const float *g, State s) {
  for (int i = 0; i < 2; i++) s.products[i] *= BETA[i];
  float unbias1 = 1 - s.products[0], unbias2 = 1 - s.products[1];
  for (int i = 0; i < n; i++) {
    float slope = g[i] + weight_decay * s.phi[i];
    s.m[i] = BETA[0] * s.m[i] + (1 - BETA[0]) * slope, s.v[i] = BETA[1] * s.v[i] + (1 - BETA[1]) * slope * slope;
    s.phi[i] -= rate * (s.m[i] / unbias1 / (sqrtf(s.v[i] / unbias2 + 1e-24f) + EPS));
  }
}

// Take outer steps, and return how many were taken: all, or those up to the first whose loss is not finite.
// rates [steps] are Adam's; tasks [steps, tasks] and samples [steps, inner steps + 1, tasks, samples] are the numbers of
// what each step sees; `room` holds inner steps + 1 times what Inner has; losses [steps, tasks] receives the losses
int outer_steps(const Training *t, int steps, const float *rates, const int64_t *tasks, const int64_t *samples,
                State *state, float *room, float *losses) {
  for (int step = 0; step < steps; step++, tasks += t->tasks, losses += t->tasks) {
    float gradient[2 * MOST] = {0};
    int finite = 1;
    for (int i = 0; i < t->tasks; i++) {
      losses[i] = add_task_gradient(t, state->phi, tasks[i], samples + (int64_t)i * t->samples, room, gradient);
      finite &= isfinite(losses[i]) != 0;
    }
    step_adam(2 * t->weights, rates[step], t->weight_decay, gradient, *state);
    if (!finite) return step + 1;
    samples += (int64_t)(t->inner_steps + 1) * t->tasks * t->samples;
  }
  return steps;
}
