/* The kernel as CasADi external functions, with exact derivatives.
 *
 * A slot holds a model and a number of steps N; slot s is seen by CasADi as
 *   defplan_step_<s>     (x, u) -> x_next           with jac_ and adj1_   (only for N = 1)
 *   defplan_rollout_<s>  (x0, u: nu x N) -> x: nx x N  with adj1_           (states after each step)
 *   defplan_feet_<s>     x -> p: 3 x n_feet         with jac_             (where the feet are)
 * CasADi counts the references to its functions through _incref and _decref: a slot is free again
 * when its opener has closed it and the last function on it is gone. */
#include <stdatomic.h>
#include <stdlib.h>

#include "work.h"

typedef long long Int; /* casadi_int */
enum { N_SLOTS = 64 };
enum { STATE, INPUTS, STATES, JAC_X, JAC_U, FEET, JAC_FEET, N_DIMENSIONS }; /* kinds of arguments */

/* ipopt asks for a value and then for a gradient at the same point: the last few rollouts are kept. */
enum { N_KEPT = 4 };

typedef struct {
  atomic_int references; /* 0: free, -1: being filled or emptied */
  double* memory;        /* the model's arrays, kept rollouts */
  double* kept;          /* N_KEPT of (x0, u, x); NULL for single steps */
  int n_kept, oldest;
  atomic_flag busy; /* guards the kept rollouts; who finds it set does without them */
  dp_model model;
  int steps, nu, nx, n_feet;
  Int dense[N_DIMENSIONS][3]; /* rows, columns, 1: CasADi's short form of a dense pattern */
} Slot;
static Slot slots[N_SLOTS];

/* Copy n doubles to *to and move it on; NULL stays NULL. */
static const double* keep(double** to, const double* from, size_t n) {
  if (!from) return NULL;
  double* copy = *to;
  memcpy(copy, from, n * sizeof(double));
  *to += n;
  return copy;
}

int dp_slot_open(const dp_model* m, int steps) {
  Parts p;
  if (steps < 1 || parts_view(&p, m)) return -2;
  for (int i = 0; i < N_SLOTS; i++) {
    Slot* s = slots + i;
    int unused = 0;
    if (!atomic_compare_exchange_strong(&s->references, &unused, -1)) continue;
    const size_t nu = p.nu, nx = 13 + 3 * (size_t)p.body.r, kept = steps > 1 ? nx + (nu + nx) * steps : 0;
    const size_t body = (size_t)m->body[2], terrain = m->terrain ? (size_t)m->terrain[0] : 0;
    const size_t feet = m->feet ? (size_t)m->feet[0] : 0;
    double* to = s->memory = malloc((body + terrain + feet + DP_N_PAR + N_KEPT * kept) * sizeof(double));
    if (!s->memory) {
      atomic_store(&s->references, 0);
      return -3;
    }
    s->model.body = keep(&to, m->body, body), s->model.par = keep(&to, m->par, DP_N_PAR);
    s->model.terrain = keep(&to, m->terrain, terrain), s->model.feet = keep(&to, m->feet, feet);
    s->kept = kept ? to : NULL, s->n_kept = s->oldest = 0;
    atomic_flag_clear(&s->busy);
    s->steps = steps, s->nu = p.nu, s->nx = (int)nx, s->n_feet = p.feet.n;
    const Int sizes[N_DIMENSIONS][2] = {{s->nx, 1}, {s->nu, steps}, {s->nx, steps}, {s->nx, s->nx},
                                        {s->nx, s->nu}, {3, s->n_feet}, {3 * s->n_feet, s->nx}};
    for (int d = 0; d < N_DIMENSIONS; d++)
      s->dense[d][0] = sizes[d][0], s->dense[d][1] = sizes[d][1], s->dense[d][2] = 1;
    atomic_store(&s->references, 1);
    return i;
  }
  return -1;
}

static void retain(Slot* s) { atomic_fetch_add(&s->references, 1); }

static void release(Slot* s) {
  int count = atomic_load(&s->references);
  while (!atomic_compare_exchange_weak(&s->references, &count, count == 1 ? -1 : count - 1)) {}
  if (count != 1) return;
  free(s->memory);
  atomic_store(&s->references, 0);
}

void dp_slot_close(int slot) {
  if (slot >= 0 && slot < N_SLOTS) release(slots + slot);
}

/* What CasADi asks about a function: names and dimensions of inputs and outputs. */
typedef struct {
  int n_in, n_out;
  const char *in[4], *out[2];
  int dimension_in[4], dimension_out[2];
} Signature;

static const Signature
    STEP = {2, 1, {"x", "u"}, {"x_next"}, {STATE, INPUTS}, {STATES}},
    STEP_JAC = {3, 2, {"x", "u", "out_x_next"}, {"jac_x_next_x", "jac_x_next_u"},
                {STATE, INPUTS, STATES}, {JAC_X, JAC_U}},
    STEP_ADJ = {4, 2, {"x", "u", "out_x_next", "adj_x_next"}, {"adj_x", "adj_u"},
                {STATE, INPUTS, STATES, STATES}, {STATE, INPUTS}},
    ROLLOUT = {2, 1, {"x0", "u"}, {"x"}, {STATE, INPUTS}, {STATES}},
    ROLLOUT_ADJ = {4, 2, {"x0", "u", "out_x", "adj_x"}, {"adj_x0", "adj_u"},
                   {STATE, INPUTS, STATES, STATES}, {STATE, INPUTS}},
    FEET_AT = {1, 1, {"x"}, {"p"}, {STATE}, {FEET}},
    FEET_JAC = {2, 1, {"x", "out_p"}, {"jac_p_x"}, {STATE, FEET}, {JAC_FEET}};

/* Work memory, doubles: the states and their gradients, the target shapes, two Jacobians. */
static size_t states_size(const Slot* s) { return (size_t)(s->steps + 1) * s->nx; }
static int work(const Slot* s, Int* arg, Int* res, Int* iw, Int* w) {
  if (arg) *arg = 4;
  if (res) *res = 2;
  if (iw) *iw = 0;
  if (w) *w = (Int)(2 * states_size(s) + 2 * (size_t)s->steps * s->nu + (size_t)s->nx * (s->nx + s->nu + 3 * s->n_feet));
  return 0;
}

/* A null input is all zeros; a null output is not wanted. */
static void read(const double* from, size_t n, double* to) {
  if (from) memcpy(to, from, n * sizeof(double));
  else memset(to, 0, n * sizeof(double));
}
static void write(const double* from, size_t n, double* to) {
  if (to) memcpy(to, from, n * sizeof(double));
}
static const double* shapes(const Slot* s, const double** arg, double* w) {
  double* u = w + 2 * states_size(s);
  if (!arg[1]) memset(u, 0, (size_t)s->steps * s->nu * sizeof(double));
  return arg[1] ? arg[1] : u;
}

/* The states of a kept rollout from w (x0) under u, or NULL. */
static const double* find(const Slot* s, const double* w, const double* u) {
  const size_t nx = s->nx, nu = (size_t)s->steps * s->nu, size = nx + nu + nx * s->steps;
  for (int i = 0; i < s->n_kept; i++) {
    const double* kept = s->kept + i * size;
    if (!memcmp(kept, w, nx * sizeof(double)) && !memcmp(kept + nx, u, nu * sizeof(double))) return kept + nx + nu;
  }
  return NULL;
}

static int evaluate(Slot* s, const double** arg, double** res, double* w) {
  const size_t nx = s->nx, nu = (size_t)s->steps * s->nu, n = nx * s->steps;
  const double* u = shapes(s, arg, w);
  read(arg[0], nx, w);
  if (s->kept && !atomic_flag_test_and_set(&s->busy)) {
    const double* x = find(s, w, u);
    if (x) write(x, n, res[0]);
    atomic_flag_clear(&s->busy);
    if (x) return 0;
  }
  if (dp_rollout(&s->model, s->steps, u, w, NULL)) return 1;
  if (s->kept && !atomic_flag_test_and_set(&s->busy)) {
    double* kept = s->kept + s->oldest * (nx + nu + n);
    write(w, nx, kept), write(u, nu, kept + nx), write(w + nx, n, kept + nx + nu);
    s->oldest = (s->oldest + 1) % N_KEPT, s->n_kept += s->n_kept < N_KEPT;
    atomic_flag_clear(&s->busy);
  }
  write(w + nx, n, res[0]);
  return 0;
}

static int adjoint(const Slot* s, const double** arg, double** res, double* w) {
  const size_t n = (size_t)s->steps * s->nx, nu = (size_t)s->steps * s->nu;
  double *x = w, *g = x + states_size(s), *gu = g + states_size(s) + nu;
  read(arg[0], s->nx, x), read(arg[2], n, x + s->nx);
  read(NULL, s->nx, g), read(arg[3], n, g + s->nx);
  if (dp_rollout_adj(&s->model, s->steps, shapes(s, arg, w), x, g, gu)) return 1;
  write(g, s->nx, res[0]), write(gu, nu, res[1]);
  return 0;
}

static int jacobian(const Slot* s, const double** arg, double** res, double* w) {
  const int nx = s->nx, nu = s->nu;
  double *x = w, *x_next = w + nx, *A = w + 2 * states_size(s) + 2 * (size_t)s->steps * nu, *B = A + nx * nx;
  read(arg[0], nx, x), read(arg[2], nx, x_next);
  if (dp_step_jac(&s->model, x, shapes(s, arg, w), x_next, A, B)) return 1;
  for (int i = 0; i < nx; i++) { /* to column-major */
    for (int j = 0; res[0] && j < nx; j++) res[0][j * nx + i] = A[i * nx + j];
    for (int j = 0; res[1] && j < nu; j++) res[1][j * nx + i] = B[i * nu + j];
  }
  return 0;
}

static int feet_at(const Slot* s, const double** arg, double** res, double* w) {
  read(arg[0], s->nx, w);
  if (res[0]) dp_feet(&s->model, w, res[0], NULL);
  return 0;
}

static int feet_jacobian(const Slot* s, const double** arg, double** res, double* w) {
  const int n = 3 * s->n_feet, nq = 7 + (s->nx - 13) / 3;
  double points[3 * DP_MAX_FEET], *jacobian = w + s->nx;
  if (!res[0]) return 0;
  read(arg[0], s->nx, w);
  dp_feet(&s->model, w, points, jacobian);
  for (int i = 0; i < n; i++) /* to column-major; positions do not depend on velocities */
    for (int j = 0; j < s->nx; j++) res[0][j * n + i] = j < nq ? jacobian[i * nq + j] : 0;
  return 0;
}

#define FUNCTION(name, s, signature, call)                                                        \
  DP_API Int name##_n_in(void) { return (signature).n_in; }                                       \
  DP_API Int name##_n_out(void) { return (signature).n_out; }                                     \
  DP_API const char* name##_name_in(Int i) { return (signature).in[i]; }                          \
  DP_API const char* name##_name_out(Int i) { return (signature).out[i]; }                        \
  DP_API const Int* name##_sparsity_in(Int i) { return slots[s].dense[(signature).dimension_in[i]]; } \
  DP_API const Int* name##_sparsity_out(Int i) { return slots[s].dense[(signature).dimension_out[i]]; } \
  DP_API int name##_work(Int* a, Int* r, Int* i, Int* w) { return work(slots + s, a, r, i, w); }  \
  DP_API void name##_incref(void) { retain(slots + s); }                                          \
  DP_API void name##_decref(void) { release(slots + s); }                                         \
  DP_API int name(const double** arg, double** res, Int* iw, double* w, int mem) {                \
    (void)iw, (void)mem;                                                                          \
    return call(slots + s, arg, res, w);                                                          \
  }
#define SLOT(s)                                                 \
  FUNCTION(defplan_step_##s, s, STEP, evaluate)                 \
  FUNCTION(jac_defplan_step_##s, s, STEP_JAC, jacobian)         \
  FUNCTION(adj1_defplan_step_##s, s, STEP_ADJ, adjoint)         \
  FUNCTION(defplan_rollout_##s, s, ROLLOUT, evaluate)           \
  FUNCTION(adj1_defplan_rollout_##s, s, ROLLOUT_ADJ, adjoint)   \
  FUNCTION(defplan_feet_##s, s, FEET_AT, feet_at)               \
  FUNCTION(jac_defplan_feet_##s, s, FEET_JAC, feet_jacobian)
#define EIGHT(a, b, c, d, e, f, g, h) SLOT(a) SLOT(b) SLOT(c) SLOT(d) SLOT(e) SLOT(f) SLOT(g) SLOT(h)
EIGHT(0, 1, 2, 3, 4, 5, 6, 7)
EIGHT(8, 9, 10, 11, 12, 13, 14, 15)
EIGHT(16, 17, 18, 19, 20, 21, 22, 23)
EIGHT(24, 25, 26, 27, 28, 29, 30, 31)
EIGHT(32, 33, 34, 35, 36, 37, 38, 39)
EIGHT(40, 41, 42, 43, 44, 45, 46, 47)
EIGHT(48, 49, 50, 51, 52, 53, 54, 55)
EIGHT(56, 57, 58, 59, 60, 61, 62, 63)
