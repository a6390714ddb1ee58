/* The Newton solve of a step, single steps and rollouts. */
#include "work.h"

static const double PI = 3.14159265358979323846;
static const double MAX_TURN = .7; /* rad or units of q in one Newton step */
enum { PATH_STEPS = 4000 };         /* of a continuation: a few hundred is usual */

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

static int most_iterations(const Work* w) { return (int)fmin(w->par[DP_MAX_NEWTON], 1000); }
static int has_work_left(const Work* w) { return *w->spent < DP_MAX_WORK; }

/* Newton with an energy line search from w->now; returns 1 if it converged. */
static int minimise(Work* w, dp_info* info) {
  const int n = 6 + w->body->r, limit = most_iterations(w);
  const double tolerance = w->par[DP_TOLERANCE], scale = w->body->mass / (w->h * w->h);
  double step[MAX_N], L[MAX_N * MAX_N];
  work_assemble(w);
  for (info->iterations = 1; info->iterations <= limit && has_work_left(w); info->iterations++) {
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
  for (int k = 0; k < limit && has_work_left(w); k++) {
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

/* An iterate, to come back to. */
typedef struct {
  Config at;
  double q[DP_MAX_MODES];
} Saved;
static void save(const Work* w, Saved* s) { s->at = w->now, memcpy(s->q, w->q_now, sizeof s->q); }
static void restore(Work* w, const Saved* s) { w->now = s->at, memcpy(w->q_now, s->q, sizeof s->q); }

static void positions_now(Work* w, double* out) {
  kinematics(w->body, w->q_now, 0, w->now.zeta, w->scratch);
  contact_positions(w, &w->now, out);
}

/* Friction from the last iterate's normal forces, which makes the step a minimisation, then Newton from
 * its minimum; the forces follow at half speed if that is not enough. */
static int solve_lagged(Work* w, int rounds, dp_info* info) {
  positions_now(w, w->touch_reference);
  for (int k = 0; k < rounds && has_work_left(w); k++) {
    info->attempts++;
    w->reference = w->touch_reference;
    dp_info minimum = {0, 0, 0, 1, 0};
    minimise(w, &minimum);
    info->iterations += minimum.iterations;
    w->reference = NULL;
    double next[3 * DP_MAX_CONTACTS];
    positions_now(w, next);
    Saved found;
    save(w, &found);
    if (newton(w, 15, info)) return 1;
    restore(w, &found);
    const double share = k ? .5 : 1;
    for (int i = 0; i < 3 * w->body->nc; i++) w->touch_reference[i] += share * (next[i] - w->touch_reference[i]);
  }
  return 0;
}

/* Gradient and Hessian of share * (the step's equations) + (1 - share) * scale * (way from the last
 * configuration), and the gradient's derivative by the share. The way's Hessian is that of |way|^2 / 2 in
 * the increment: symmetric like E's, since where the sum is zero the two skew parts cancel. */
static void assemble_share(Work* w, const double* scale, double share, double* by_share) {
  const int n = 6 + w->body->r;
  const Config *one = &w->one, *now = &w->now;
  const double back[4] = {one->quat[0], -one->quat[1], -one->quat[2], -one->quat[3]};
  double way[MAX_N], turn[4], J[9];
  quat_mul(now->quat, back, turn);
  quat_log(turn, way + 3);
  if (turn[0] < 0) { /* beyond half a turn: go on, where the logarithm would change sides */
    const double angle = sqrt(dot3(way + 3, way + 3));
    for (int i = 3; i < 6; i++) way[i] *= 1 - 2 * PI / angle;
  }
  so3_left_jacobian(way + 3, 1, J);
  for (int i = 0; i < 3; i++) way[i] = now->c[i] - one->c[i];
  for (int c = 0; c < w->body->r; c++) way[6 + c] = w->q_now[c] - one->q[c];
  work_assemble(w);
  for (int i = 0; i < n; i++) {
    double* row = w->H + i * n;
    by_share[i] = w->g[i] - scale[i] * way[i], w->g[i] = scale[i] * way[i] + share * by_share[i];
    for (int j = 0; j < n; j++) row[j] *= share;
    if (i < 3 || i > 5) row[i] += (1 - share) * scale[i];
    else
      for (int j = 0; j < 3; j++) row[3 + j] += (1 - share) * scale[i] * .5 * (J[3 * (i - 3) + j] + J[3 * j + i - 3]);
  }
}

/* Factors of the Hessian bordered by the derivative by the share (last column) and `row` (last row). */
static int border(const Work* w, const double* by_share, const double* row, double* A, int* pivot, int* sign) {
  const int n = 6 + w->body->r, m = n + 1;
  for (int i = 0; i < n; i++) {
    memcpy(A + i * m, w->H + i * n, sizeof(double) * n);
    A[i * m + n] = by_share[i];
  }
  memcpy(A + n * m, row, sizeof(double) * m);
  return lu(A, m, pivot, sign);
}

/* Follow the solutions from where the body is (share 0, whose only solution that is) to the step's (share
 * 1), by the length of their path, since it may fold. Inertia and stiffness grow with the way, friction works
 * against it: the path stays bounded, cannot come back to share 0 and so arrives, whatever the step
 * (fixed-point homotopy: Chow, Mallet-Paret, Yorke, 1978). */
static int solve_path(Work* w, dp_info* info) {
  const int n = 6 + w->body->r;
  double scale[MAX_N], A[(MAX_N + 1) * (MAX_N + 1)], by_share[MAX_N];
  double tangent[MAX_N + 1] = {0}, rhs[MAX_N + 1], move_by[MAX_N + 1], share = 0, length = .1;
  int pivot[MAX_N + 1], sign;
  info->attempts++;
  move(w, &w->one, w->one.q, tangent, 0);
  w->friction = 0;
  work_assemble(w);
  w->friction = w->terrain.friction;
  for (int i = 0; i < n; i++) scale[i] = fabs(w->H[i * n + i]);
  scale[3] = scale[4] = scale[5] = fmax(scale[3], fmax(scale[4], scale[5])); /* no axis is special */
  tangent[n] = 1;
  Saved last;
  for (int k = 0; k < PATH_STEPS && has_work_left(w); k++) {
    save(w, &last);
    assemble_share(w, scale, share, by_share);
    /* onwards is where the bordered matrix keeps its sign, also round the kinks where a point touches */
    memset(rhs, 0, sizeof rhs), rhs[n] = 1;
    if (!border(w, by_share, tangent, A, pivot, &sign)) return 0;
    lu_solve(A, pivot, n + 1, rhs, tangent);
    const double norm = sign / sqrt(inner(tangent, tangent, n + 1));
    for (int i = 0; i <= n; i++) tangent[i] *= norm;
    for (int close = 0; !close; length *= close ? 1 : .4) {
      if (length < 1e-9) return 0;
      double at = share + length * tangent[n];
      int corrections = 0;
      for (int i = 0; i < n; i++) move_by[i] = -tangent[i];
      move(w, &last.at, last.q, move_by, length);
      while (!close && corrections++ < 8) {
        info->iterations++;
        assemble_share(w, scale, at, by_share);
        memcpy(rhs, w->g, sizeof(double) * n), rhs[n] = 0;
        if (!border(w, by_share, tangent, A, pivot, &sign)) break;
        lu_solve(A, pivot, n + 1, rhs, move_by);
        double largest = 0;
        for (int i = 0; i <= n; i++) largest = fmax(largest, fabs(move_by[i]));
        at -= move_by[n];
        /* no other branch is meant; a long step that turns round has met one */
        if (!(largest < .5 * length && at >= 0 && (sign > 0 || length < 1e-3))) break;
        Config from = w->now;
        double q_from[DP_MAX_MODES];
        memcpy(q_from, w->q_now, sizeof q_from);
        move(w, &from, q_from, move_by, 1);
        close = largest < 1e-6;
      }
      if (close && at >= 1) { /* past the end: the solution is near */
        Saved beyond;
        save(w, &beyond);
        if (newton(w, 20, info)) return 1;
        restore(w, &beyond);
        close = length < 1e-3;
      }
      if (!close) restore(w, &last);
      else {
        share = at;
        if (corrections <= 5) length = fmin(2 * length, .2);
      }
    }
  }
  return 0;
}

/* The step with contact: Newton; if it fails, more and more careful ways to the same equations. */
static int solve_contact(Work* w, dp_info* info) {
  const int limit = most_iterations(w);
  work_assemble(w);
  Saved start;
  if (w->m) { /* the free motion leads into the ground: stay */
    const double none[MAX_N] = {0};
    move(w, &w->one, w->one.q, none, 0);
  }
  if (w->friction == 0) return minimise(w, info);
  save(w, &start);
  info->iterations = 0, info->attempts = 1;
  if (newton(w, limit, info)) return 1;
  restore(w, &start);
  if (solve_lagged(w, 4, info)) return 1;
  return solve_path(w, info);
}

/* Newton from a configuration near the solution; returns 1 if it converged. */
static int solve_near(Work* w, const Pose* near, dp_info* info) {
  memcpy(w->now.c, near->c, sizeof w->now.c), memcpy(w->now.quat, near->quat, sizeof w->now.quat);
  quat_matrix(w->now.quat, w->now.R);
  memcpy(w->q_now, near->q, sizeof w->q_now);
  return terrain_parts(&w->terrain) ? newton(w, 10, info) : minimise(w, info);
}

int euler_solve(Work* w, const Pose* guess, Pose* next, dp_info* info) {
  const int r = w->body->r;
  work_prepare(w, 0);
  w->now.q = w->q_now;
  dp_info found = {0, 1, 0, 1, 0};
  int done = guess && solve_near(w, guess, &found);
  if (!done) {
    /* start from the free motion; the shape, which stiffness and control hold back, half way */
    double step0[MAX_N], back[4] = {w->two.quat[0], -w->two.quat[1], -w->two.quat[2], -w->two.quat[3]}, turn[4];
    quat_mul(w->one.quat, back, turn);
    quat_log(turn, step0 + 3);
    for (int i = 0; i < 3; i++) step0[i] = w->one.c[i] - w->guess[i], step0[3 + i] = -step0[3 + i];
    for (int c = 0; c < r; c++) step0[6 + c] = -.5 * (w->q_one[c] - w->q_two[c]);
    move(w, &w->one, w->one.q, step0, 1);
    done = terrain_parts(&w->terrain) ? solve_contact(w, &found) : minimise(w, &found);
  }
  info->iterations += found.iterations, info->residual = found.residual;
  if (found.attempts > info->attempts) info->attempts = found.attempts;
  memcpy(next->c, w->now.c, sizeof next->c), memcpy(next->quat, w->now.quat, sizeof next->quat);
  memcpy(next->q, w->q_now, sizeof(double) * r);
  return done;
}
