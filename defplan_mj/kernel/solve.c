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

/* Newton on the equations of contact, which have no potential; returns 1 if it converged. A step is
 * taken if the next one, with the same factors, is shorter (Deuflhard's natural monotonicity test). */
static int newton(Work* w, int limit, dp_info* info) {
  const int n = 6 + w->body->r;
  const double tolerance = w->par[DP_TOLERANCE];
  double step[MAX_N], next[MAX_N], A[MAX_N * MAX_N];
  int pivot[MAX_N], sign;
  work_assemble(w);
  for (int k = 0; k < limit; k++) {
    info->iterations++;
    memcpy(A, w->H, sizeof(double) * n * n);
    if (!lu(A, n, pivot, &sign)) return 0;
    lu_solve(A, pivot, n, w->g, step);
    double largest = 0, turn = 0;
    for (int i = 0; i < n; i++) {
      largest = fmax(largest, fabs(step[i]));
      if (i >= 3) turn = fmax(turn, fabs(step[i]));
    }
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    Config from = w->now;
    double q_from[DP_MAX_MODES];
    memcpy(q_from, w->q_now, sizeof(double) * w->body->r);
    if (largest < tolerance) {
      move(w, &from, q_from, step, 1);
      return sign > 0; /* not a saddle */
    }
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
    const double size = inner(step, step, n);
    for (int halvings = 0;; halvings++) {
      move(w, &from, q_from, step, alpha);
      work_assemble(w);
      lu_solve(A, pivot, n, w->g, next);
      const double reduced = 1 - .25 * alpha;
      if (inner(next, next, n) <= reduced * reduced * size) break;
      if (halvings == 7) return 0;
      alpha *= .5;
    }
  }
  return 0;
}

/* The step with contact: Newton from the start; if it fails, minimise with the normal forces of
 * friction taken from the last iterate, and try again from there, more and more carefully. */
static int solve_contact(Work* w, dp_info* info) {
  const int r = w->body->r, limit = (int)w->par[DP_MAX_NEWTON];
  work_assemble(w);
  if (w->m) { /* the free motion leads into the ground: stay */
    const double none[MAX_N] = {0};
    move(w, &w->one, w->one.q, none, 0);
  }
  if (w->friction == 0) return minimise(w, info);
  Config start = w->now;
  double q_start[DP_MAX_MODES];
  memcpy(q_start, w->q_now, sizeof(double) * r);
  info->iterations = 0, info->attempts = 1;
  if (newton(w, limit, info)) return 1;

  w->now = start, memcpy(w->q_now, q_start, sizeof(double) * r);
  kinematics(w->body, w->q_now, 0, w->now.zeta, w->scratch);
  contact_positions(w, &w->now, w->touch_reference);
  for (int outer = 0; outer < 12; outer++) {
    info->attempts++;
    w->reference = w->touch_reference;
    dp_info minimum = {0, 0, 0, 0};
    minimise(w, &minimum);
    info->iterations += minimum.iterations;
    w->reference = NULL;
    kinematics(w->body, w->q_now, 0, w->now.zeta, w->scratch);
    double next[3 * DP_MAX_CONTACTS];
    contact_positions(w, &w->now, next);
    Config found = w->now;
    double q_found[DP_MAX_MODES];
    memcpy(q_found, w->q_now, sizeof(double) * r);
    if (newton(w, 12, info)) return 1;
    w->now = found, memcpy(w->q_now, q_found, sizeof(double) * r);
    const double share = outer ? .5 : 1;
    for (int i = 0; i < 3 * w->body->nc; i++) w->touch_reference[i] += share * (next[i] - w->touch_reference[i]);
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

static int step(const Parts* p, const double* x, const double* u, double* x_next, dp_info* info) {
  const Body* b = &p->body;
  WORK(w, p, u);
  work_unpack(&w, x);
  work_prepare(&w, 0);
  /* start from the free motion; the shape, which stiffness and control hold back, half way */
  const double h = w.par[DP_TIMESTEP], *v = x + 7 + b->r;
  double step0[MAX_N], turn[3];
  mul_mv(w.one.R, v + 3, turn);
  for (int i = 0; i < 3; i++) step0[i] = w.one.c[i] - w.guess[i], step0[3 + i] = -h * turn[i];
  for (int c = 0; c < b->r; c++) step0[6 + c] = -.5 * h * v[6 + c];
  w.now.q = w.q_now;
  move(&w, &w.one, w.one.q, step0, 1);
  dp_info local;
  if (!info) info = &local;
  info->attempts = 1;
  info->failed = !(terrain_parts(&w.terrain) ? solve_contact(&w, info) : minimise(&w, info));
  pack(&w, x_next);
  return info->failed;
}

int dp_step(const dp_model* m, const double* x, const double* u, double* x_next, dp_info* info) {
  Parts p;
  if (parts_view(&p, m)) return 1;
  return step(&p, x, u, x_next, info);
}

int dp_rollout(const dp_model* m, int N, const double* u, double* xs, long* iterations) {
  Parts p;
  if (parts_view(&p, m)) return N;
  const int nx = 13 + 2 * p.body.r;
  int failed = 0;
  long count = 0;
  for (int i = 0; i < N; i++) {
    dp_info info;
    failed += step(&p, xs + (size_t)i * nx, u + (size_t)i * p.nu, xs + (size_t)(i + 1) * nx, &info);
    count += info.iterations;
  }
  if (iterations) *iterations = count;
  return failed;
}
