/* The Newton solve of an implicit Euler step, and what is tried where it fails. */
#include "euler.h"

static const double PI = 3.14159265358979323846;
enum { PATH_STEPS = 4000 }; /* of a continuation: a few hundred is usual */

/* The iterate = from, moved by -alpha step. */
static void move(Work* w, const Config* from, const double* step, double alpha) {
  Config* now = &w->now;
  double turn[3], dq[4];
  for (int i = 0; i < 3; i++)
    now->c[i] = from->c[i] - alpha * step[i], turn[i] = -alpha * step[3 + i];
  quat_exp(turn, dq);
  quat_mul(dq, from->quat, now->quat);
  quat_normalize(now->quat);
  quat_matrix(now->quat, now->R);
  for (int c = 0; c < w->body->r; c++) now->q[c] = from->q[c] - alpha * step[6 + c];
}

static void stay(Work* w) { /* at the last configuration */
  const double none[MAX_N] = {0};
  move(w, &w->one, none, 0);
}

static int most_iterations(const Work* w) { return (int)fmin(w->par[DP_MAX_NEWTON], 1000); }
static int has_work_left(const Work* w) { return *w->spent < DP_MAX_WORK; }

/* Factors of H: Cholesky's of a minimum, with the diagonal raised just far enough where E is not
 * convex (a larger shift would only crawl); LU of a root. 0 if there are none. */
static int factorise_step(Work* w, int minimum, Factors* f) {
  const int n = 6 + w->body->r;
  if (!minimum) return factorise(f, w->H, n, 0);
  const double scale = w->body->mass / (w->h * w->h);
  double diagonal[MAX_N], shift = 0;
  for (int i = 0; i < n; i++) diagonal[i] = fabs(w->H[i * n + i]) + 1e-6 * scale;
  while (!factorise(f, w->H, n, 1)) {
    const double next = shift ? 3 * shift : 1e-4;
    if (next > 1e12) return 0;
    for (int i = 0; i < n; i++) w->H[i * n + i] += (next - shift) * diagonal[i];
    shift = next;
  }
  return 1;
}

/* Whether alpha step may be taken, the iterate being where it leads: to a minimum the energy must
 * fall by enough (Armijo); to a root the next step, with the same factors, must be shorter
 * (Deuflhard's natural monotonicity test). */
static int is_better(const Work* w, int minimum, const Factors* f, double energy,
                     const double* gradient, const double* step, double alpha) {
  const int n = 6 + w->body->r;
  if (minimum) {
    const double slope = inner(gradient, step, n);
    return w->energy <= energy - 1e-4 * alpha * slope + 1e-11 * fabs(energy) + 1e-10;
  }
  double next[MAX_N];
  solve(f, w->g, next);
  const double reduced = 1 - .25 * alpha;
  return inner(next, next, n) <= reduced * reduced * inner(step, step, n);
}

/* Newton from w->now: to a minimum of E, or to a root of the equations, which with contact have no
 * potential; returns 1 if it converged, to a root that is no saddle. */
static int newton(Work* w, int minimum, int limit, dp_info* info) {
  const int n = 6 + w->body->r, halvings = minimum ? 30 : 7;
  double step[MAX_N], gradient[MAX_N];
  Factors f;
  work_assemble(w);
  for (int k = 0; k < limit && has_work_left(w); k++) {
    info->iterations++;
    if (!factorise_step(w, minimum, &f)) return 0;
    solve(&f, w->g, step);
    const double largest = largest_of(step, n), turn = largest_of(step + 3, n - 3);
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    const Config from = w->now;
    if (largest < w->par[DP_TOLERANCE]) { /* quadratic convergence: nothing is left after it */
      move(w, &from, step, 1);
      return minimum || f.sign > 0;
    }
    const double energy = w->energy;
    memcpy(gradient, w->g, sizeof gradient);
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
    for (int halved = 0;; halved++, alpha *= .5) {
      move(w, &from, step, alpha);
      work_assemble(w);
      if (is_better(w, minimum, &f, energy, gradient, step, alpha)) break;
      if (halved == halvings) return 0;
    }
  }
  return 0;
}

/* --- friction from a guess of the normal forces */

static void places_now(Work* w, double* out) {
  kinematics(w->body, w->now.q, 0, w->now.zeta, w->scratch);
  contact_places(w, &w->now, out);
}

/* Friction from the last iterate's normal forces, which makes the step a minimisation, then Newton
 * from its minimum; the forces follow at half speed if that is not enough. */
static int solve_lagged(Work* w, int rounds, dp_info* info) {
  double next[3 * DP_MAX_CONTACTS];
  places_now(w, w->touch_lagged);
  for (int k = 0; k < rounds && has_work_left(w); k++) {
    info->attempts++;
    dp_info minimum = {0, 0, 0, 1, 0};
    w->reference = w->touch_lagged;
    newton(w, 1, most_iterations(w), &minimum);
    w->reference = NULL;
    info->iterations += minimum.iterations;
    places_now(w, next);
    const Config found = w->now;
    if (newton(w, 0, 15, info)) return 1;
    w->now = found;
    const double share = k ? .5 : 1;
    for (int i = 0; i < 3 * w->body->nc; i++)
      w->touch_lagged[i] += share * (next[i] - w->touch_lagged[i]);
  }
  return 0;
}

/* --- a path of solutions */

/* The way (6 + r) from the last configuration to the iterate, the inverse Jacobian of its turn. */
static void way_from_last(const Work* w, double* way, double* J) {
  const Config *one = &w->one, *now = &w->now;
  double turn[4];
  quat_between(one->quat, now->quat, turn);
  quat_log(turn, way + 3);
  if (turn[0] < 0) { /* beyond half a turn: go on, where the logarithm would change sides */
    const double angle = sqrt(dot3(way + 3, way + 3));
    for (int i = 3; i < 6; i++) way[i] *= 1 - 2 * PI / angle;
  }
  so3_left_jacobian(way + 3, 1, J);
  for (int i = 0; i < 3; i++) way[i] = now->c[i] - one->c[i];
  for (int c = 0; c < w->body->r; c++) way[6 + c] = now->q[c] - one->q[c];
}

/* Gradient and Hessian of share * (the step's equations) + (1 - share) * scale * (way from the last
 * configuration), and the gradient's derivative by the share. The way's Hessian is that of
 * |way|^2 / 2 in the increment: symmetric like E's, since where the sum is 0 the skew parts
 * cancel. */
static void assemble_share(Work* w, const double* scale, double share, double* by_share) {
  const int n = 6 + w->body->r;
  double way[MAX_N], J[9];
  way_from_last(w, way, J);
  work_assemble(w);
  for (int i = 0; i < n; i++) {
    double* row = w->H + i * n;
    by_share[i] = w->g[i] - scale[i] * way[i], w->g[i] = scale[i] * way[i] + share * by_share[i];
    for (int j = 0; j < n; j++) row[j] *= share;
    if (i < 3 || i > 5) {
      row[i] += (1 - share) * scale[i];
      continue;
    }
    for (int j = 0; j < 3; j++)
      row[3 + j] += (1 - share) * scale[i] * .5 * (J[3 * (i - 3) + j] + J[3 * j + i - 3]);
  }
}

/* Factors of the Hessian bordered by the derivative by the share (a column) and `row`. */
static int border(const Work* w, const double* by_share, const double* row, double* A, int* pivot,
                  int* sign) {
  const int n = 6 + w->body->r, m = n + 1;
  for (int i = 0; i < n; i++) {
    memcpy(A + i * m, w->H + i * n, sizeof(double) * n);
    A[i * m + n] = by_share[i];
  }
  memcpy(A + n * m, row, sizeof(double) * m);
  return lu(A, m, pivot, sign);
}

/* The diagonal of the equations' matrix where the body is, without friction; no axis is special. */
static void path_scale(Work* w, double* scale) {
  const int n = 6 + w->body->r;
  stay(w);
  w->friction = 0;
  work_assemble(w);
  w->friction = w->terrain.friction;
  for (int i = 0; i < n; i++) scale[i] = fabs(w->H[i * n + i]);
  scale[3] = scale[4] = scale[5] = fmax(scale[3], fmax(scale[4], scale[5]));
}

/* The tangent (n + 1) of the path at the iterate: onwards is where the bordered matrix keeps its
 * sign, also round the kinks where a point touches. */
static int path_tangent(Work* w, const double* scale, double share, double* tangent) {
  const int n = 6 + w->body->r;
  double A[(MAX_N + 1) * (MAX_N + 1)], by_share[MAX_N], rhs[MAX_N + 1] = {0};
  int pivot[MAX_N + 1], sign;
  rhs[n] = 1;
  assemble_share(w, scale, share, by_share);
  if (!border(w, by_share, tangent, A, pivot, &sign)) return 0;
  lu_solve(A, pivot, n + 1, rhs, tangent);
  const double norm = sign / sqrt(inner(tangent, tangent, n + 1));
  for (int i = 0; i <= n; i++) tangent[i] *= norm;
  return 1;
}

/* From `last` by a length along the tangent, and back to the path by Newton across it: the share
 * reached in *at; returns the number of corrections, 0 if they did not converge. */
static int path_step(Work* w, const Config* last, const double* scale, const double* tangent,
                     double length, double* at, dp_info* info) {
  const int n = 6 + w->body->r;
  double A[(MAX_N + 1) * (MAX_N + 1)], by_share[MAX_N], rhs[MAX_N + 1], move_by[MAX_N + 1];
  int pivot[MAX_N + 1], sign;
  for (int i = 0; i < n; i++) move_by[i] = -tangent[i];
  move(w, last, move_by, length);
  for (int corrections = 1; corrections <= 8; corrections++) {
    info->iterations++;
    assemble_share(w, scale, *at, by_share);
    memcpy(rhs, w->g, sizeof(double) * n), rhs[n] = 0;
    if (!border(w, by_share, tangent, A, pivot, &sign)) return 0;
    lu_solve(A, pivot, n + 1, rhs, move_by);
    double largest = 0;
    for (int i = 0; i <= n; i++) largest = fmax(largest, fabs(move_by[i]));
    *at -= move_by[n];
    /* no other branch is meant; a long step that turns round has met one */
    if (!(largest < .5 * length && *at >= 0 && (sign > 0 || length < 1e-3))) return 0;
    const Config from = w->now;
    move(w, &from, move_by, 1);
    if (largest < 1e-6) return corrections;
  }
  return 0;
}

/* Follow the solutions from where the body is (share 0, whose only solution that is) to the step's
 * (share 1), by the length of their path, since it may fold. Inertia and stiffness grow with the
 * way, friction works against it: the path stays bounded, cannot come back to share 0 and so
 * arrives, whatever the step (fixed-point homotopy: Chow, Mallet-Paret, Yorke, 1978). */
static int solve_path(Work* w, dp_info* info) {
  double scale[MAX_N], tangent[MAX_N + 1] = {0}, share = 0, length = .1;
  const int n = 6 + w->body->r;
  info->attempts++;
  path_scale(w, scale);
  tangent[n] = 1;
  for (int k = 0; k < PATH_STEPS && has_work_left(w); k++) {
    const Config last = w->now;
    if (!path_tangent(w, scale, share, tangent)) return 0;
    for (int close = 0; !close; length *= close ? 1 : .4) {
      if (length < 1e-9) return 0;
      double at = share + length * tangent[n];
      const int corrections = path_step(w, &last, scale, tangent, length, &at, info);
      close = corrections > 0;
      if (close && at >= 1) { /* past the end: the solution is near */
        const Config beyond = w->now;
        if (newton(w, 0, 20, info)) return 1;
        w->now = beyond;
        close = length < 1e-3;
      }
      if (!close) {
        w->now = last;
        continue;
      }
      share = at;
      if (corrections <= 5) length = fmin(2 * length, .2);
    }
  }
  return 0;
}

/* --- the solve */

/* The step with contact: Newton; if it fails, more and more careful ways to the same equations. */
static int solve_contact(Work* w, dp_info* info) {
  work_assemble(w);
  if (w->m) stay(w); /* the free motion leads into the ground */
  if (w->friction == 0) return newton(w, 1, most_iterations(w), info);
  const Config start = w->now;
  info->iterations = 0, info->attempts = 1;
  if (newton(w, 0, most_iterations(w), info)) return 1;
  w->now = start;
  if (solve_lagged(w, 4, info)) return 1;
  return solve_path(w, info);
}

/* Newton from a configuration near the solution; returns 1 if it converged. */
static int solve_near(Work* w, const Pose* near, dp_info* info) {
  work_set(w, near);
  if (terrain_parts(&w->terrain)) return newton(w, 0, 10, info);
  return newton(w, 1, most_iterations(w), info);
}

/* The first guess: the free motion; the shape, which stiffness and control hold back, half way. */
static void go_on(Work* w) {
  double step[MAX_N], turn[4];
  quat_between(w->two.quat, w->one.quat, turn);
  quat_log(turn, step + 3);
  for (int i = 0; i < 3; i++) step[i] = w->one.c[i] - w->guess[i], step[3 + i] = -step[3 + i];
  for (int c = 0; c < w->body->r; c++) step[6 + c] = -.5 * (w->one.q[c] - w->two.q[c]);
  move(w, &w->one, step, 1);
}

int euler_solve(Work* w, const Pose* guess, Pose* next, dp_info* info) {
  work_prepare(w, 0);
  memset(w->now.q, 0, sizeof w->now.q);
  dp_info found = {0, 1, 0, 1, 0};
  int done = guess && solve_near(w, guess, &found);
  if (!done) {
    go_on(w);
    done = terrain_parts(&w->terrain) ? solve_contact(w, &found)
                                      : newton(w, 1, most_iterations(w), &found);
  }
  info->iterations += found.iterations, info->residual = found.residual;
  if (found.attempts > info->attempts) info->attempts = found.attempts;
  memcpy(next->c, w->now.c, sizeof next->c), memcpy(next->quat, w->now.quat, sizeof next->quat);
  memcpy(next->q, w->now.q, sizeof next->q);
  return done;
}
