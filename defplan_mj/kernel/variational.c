/* The variational step: three configurations x0, x1, x2, a substep h apart, satisfy the discrete
 * Euler-Lagrange equation at x1 with the forces of both intervals half each (docs/kernel.md),
 *
 *   J_1^T M (p2 - 2 p1 + p0)/h^2 + K [(1 + k_c)(q0 + 2 q1 + q2)/4 - k_c u + b (q2 - q0)/2h]
 *     - J_1^T [(F_01 + F_12)/2 + F_contact(p2, (p2 - p1)/h) + gravity + F_feet] - righting(R1) = 0,
 *
 * J_1 the tangent at x1. The inertia that is projected there, and not at x2, is what conserves
 * linear and angular momentum (discrete Noether), and what makes the step second order. F_12 takes
 * the area vectors extrapolated, (3 a1 - a0)/2, F_01 their mean: second order, and no derivative of
 * them in the matrix.
 *
 * It is solved by a Newton method whose matrix is that at x1, and after its first step that of
 * where it led (drag and contact with the tangent at x1), improved by Broyden's updates; contact's
 * part is renewed where it changes. Where that fails: the exact matrix at every iterate. */
#include "path.h"

enum { QUASI_NEWTON = 30, HALVINGS = 6 };

/* g += factor J_1^T M y_b, its turn and modal parts. */
static void inertia(const Path* p, const Node* b, double factor, double* g) {
  const int kp = p->body->kp;
  const Node* n1 = p->n1;
  double C[9], N[9], M[9], turn[3];
  mul_mtm(n1->R, b->R, C);
  moments_pair(n1->P, b->zeta, kp, N);
  for (int i = 0; i < 9; i++) C[i] *= factor;
  to_world(b->R, N, n1->R, M); /* sum m y_b y_1^T: sum y_1 x y_b is its vee */
  vee(M, turn);
  for (int i = 0; i < 3; i++) g[3 + i] += factor * turn[i];
  const double* restrict zeta = b->zeta;
  for (int c = 0; c < p->body->r; c++) {
    const double* restrict Q = n1->Q + (size_t)9 * kp * c; /* ji: sum m Phi_a,j (B dz1)_i */
    double s = 0;
    for (int a = 0; a < kp; a++)
      s += zeta[a] * (C[0] * Q[a] + C[3] * Q[kp + a] + C[6] * Q[2 * kp + a] + C[1] * Q[3 * kp + a] +
                      C[4] * Q[4 * kp + a] + C[7] * Q[5 * kp + a] + C[2] * Q[6 * kp + a] +
                      C[5] * Q[7 * kp + a] + C[8] * Q[8 * kp + a]);
    g[6 + c] += s;
  }
}

/* g -= J_1^T f for forces f (3 x n) on points at y from the centre, with modal derivatives Jq */
static void force(const double* f, const double* y, const double* Jq, int r, int n, double* g) {
  double turn[3];
  sum_cross(y, f, n, turn);
  for (int i = 0; i < 3; i++) g[i] -= sum(f + i * n, n), g[3 + i] -= turn[i];
  double work[DP_MAX_MODES] = {0};
  products(f, 1, Jq, r, 3 * n, work, r);
  for (int c = 0; c < r; c++) g[6 + c] -= work[c];
}

/* Places of the feet at node 1, and the given forces on them. */
static void feet_forces(Path* p) {
  const Body* b = p->body;
  const int r = b->r, nf = p->feet.np;
  double local[DP_MAX_MODES * 3 * DP_MAX_FEET], f[3 * DP_MAX_FEET] = {0};
  field_apply(b, p->feet.field, 1, p->n1->zeta, nf, local);
  rotate(p->n1->R, local, nf, p->feet_y);
  field_apply(b, p->feet.field, r, p->n1->dz, nf, local);
  for (int c = 0; c < r; c++) rotate(p->n1->R, local + c * 3 * nf, nf, p->feet_Jq + c * 3 * nf);
  for (int s = 0; s < p->feet.n; s++)
    for (int i = 0; i < 3; i++) f[i * nf + s] = p->u[r + 3 * s + i];
  force(f, p->feet_y, p->feet_Jq, r, nf, p->base);
}

void path_prepare(Path* p) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double ih2 = 1 / (p->h * p->h), *par = p->par;
  const double kc = par[DP_CONTROL], beta = par[DP_DAMPING] / (2 * p->h);
  const Node *n0 = p->n0, *n1 = p->n1;
  double* g = p->base;
  memset(g, 0, sizeof p->base);
  *p->spent += (1. + r) * 9 * kp * kp;
  moments_apply(b, 1 + r, n1->zeta, n1->P);
  p->n1->moments_known = 1;
  inertia(p, n0, ih2, g);
  for (int i = 0; i < 3; i++) g[i] += ih2 * b->mass * (n0->at.c[i] - 2 * n1->at.c[i]);
  g[2] -= b->mass * par[DP_GRAVITY];
  for (int c = 0; c < r; c++) { /* J_1^T M y_1: the basis is orthonormal */
    const double* dz = n1->dz + c * kp;
    g[6 + c] -= 2 * ih2 * (inner(dz, b->trace, kp) + inner(dz, n1->zeta, kp));
    g[6 + c] += b->stiffness[c] * ((1 + kc) * .25 * (n0->at.q[c] + 2 * n1->at.q[c]) - kc * p->u[c] -
                                   beta * n0->at.q[c]);
  }
  /* righting: torque D (R e_z) x e_z */
  const double D = b->mass * STANDARD_GRAVITY * par[DP_RIGHTING];
  g[3] -= D * n1->R[5], g[4] += D * n1->R[2];
  if (has_drag(p->body, p->par)) {
    for (int s = 0; s < 3 * np; s++) {
      p->mean01[s] = .5 * (n0->area[s] + n1->area[s]);
      p->area12[s] = 1.5 * n1->area[s] - .5 * n0->area[s];
    }
    interval_drag(p, n0, n1, p->mean01, p->f01, p->D01);
  }
  if (p->feet.n) feet_forces(p);
  touch_prepare(p);
}

void path_residual(Path* p) {
  const Body* b = p->body;
  const int r = b->r, np = b->np;
  const double ih2 = 1 / (p->h * p->h), *par = p->par;
  const double elastic = (1 + par[DP_CONTROL]) * .25 + par[DP_DAMPING] / (2 * p->h);
  const Node *n1 = p->n1, *n2 = p->n2;
  double* g = p->g;
  memcpy(g, p->base, sizeof p->base);
  inertia(p, n2, ih2, g);
  for (int i = 0; i < 3; i++) g[i] += ih2 * b->mass * n2->at.c[i];
  for (int c = 0; c < r; c++) g[6 + c] += b->stiffness[c] * elastic * n2->at.q[c];
  if (has_drag(p->body, p->par)) {
    interval_drag(p, n1, n2, p->area12, p->f12, NULL);
    double* restrict f = p->mean_f;
    for (int s = 0; s < 3 * np; s++) f[s] = .5 * (p->f01[s] + p->f12[s]);
    force(f, n1->y, n1->Jq, r, np, g);
  }
  touch_forces(p);
  if (p->m) force(p->near_f, p->near_y1, p->near_Jq, r, p->mp, g);
}

/* Where -alpha step leads from a configuration. */
static Pose moved(const Path* p, const Pose* from, const double* step, double alpha) {
  Pose to = {{0}, {0}, {0}};
  double turn[3], dq[4];
  for (int i = 0; i < 3; i++)
    to.c[i] = from->c[i] - alpha * step[i], turn[i] = -alpha * step[3 + i];
  quat_exp(turn, dq);
  quat_mul(dq, from->quat, to.quat);
  quat_normalize(to.quat);
  for (int c = 0; c < p->body->r; c++) to.q[c] = from->q[c] - alpha * step[6 + c];
  return to;
}

/* The first guess: the motion goes on as it was. */
static void go_on(const Path* p, Pose* guess) {
  const Pose *x0 = &p->n0->at, *x1 = &p->n1->at;
  const double back[4] = {x0->quat[0], -x0->quat[1], -x0->quat[2], -x0->quat[3]};
  double turn[4];
  quat_mul(x1->quat, back, turn);
  quat_mul(turn, x1->quat, guess->quat);
  quat_normalize(guess->quat);
  for (int i = 0; i < 3; i++) guess->c[i] = 2 * x1->c[i] - x0->c[i];
  guess->c[2] += p->h * p->h * p->par[DP_GRAVITY];
  for (int c = 0; c < p->body->r; c++) guess->q[c] = 2 * x1->q[c] - x0->q[c];
}

/* The matrix without contact: inertia with the tangent at node b, drag at the iterate's places. */
static void free_matrix(Path* p, const Node* b, double* H) {
  memset(H, 0, sizeof p->H);
  inertia_matrix(p, b, H);
  if (!has_drag(p->body, p->par)) return;
  interval_drag(p, p->n1, p->n2, p->area12, p->f12, p->D12);
  drag_matrix_of_1(p, H);
}

/* The inverse of a matrix: its factors and Broyden's rank-one updates of it, made of the last steps
 * (the next one is steps[kept]). */
typedef struct {
  Factors f;
  int n, kept; /* unknowns; updates */
  double steps[QUASI_NEWTON + 1][MAX_N];
  double size2[QUASI_NEWTON + 1]; /* |step|^2 */
} Inverse;

/* Start anew from p->H, with the step that it gives; 0 if it is singular. */
static int inverse_begin(Inverse* v, const Path* p) {
  v->n = 6 + p->body->r, v->kept = 0;
  if (!factorise(&v->f, p->H, v->n, 0)) return 0;
  solve(&v->f, p->g, v->steps[0]);
  v->size2[0] = inner(v->steps[0], v->steps[0], v->n);
  return 1;
}

/* next = inverse g */
static void inverse_apply(const Inverse* v, const double* g, double* next) {
  solve(&v->f, g, next);
  for (int j = 0; j < v->kept; j++) {
    const double share = inner(v->steps[j], next, v->n) / v->size2[j];
    for (int i = 0; i < v->n; i++) next[i] += share * v->steps[j + 1][i];
  }
}

/* Broyden's update by a whole step that left `next`; 0 if that is too far from linear. */
static int inverse_update(Inverse* v, const double* next) {
  const double along = 1 - inner(v->steps[v->kept], next, v->n) / v->size2[v->kept];
  if (!(along > .1)) return 0;
  double* step = v->steps[++v->kept];
  for (int i = 0; i < v->n; i++) step[i] = next[i] / along;
  v->size2[v->kept] = inner(step, step, v->n);
  return 1;
}

/* Move by as much of the step as makes the next one, with the same inverse, shorter (Deuflhard's
 * natural monotonicity test); returns the share of it, 0 if none does. */
static double search(Path* p, const Inverse* v, int what, double* next) {
  const Pose from = p->n2->at;
  const double *step = v->steps[v->kept], turn = largest_of(step + 3, v->n - 3);
  double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
  for (int halvings = 0; halvings <= HALVINGS; halvings++, alpha *= .5) {
    const Pose to = moved(p, &from, step, alpha);
    node_set(p, p->n2, &to, what);
    path_residual(p);
    inverse_apply(v, p->g, next);
    const double reduced = 1 - .25 * alpha;
    if (inner(next, next, v->n) <= reduced * reduced * v->size2[v->kept]) return alpha;
  }
  return 0;
}

/* The last step, after which nothing is left: no equation is looked at any more, only what
 * touches. */
static int finish(Path* p, const Inverse* v) {
  const Pose to = moved(p, &p->n2->at, v->steps[v->kept], 1);
  node_set(p, p->n2, &to, terrain_parts(&p->terrain) ? SHAPE : PLACE);
  return 1;
}

/* Newton with the matrix at node 1 for the first step, then that of where it led, and Broyden's
 * updates of it; the matrix is made anew, with contact as it is, where that is far from linear. 1
 * if it converged: the rate of convergence tells what a step will leave, which is held against the
 * tolerance squared. */
static int quasi_newton(Path* p, const Pose* guess, dp_info* info) {
  const int n = 6 + p->body->r;
  const double tolerance = p->par[DP_TOLERANCE] * p->par[DP_TOLERANCE];
  double free[MAX_N * MAX_N], next[MAX_N], before = 0;
  Inverse v;
  node_set(p, p->n2, guess, PLACES);
  free_matrix(p, p->n1, free);
  path_residual(p);
  for (int k = 0, fresh = 1; k < QUASI_NEWTON && *p->spent < DP_MAX_WORK; k++) {
    info->iterations++;
    if (fresh) {
      memcpy(p->H, free, sizeof(double) * n * n);
      if (p->m) touch_matrix(p, 0, p->H);
      if (!inverse_begin(&v, p)) return 0;
    }
    const double largest = info->residual = largest_of(v.steps[v.kept], n);
    if (!(largest < 1e100)) return 0;
    const double rate = before > 0 ? fmin(1, largest / before) : 1;
    if (largest * rate < tolerance) return finish(p, &v);
    const double alpha = search(p, &v, k ? PLACES : TANGENT, next);
    if (alpha == 0) return 0;
    before = largest;
    if (k == 0) free_matrix(p, p->n2, free);
    const int far = alpha < 1 || (p->m && inner(next, next, n) > .01 * v.size2[v.kept]);
    fresh = k == 0 || far || !inverse_update(&v, next);
  }
  return 0;
}

/* Newton with the exact matrix; 1 if it converged. */
static int newton(Path* p, const Pose* guess, dp_info* info) {
  const int n = 6 + p->body->r, limit = (int)fmin(p->par[DP_MAX_NEWTON], 1000);
  double next[MAX_N];
  Inverse v;
  node_set(p, p->n2, guess, TANGENT | DRAG_TANGENT);
  path_residual(p);
  for (int k = 0; k < limit && *p->spent < DP_MAX_WORK; k++) {
    info->iterations++;
    variational_matrix(p);
    if (!inverse_begin(&v, p)) return 0;
    info->residual = largest_of(v.steps[0], n);
    if (!(info->residual < 1e100)) return 0;
    if (info->residual < p->par[DP_TOLERANCE]) return finish(p, &v); /* quadratic */
    if (search(p, &v, TANGENT | DRAG_TANGENT, next) == 0) return 0;
  }
  return 0;
}

static int solve_from(Path* p, const Pose* start, dp_info* info) {
  int used = 1, done = quasi_newton(p, start, info);
  if (!done) used = 2, done = newton(p, start, info);
  if (used > info->attempts) info->attempts = used;
  return done;
}

int variational_solve(Path* p, const Pose* guess, dp_info* info) {
  Pose start;
  if (guess) start = *guess;
  else go_on(p, &start);
  while (solve_from(p, &start, info)) {
    if (!touch_missed(p)) return 1;
    start = p->n2->at; /* and once more with what touches there, too */
  }
  return 0;
}
