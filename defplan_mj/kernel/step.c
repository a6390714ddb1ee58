/* A control step: substeps from node to node of a path, by the integrator of the options, with
 * their derivatives by the implicit function theorem; rollouts.
 *
 * The state holds the last node and, in its velocities, the one before; they are recomputed from
 * it, so that a saved state replays to the bit. A substep without a solution is divided: the whole
 * step is done again with twice as many. */

#include "euler.h"
#include "path.h"

/* --- states and nodes */

static double substep(const Parts* p, int division) {
  return p->model->par[DP_TIMESTEP] / (p->substeps * division);
}

/* --- one substep, by either integrator */

static const double HALF_TURN = 3.14; /* rad */

/* The memory of a substep. */
typedef struct {
  const Parts* parts;
  int euler, n;
  Work work;
  Path path;
  double spent;               /* multiplications since the step began: DP_MAX_WORK ends it */
  const double* origin; /* what the nodes' places are told from: x's, so that no digit is lost */
  double input[DP_MAX_INPUT]; /* of the substep */
} Solver;

static size_t solver_lay(Solver* s, const Parts* parts, double* memory) {
  s->parts = parts, s->euler = parts->euler, s->n = 6 + parts->body.r;
  s->spent = 0, s->work.spent = s->path.spent = &s->spent;
  return s->euler ? work_lay(&s->work, parts, memory) : path_lay(&s->path, parts, memory);
}
#define SOLVER(s, parts)                                                 \
  Solver s;                                                              \
  double memory_of_##s[solver_lay(&s, parts, NULL) + PAD];               \
  solver_lay(&s, parts, aligned(memory_of_##s))

/* Share of the new target in that of substep k of n: at node 1, for implicit Euler at its end. */
static double share_of(const Parts* p, int k, int n) { return (double)(p->euler ? k + 1 : k) / n; }

/* Target of substep k of n on its way from the last one; the forces on the feet are held. */
static void set_input(Solver* s, const double* last, const double* u, int k, int n) {
  const int r = s->parts->body.r;
  const double share = share_of(s->parts, k, n);
  for (int c = 0; c < r; c++) s->input[c] = share == 1 ? u[c] : last[c] + share * (u[c] - last[c]);
  memcpy(s->input + r, u + r, sizeof(double) * (s->parts->nu - r));
}

/* Next to the last two nodes, of which the path keeps what it knows. */
static int solve_substep(Solver* s, int first, const Pose* x0, const Pose* x1, double h,
                         const Pose* guess, Pose* x2, dp_info* info) {
  if (s->euler) {
    work_begin(&s->work, s->origin, x0, x1, s->input, h);
    return euler_solve(&s->work, guess, x2, info);
  }
  Path* p = &s->path;
  p->u = s->input, p->h = h, p->origin = s->origin;
  if (first) node_set(p, p->n0, x0, AREAS);
  else {
    Node* free = p->n0;
    p->n0 = p->n1, p->n1 = p->n2, p->n2 = free;
  }
  node_set(p, p->n1, x1, TANGENT | DRAG_TANGENT | AREAS);
  path_prepare(p);
  dp_info found = {0, 0, 0, 1, 0};
  const int done = variational_solve(p, guess, &found);
  info->iterations += found.iterations, info->residual = found.residual;
  if (found.attempts > info->attempts) info->attempts = found.attempts;
  *x2 = p->n2->at;
  return done;
}

/* How far from free motion a substep may end, in q and in rad. The equations of a coarse step have
 * several solutions; the one that goes on with the motion is near it, so one far from it asks for
 * finer substeps. */
static const double MAX_DEVIATION = 1.2;

/* Whether x[2] is that far from where the motion from x[0] to x[1] would have gone by itself. */
static int strays(int r, const Pose* x) {
  double turn[4], free[4], dq[4], w[3];
  quat_between(x[0].quat, x[1].quat, turn), quat_mul(turn, x[1].quat, free);
  quat_between(free, x[2].quat, dq), quat_log(dq, w);
  double most = sqrt(dot3(w, w));
  for (int c = 0; c < r; c++) most = fmax(most, fabs(x[2].q[c] - 2 * x[1].q[c] + x[0].q[c]));
  return !(most < MAX_DEVIATION);
}

/* A step's nodes: nodes[0] is before x, nodes[1] is x, then one a substep. Returns the number of
 * parts that substeps were divided into, first or more, 0 if there is no solution. `near` (NULL:
 * none): a state near the solution. `nodes` holds 2 + substeps * most. */
static int solve_nodes(Solver* s, const double* x, const double* u, const double* near, int first,
                       int most, Pose* nodes, dp_info* info) {
  const Parts* p = s->parts;
  const int r = p->body.r;
  const double* last = x + 13 + 2 * r;
  s->origin = x;
  const double spin = sqrt(dot3(x + 10 + r, x + 10 + r));
  for (int division = first; division <= most && s->spent < DP_MAX_WORK;) {
    const int n = p->substeps * division;
    const double h = substep(p, division);
    if (!(h * spin < HALF_TURN)) { /* two nodes do not tell it from another turn */
      division *= 2;
      continue;
    }
    Pose guess[2];
    state_nodes(r, x, h, nodes + 1, nodes);
    if (near) {
      state_nodes(r, near, h, guess, guess + 1);
      for (int i = 0; i < 6; i++) guess[i / 3].c[i % 3] += near[i % 3] - x[i % 3];
    }
    int k = 0;
    for (; k < n; k++) {
      set_input(s, last, u, k, n);
      const Pose* from = near && division == 1 && k >= n - 2 ? guess + (n - 1 - k) : NULL;
      int done = solve_substep(s, k == 0, nodes + k, nodes + k + 1, h, from, nodes + k + 2, info);
      const Pose* to = nodes + k + 2;
      if (!done || !is_finite(to->c, 3) || !is_finite(to->quat, 4) || !is_finite(to->q, r)) break;
      if (!p->euler && 2 * division <= DP_MAX_DIVISION && strays(r, nodes + k)) break;
    }
    info->division = division;
    if (k == n) return division;
    if (near) near = NULL; /* a bad guess: once more as without one */
    else division *= 2;
  }
  return 0;
}

/* What a step returns when it can't be done: x without what is not finite. */
static void fall_back(int r, const double* x, const double* u, double* x_next) {
  const int nx = 13 + 3 * r;
  for (int i = 0; i < nx; i++) x_next[i] = isfinite(x[i]) ? x[i] : 0;
  for (int c = 0; c < r && u; c++)
    if (isfinite(u[c])) x_next[13 + 2 * r + c] = u[c];
  double norm = 0;
  for (int i = 3; i < 7; i++) norm += x_next[i] * x_next[i];
  if (norm > 1e-300 && norm < 1e300) return;
  x_next[3] = 1, x_next[4] = x_next[5] = x_next[6] = 0;
}

/* Whether a step can be tried: finite numbers, a quaternion, a time step. */
static int sane(const Parts* p, const double* x, const double* u) {
  const int r = p->body.r;
  double norm = 0;
  for (int i = 3; i < 7; i++) norm += x[i] * x[i];
  return is_finite(x, 13 + 3 * r) && is_finite(u, p->nu) && norm > 1e-300 && norm < 1e300;
}

static int step(const Parts* p, const double* x, const double* u, const double* near,
                double* x_next, dp_info* info) {
  const int r = p->body.r;
  dp_info local;
  if (!info) info = &local;
  *info = (dp_info){0, 0, 1, 1, 0};
  if (sane(p, x, u)) {
    const int rough = p->substeps * 4 + 2; /* nearly always enough */
    Pose few[rough];
    SOLVER(s, p);
    int division = solve_nodes(&s, x, u, near, 1, 4, few, info);
    if (division) {
      const Pose* end = few + p->substeps * division + 1;
      state_pack(r, x, end, end - 1, u, substep(p, division), x_next);
    } else {
      Pose nodes[p->substeps * DP_MAX_DIVISION + 2];
      division = solve_nodes(&s, x, u, NULL, 8, DP_MAX_DIVISION, nodes, info);
      const Pose* end = nodes + p->substeps * division + 1;
      if (division) state_pack(r, x, end, end - 1, u, substep(p, division), x_next);
    }
    info->failed = !division || !is_finite(x_next, 13 + 3 * r);
  }
  if (info->failed) fall_back(r, x, u, x_next);
  return info->failed;
}

int dp_step(const dp_model* m, const double* x, const double* u, double* x_next, dp_info* info) {
  return dp_step_near(m, x, u, NULL, x_next, info);
}

int dp_step_near(const dp_model* m, const double* x, const double* u, const double* near,
                 double* x_next, dp_info* info) {
  Parts p;
  const int wrong = parts_view(&p, m);
  if (!wrong && (!near || sane(&p, near, u))) return step(&p, x, u, near, x_next, info);
  if (wrong != NO_BODY) fall_back(p.body.r, x, u, x_next);
  if (info) *info = (dp_info){0, 0, 1, 1, 0};
  return 1;
}

int dp_rollout(const dp_model* m, int N, const double* u, double* xs, long* iterations) {
  Parts p;
  const int wrong = parts_view(&p, m);
  if (iterations) *iterations = 0;
  if (wrong == NO_BODY) return N;
  const int nx = 13 + 3 * p.body.r;
  int failed = 0;
  long count = 0;
  for (int i = 0; i < N; i++) {
    dp_info info = {0, 0, 1, 1, 0};
    double *x = xs + (size_t)i * nx, *next = x + nx;
    if (wrong) fall_back(p.body.r, x, NULL, next);
    else step(&p, x, u + (size_t)i * p.nu, NULL, next, &info);
    failed += info.failed, count += info.iterations;
  }
  if (iterations) *iterations = count;
  return failed;
}

/* --- derivatives */

/* Set the solver to the solved substep k of n, from its last backwards; 0 if its matrix is
 * singular. *left is how far the nodes are from the solution: the Newton step that is left. */
static int linearise(Solver* s, const Pose* nodes, int k, int n, double h, Factors* f,
                     double* left) {
  double step[MAX_N];
  const double *H, *g;
  int symmetric = 0;
  if (s->euler) {
    work_begin(&s->work, s->origin, nodes + k, nodes + k + 1, s->input, h);
    euler_linearise(&s->work, nodes + k + 2);
    H = s->work.H, g = s->work.g, symmetric = !terrain_parts(&s->work.terrain);
  } else {
    Path* p = &s->path;
    p->u = s->input, p->h = h, p->origin = s->origin;
    if (k == n - 1) {
      node_set(p, p->n2, nodes + k + 2, TANGENT | DRAG_TANGENT);
      node_set(p, p->n1, nodes + k + 1, TANGENT | DRAG_TANGENT | AREAS);
    } else {
      Node* free = p->n2;
      p->n2 = p->n1, p->n1 = p->n0, p->n0 = free;
    }
    node_set(p, p->n0, nodes + k, k ? TANGENT | DRAG_TANGENT | AREAS : TANGENT | AREAS);
    path_prepare(p);
    touch_missed(p);
    path_residual(p);
    variational_matrix(p);
    H = p->H, g = p->g;
  }
  if (!factorise(f, H, s->n, symmetric)) return 0;
  solve(f, g, step);
  *left = 0;
  for (int i = 0; i < s->n; i++) *left = fabs(step[i]) <= *left ? *left : fabs(step[i]);
  if (!s->euler) variational_pull_prepare(&s->path);
  return isfinite(*left);
}

static void pull_substep(Solver* s, const double* lambda, double* a1, double* a0, double* au) {
  if (s->euler) euler_pull(&s->work, lambda, a1, a0, au);
  else variational_pull(&s->path, lambda, a1, a0, au);
}

/* The nodes of a solved step. Two of them are in each of its states, so that with one or two
 * substeps nothing has to be solved again; others are. */
static int recover_nodes(Solver* s, const double* x, const double* u, const double* x_next,
                         Pose* nodes) {
  const Parts* p = s->parts;
  const int r = p->body.r, n = p->substeps;
  const double h = substep(p, 1);
  dp_info info = {0, 0, 0, 1, 0};
  s->origin = x;
  state_nodes(r, x, h, nodes + 1, nodes);
  for (int k = 0; k < n - 2; k++) {
    set_input(s, x + 13 + 2 * r, u, k, n);
    if (!solve_substep(s, k == 0, nodes + k, nodes + k + 1, h, NULL, nodes + k + 2, &info))
      return 0;
  }
  Pose before;
  state_nodes(r, x_next, h, nodes + n + 1, &before);
  for (int i = 0; i < 3; i++)
    nodes[n + 1].c[i] = x_next[i] - x[i], before.c[i] += nodes[n + 1].c[i];
  if (n > 1) nodes[n] = before;
  return 1;
}

/* What is done with each linearised substep, from the last backwards. */
typedef void (*Backward)(Solver* s, const Factors* f, int k, int n, void* data);

/* Go backwards through the substeps of the step from x to x_next, with its nodes; returns 0, or 1
 * if a matrix is singular. begin(data, nodes, n, h) comes first, and again if the step was a
 * divided one. */
static int backward(Solver* s, const double* x, const double* u, const double* x_next,
                    void (*begin)(Solver*, const Pose*, int, double, void*), Backward each,
                    void* data) {
  const Parts* p = s->parts;
  const int r = p->body.r;
  Factors f;
  double left = 0;
  if (!sane(p, x, u) || !sane(p, x_next, u)) return 1;
  s->spent = 0;
  for (int again = 0; again < 2; again++) {
    Pose nodes[p->substeps * (again ? DP_MAX_DIVISION : 1) + 2];
    int division = 1, k;
    dp_info info = {0, 0, 0, 1, 0};
    if (!again && !recover_nodes(s, x, u, x_next, nodes)) continue;
    if (again && !(division = solve_nodes(s, x, u, NULL, 1, DP_MAX_DIVISION, nodes, &info)))
      return 1;
    const int n = p->substeps * division;
    const double h = substep(p, division);
    begin(s, nodes, n, h, data);
    for (k = n - 1; k >= 0; k--) {
      set_input(s, x + 13 + 2 * r, u, k, n);
      if (!linearise(s, nodes, k, n, h, &f, &left)) break;
      if (!again && left > 1e-6) break; /* not these nodes: the step was divided */
      each(s, &f, k, n, data);
    }
    if (k < 0) return 0;
  }
  return 1;
}

typedef struct {
  const double *x, *g_next;
  double *gx, *gu, h;
  Pose last;
  double later[MAX_N], earlier[MAX_N]; /* gradients over nodes k + 2 and k + 1 */
} Adjoint;

static void adjoint_begin(Solver* s, const Pose* nodes, int n, double h, void* data) {
  Adjoint* a = data;
  const int r = s->parts->body.r;
  a->h = h, a->last = nodes[1];
  memset(a->gu, 0, sizeof(double) * s->parts->nu);
  memset(a->gx + 13 + 2 * r, 0, sizeof(double) * r);
  state_pack_pull(r, nodes + n + 1, nodes + n, h, a->g_next, a->later, a->earlier, a->gu);
}

static void adjoint_substep(Solver* s, const Factors* f, int k, int n, void* data) {
  Adjoint* a = data;
  const int r = s->parts->body.r, nu = s->parts->nu;
  double lambda[MAX_N], a1[MAX_N], a0[MAX_N], au[DP_MAX_INPUT] = {0};
  const double share = share_of(s->parts, k, n);
  solve_transposed(f, a->later, lambda);
  pull_substep(s, lambda, a1, a0, au);
  for (int i = 0; i < s->n; i++) a->later[i] = a->earlier[i] - a1[i], a->earlier[i] = -a0[i];
  for (int c = 0; c < nu; c++) a->gu[c] -= (c < r ? share : 1) * au[c];
  for (int c = 0; c < r; c++) a->gx[13 + 2 * r + c] -= (1 - share) * au[c];
}

static int adjoint(Solver* s, const double* x, const double* u, const double* x_next,
                   const double* g_next, double* gx, double* gu) {
  const int r = s->parts->body.r;
  const int nx = 13 + 3 * r, nu = s->parts->nu;
  Adjoint a = {.x = x, .g_next = g_next, .gx = gx, .gu = gu};
  int done =
      is_finite(g_next, nx) && !backward(s, x, u, x_next, adjoint_begin, adjoint_substep, &a);
  if (done) {
    state_nodes_pull(r, x, &a.last, a.h, a.later, a.earlier, gx);
    done = is_finite(gx, nx) && is_finite(gu, nu);
  }
  if (!done) memset(gx, 0, sizeof(double) * nx), memset(gu, 0, sizeof(double) * nu);
  return !done;
}

int dp_step_adj(const dp_model* m, const double* x, const double* u, const double* x_next,
                const double* g_next, double* gx, double* gu) {
  Parts p;
  if (parts_view(&p, m)) return 1;
  SOLVER(s, &p);
  return adjoint(&s, x, u, x_next, g_next, gx, gu);
}

int dp_rollout_adj(const dp_model* m, int N, const double* u, const double* xs, double* gxs,
                   double* gu) {
  Parts p;
  if (parts_view(&p, m)) return N;
  const int nx = 13 + 3 * p.body.r;
  int failed = 0;
  double gx[MAX_STATE];
  SOLVER(s, &p);
  for (int i = N - 1; i >= 0; i--) {
    failed += adjoint(&s, xs + (size_t)i * nx, u + (size_t)i * p.nu, xs + (size_t)(i + 1) * nx,
                      gxs + (size_t)(i + 1) * nx, gx, gu + (size_t)i * p.nu);
    for (int j = 0; j < nx; j++) gxs[(size_t)i * nx + j] += gx[j];
  }
  return failed;
}

/* Jacobian: all rows of the adjoint at once, the seeds in columns of `later` and `earlier`. */
typedef struct {
  const double* x;
  double *A, *B, h;
  Pose last;
  int nx;
  double later[MAX_STATE][MAX_N], earlier[MAX_STATE][MAX_N];
} Jacobian;

static void jacobian_begin(Solver* s, const Pose* nodes, int n, double h, void* data) {
  Jacobian* j = data;
  const int r = s->parts->body.r, nu = s->parts->nu;
  j->h = h, j->last = nodes[1];
  memset(j->A, 0, sizeof(double) * j->nx * j->nx), memset(j->B, 0, sizeof(double) * j->nx * nu);
  for (int o = 0; o < j->nx; o++) {
    double seed[MAX_STATE] = {0};
    seed[o] = 1;
    state_pack_pull(r, nodes + n + 1, nodes + n, h, seed, j->later[o], j->earlier[o],
                    j->B + (size_t)o * nu);
  }
}

static void jacobian_substep(Solver* s, const Factors* f, int k, int n, void* data) {
  Jacobian* j = data;
  const int r = s->parts->body.r, nu = s->parts->nu, dim = s->n;
  double M1[MAX_N][MAX_N], M0[MAX_N][MAX_N], Mu[MAX_N][DP_MAX_INPUT];
  const double share = share_of(s->parts, k, n);
  for (int i = 0; i < dim; i++) { /* rows: lambda = e_i */
    double unit[MAX_N] = {0};
    unit[i] = 1;
    memset(Mu[i], 0, sizeof Mu[i]);
    pull_substep(s, unit, M1[i], M0[i], Mu[i]);
  }
  for (int o = 0; o < j->nx; o++) {
    double lambda[MAX_N], g1[MAX_N], g0[MAX_N], gu[DP_MAX_INPUT] = {0};
    solve_transposed(f, j->later[o], lambda);
    for (int i = 0; i < dim; i++) g1[i] = j->earlier[o][i], g0[i] = 0;
    for (int i = 0; i < dim; i++) {
      for (int c = 0; c < dim; c++) g1[c] -= lambda[i] * M1[i][c], g0[c] -= lambda[i] * M0[i][c];
      for (int c = 0; c < nu; c++) gu[c] -= lambda[i] * Mu[i][c];
    }
    memcpy(j->later[o], g1, sizeof g1), memcpy(j->earlier[o], g0, sizeof g0);
    for (int c = 0; c < nu; c++) j->B[(size_t)o * nu + c] += (c < r ? share : 1) * gu[c];
    for (int c = 0; c < r; c++) j->A[(size_t)o * j->nx + 13 + 2 * r + c] += (1 - share) * gu[c];
  }
}

int dp_step_jac(const dp_model* m, const double* x, const double* u, const double* x_next,
                double* A, double* B) {
  Parts p;
  if (parts_view(&p, m)) return 1;
  const int r = p.body.r, nx = 13 + 3 * r;
  SOLVER(s, &p);
  Jacobian j = {.x = x, .A = A, .B = B, .nx = nx};
  if (backward(&s, x, u, x_next, jacobian_begin, jacobian_substep, &j)) return 1;
  for (int o = 0; o < nx; o++)
    state_nodes_pull(r, x, &j.last, j.h, j.later[o], j.earlier[o], A + (size_t)o * nx);
  return !is_finite(A, (size_t)nx * nx) || !is_finite(B, (size_t)nx * p.nu);
}
