/* The Newton solve of a step, single steps and rollouts. */
#include "work.h"

static const double MAX_TURN = .7; /* rad or units of q in one Newton step */

static void move(Work* w, const Config* from, const double* q_from, const double* step, double alpha) {
  Config* now = &w->now;
  double turn[3], dq[4];
  for (int i = 0; i < 3; i++) now->c[i] = from->c[i] - alpha * step[i], turn[i] = -alpha * step[3 + i];
  quat_exp(turn, dq);
  quat_mul(dq, from->quat, now->quat);
  quat_normalize(now->quat);
  quat_matrix(now->quat, now->R);
  for (int c = 0; c < w->body->r; c++) w->q_now[c] = q_from[c] - alpha * step[6 + c];
}

/* Newton with an energy line search from w->now; returns 1 if it converged. */
static int minimise(Work* w, dp_info* info) {
  const int n = 6 + w->body->r, limit = (int)w->par[DP_MAX_NEWTON];
  const double tolerance = w->par[DP_TOLERANCE], scale = w->body->mass / (w->par[DP_TIMESTEP] * w->par[DP_TIMESTEP]);
  double step[MAX_N], L[MAX_N * MAX_N];
  work_assemble(w);
  for (info->iterations = 1; info->iterations <= limit; info->iterations++) {
    /* where E is not convex, raise the diagonal just far enough: a larger shift would only crawl */
    double diagonal[MAX_N], shift = 0;
    for (int i = 0; i < n; i++) diagonal[i] = fabs(w->H[i * n + i]) + 1e-6 * scale;
    while (!cholesky(w->H, n, L)) {
      const double next = shift ? 3 * shift : 1e-4;
      if (next > 1e12) return 0;
      for (int i = 0; i < n; i++) w->H[i * n + i] += (next - shift) * diagonal[i];
      shift = next;
    }
    cholesky_solve(L, n, w->g, step);
    double largest = 0, turn = 0, slope = inner(w->g, step, n);
    for (int i = 0; i < n; i++) {
      largest = fmax(largest, fabs(step[i]));
      if (i >= 3) turn = fmax(turn, fabs(step[i]));
    }
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    Config from = w->now;
    double q_from[DP_MAX_MODES], energy = w->energy;
    memcpy(q_from, w->q_now, sizeof(double) * w->body->r);
    if (largest < tolerance) { /* quadratic convergence: after this step nothing is left */
      move(w, &from, q_from, step, 1);
      return 1;
    }
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
    for (int halvings = 0;; halvings++) {
      move(w, &from, q_from, step, alpha);
      work_assemble(w);
      if (w->energy <= energy - 1e-4 * alpha * slope + 1e-11 * fabs(energy) + 1e-10) break;
      if (halvings == 30) return 0;
      alpha *= .5;
    }
  }
  return 0;
}

static void pack(const Work* w, double* x_next) {
  const int r = w->body->r;
  const double ih = 1 / w->par[DP_TIMESTEP];
  const Config *now = &w->now, *one = &w->one;
  double back[4] = {one->quat[0], -one->quat[1], -one->quat[2], -one->quat[3]}, turn[4], omega[3];
  quat_mul(back, now->quat, turn);
  quat_log(turn, omega);
  double *v = x_next + 7 + r;
  for (int i = 0; i < 3; i++) {
    v[i] = (now->c[i] - one->c[i]) * ih, v[3 + i] = omega[i] * ih;
    x_next[i] = now->c[i];
  }
  memcpy(x_next + 3, now->quat, sizeof now->quat);
  for (int c = 0; c < r; c++) v[6 + c] = (w->q_now[c] - one->q[c]) * ih, x_next[7 + c] = w->q_now[c];
}

static int step(const Body* b, const double* par, const double* x, const double* u, double* x_next,
                dp_info* info) {
  WORK(w, b, par, u);
  work_unpack(&w, x);
  work_prepare(&w, 0);
  /* start from the free motion; the shape, which stiffness and control hold back, half way */
  const double h = par[DP_TIMESTEP], *v = x + 7 + b->r;
  double step0[MAX_N], turn[3];
  mul_mv(w.one.R, v + 3, turn);
  for (int i = 0; i < 3; i++) step0[i] = w.one.c[i] - w.guess[i], step0[3 + i] = -h * turn[i];
  for (int c = 0; c < b->r; c++) step0[6 + c] = -.5 * h * v[6 + c];
  w.now.q = w.q_now;
  move(&w, &w.one, w.one.q, step0, 1);
  dp_info local;
  if (!info) info = &local;
  info->failed = !minimise(&w, info);
  pack(&w, x_next);
  return info->failed;
}

int dp_step(const double* blob, const double* par, const double* x, const double* u, double* x_next,
            dp_info* info) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return 1;
  return step(&b, par, x, u, x_next, info);
}

int dp_rollout(const double* blob, const double* par, int N, const double* u, double* xs, long* iterations) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return N;
  const int nx = 13 + 2 * b.r;
  int failed = 0;
  long count = 0;
  for (int i = 0; i < N; i++) {
    dp_info info;
    failed += step(&b, par, xs + (size_t)i * nx, u + (size_t)i * b.r, xs + (size_t)(i + 1) * nx, &info);
    count += info.iterations;
  }
  if (iterations) *iterations = count;
  return failed;
}
