/* The kernel as CasADi external functions, with exact derivatives.
 *
 * A slot holds a model and a number of steps N; slot s is seen by CasADi as
 *   defplan_step_<ss>    (x, u) -> x_next           with jac_ and adj1_   (only for N = 1)
 *   defplan_rollout_<ss> (x0, u: nu x N) -> x: nx x N  with adj1_   (states after each step)
 *   defplan_feet_<ss>    x -> p: 3 x n_feet         with jac_             (where the feet are)
 * CasADi counts the references to its functions through _incref and _decref: a slot is free again
 * when its opener has closed it and the last function on it is gone. A function names its model:
 * its config_args are the slot's key and sizes, which _config compares, so that a function that was
 * saved is not taken for one on another model. Why an evaluation failed: dp_slot_failure. */
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

#include "parts.h"

typedef long long Int; /* casadi_int */
enum { N_SLOTS = 64, N_KEY = 65, N_SIZES = 64 };
enum { STATE, INPUTS, STATES, JAC_X, JAC_U, FEET, JAC_FEET, N_DIMENSIONS }; /* kinds of arguments */

/* ipopt asks for a value, then for a gradient at the same point: the last rollouts are kept. */
enum { N_KEPT = 4 };

typedef struct {
  int references; /* 0: free; changed under the lock */
  double* memory; /* the model's arrays, kept rollouts */
  double* kept;   /* N_KEPT of (x0, u, x); NULL for single steps */
  int n_kept, oldest;
  atomic_flag busy; /* guards the kept rollouts; who finds it set does without them */
  atomic_int failure, told; /* DP_SLOT_*: of the last evaluation that failed; bits: said already */
  char key[N_KEY], sizes[N_SIZES];
  dp_model model;
  int steps, nu, nx, nq, n_feet;
  Int dense[N_DIMENSIONS][3]; /* rows, columns, 1: CasADi's short form of a dense pattern */
} Slot;
static Slot slots[N_SLOTS];
static atomic_flag table = ATOMIC_FLAG_INIT;

static void lock(void) {
  while (atomic_flag_test_and_set(&table)) {}
}
static void unlock(void) { atomic_flag_clear(&table); }

/* Copy n doubles to *to and move it on; NULL stays NULL. */
static const double* keep(double** to, const double* from, size_t n) {
  if (!from) return NULL;
  double* copy = *to;
  memcpy(copy, from, n * sizeof(double));
  *to += n;
  return copy;
}

/* Numbers in a state (kernel.h). */
static int state_size(const Parts* p) { return 13 + 3 * p->body.r; }

/* Fill a free slot; 0, or -3 without memory. */
static int fill(Slot* s, const dp_model* m, const Parts* p, int steps, const char* key) {
  const size_t nu = p->nu, nq = 7 + (size_t)p->body.r, nx = state_size(p);
  const size_t kept = steps > 1 ? nx + (nu + nx) * steps : 0, body = (size_t)m->body[2];
  const size_t terrain = m->terrain ? (size_t)m->terrain[0] : 0;
  const size_t feet = m->feet ? (size_t)m->feet[0] : 0;
  double* to = s->memory =
      malloc((body + terrain + feet + DP_N_PAR + N_KEPT * kept) * sizeof(double));
  if (!to) return -3;
  s->model.body = keep(&to, m->body, body), s->model.par = keep(&to, m->par, DP_N_PAR);
  s->model.terrain = keep(&to, m->terrain, terrain), s->model.feet = keep(&to, m->feet, feet);
  s->kept = kept ? to : NULL, s->n_kept = s->oldest = 0;
  atomic_flag_clear(&s->busy);
  atomic_store(&s->failure, 0), atomic_store(&s->told, 0);
  s->steps = steps, s->nu = p->nu, s->nx = (int)nx, s->nq = (int)nq, s->n_feet = p->feet.n;
  snprintf(s->key, N_KEY, "%s", key);
  snprintf(s->sizes, N_SIZES, "%d %d %d %d", steps, s->nx, s->nu, s->n_feet);
  const Int sizes[N_DIMENSIONS][2] = {{s->nx, 1}, {s->nu, steps}, {s->nx, steps}, {s->nx, s->nx},
                                      {s->nx, s->nu}, {3, s->n_feet}, {3 * s->n_feet, s->nx}};
  for (int d = 0; d < N_DIMENSIONS; d++)
    s->dense[d][0] = sizes[d][0], s->dense[d][1] = sizes[d][1], s->dense[d][2] = 1;
  return 0;
}

int dp_slot_open(const dp_model* m, int steps, const char* key, int share) {
  Parts p;
  if (steps < 1 || !key || parts_view(&p, m)) return -2;
  int found = -1;
  lock();
  for (int i = 0; i < N_SLOTS && share && found < 0; i++)
    if (slots[i].memory && slots[i].steps == steps && !strcmp(slots[i].key, key)) found = i;
  if (found >= 0) slots[found].references++;
  for (int i = 0; i < N_SLOTS && found == -1; i++) {
    if (slots[i].references) continue;
    const int wrong = fill(slots + i, m, &p, steps, key);
    if (!wrong) slots[i].references = 1;
    found = wrong ? wrong : i;
  }
  unlock();
  return found;
}

static void retain(Slot* s) {
  lock();
  s->references++;
  unlock();
}

static void release(Slot* s) {
  lock();
  if (s->references > 0 && --s->references == 0) free(s->memory), s->memory = NULL;
  unlock();
}

void dp_slot_close(int slot) {
  if (slot >= 0 && slot < N_SLOTS) release(slots + slot);
}

void dp_slot_sizes(int slot, char sizes[DP_SLOT_SIZES]) {
  lock();
  snprintf(sizes, DP_SLOT_SIZES, "%s",
           slot >= 0 && slot < N_SLOTS && slots[slot].memory ? slots[slot].sizes : "");
  unlock();
}

int dp_slot_failure(int slot) {
  return slot >= 0 && slot < N_SLOTS ? atomic_exchange(&slots[slot].failure, 0) : 0;
}

/* CasADi is about to make a function, new (with the model that it names) or of a file; without
 * arguments it makes the derivative of one that it has. Nonzero: it does not, and takes back a
 * reference that it has not counted. */
static int configure(int slot, const char* name, int argc, const char** argv) {
  Slot* s = slots + slot;
  lock();
  const int there = s->memory != NULL;
  const int right =
      there && (argc == 1 || (argc == 3 && !strcmp(argv[1], s->key) && !strcmp(argv[2], s->sizes)));
  if (!right) s->references++;
  unlock();
  if (!right)
    fprintf(stderr,
            "defplan: the saved function %s is of the model %.12s, but its slot %s: load it by"
            " defplan_mj.dynamics.external.load_function\n",
            name, argc > 1 ? argv[1] : "(unknown)",
            there ? "holds another one here" : "is empty here");
  return !right;
}

/* Note why an evaluation failed, say it once, and return CasADi's flag. */
static int fail(Slot* s, const char* name, int why) {
  static const char* const REASONS[] = {"", "a state or an input is not finite",
                                        "a quaternion has no direction: its length is 0 or huge",
                                        "a step was not solved",
                                        "there is no derivative here: a step's matrix is singular"};
  atomic_store(&s->failure, why);
  if (!(atomic_fetch_or(&s->told, 1 << why) & 1 << why))
    fprintf(stderr, "defplan: the evaluation of %s failed: %s (said once)\n", name, REASONS[why]);
  return 1;
}

static int finite(const double* a, size_t n) {
  int wrong = 0;
  for (size_t i = 0; a && i < n; i++) wrong += !isfinite(a[i]);
  return !wrong;
}

/* 0, or why a state and its inputs cannot be stepped from. */
static int wrong_arguments(const double* x, size_t nx, const double* u, size_t nu) {
  if (!finite(x, nx) || !finite(u, nu)) return DP_SLOT_NOT_FINITE;
  const double size = x ? sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5] + x[6] * x[6]) : 0;
  return size > 1e-6 && size < 1e6 ? 0 : DP_SLOT_QUATERNION;
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
  if (w)
    *w = (Int)(2 * states_size(s) + 2 * (size_t)s->steps * s->nu +
               (size_t)s->nx * (s->nx + s->nu + 3 * s->n_feet));
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
    if (!memcmp(kept, w, nx * sizeof(double)) && !memcmp(kept + nx, u, nu * sizeof(double)))
      return kept + nx + nu;
  }
  return NULL;
}

static int evaluate(Slot* s, const char* name, const double** arg, double** res, double* w) {
  const size_t nx = s->nx, nu = (size_t)s->steps * s->nu, n = nx * s->steps;
  const double* u = shapes(s, arg, w);
  read(arg[0], nx, w);
  const int wrong = wrong_arguments(w, nx, u, nu);
  if (wrong) return fail(s, name, wrong);
  if (s->kept && !atomic_flag_test_and_set(&s->busy)) {
    const double* x = find(s, w, u);
    if (x) write(x, n, res[0]);
    atomic_flag_clear(&s->busy);
    if (x) return 0;
  }
  if (dp_rollout(&s->model, s->steps, u, w, NULL)) return fail(s, name, DP_SLOT_UNSOLVED);
  if (s->kept && !atomic_flag_test_and_set(&s->busy)) {
    double* kept = s->kept + s->oldest * (nx + nu + n);
    write(w, nx, kept), write(u, nu, kept + nx), write(w + nx, n, kept + nx + nu);
    s->oldest = (s->oldest + 1) % N_KEPT, s->n_kept += s->n_kept < N_KEPT;
    atomic_flag_clear(&s->busy);
  }
  write(w + nx, n, res[0]);
  return 0;
}

static int adjoint(Slot* s, const char* name, const double** arg, double** res, double* w) {
  const size_t n = (size_t)s->steps * s->nx, nu = (size_t)s->steps * s->nu;
  double *x = w, *g = x + states_size(s), *gu = g + states_size(s) + nu;
  read(arg[0], s->nx, x), read(arg[2], n, x + s->nx);
  read(NULL, s->nx, g), read(arg[3], n, g + s->nx);
  const double* u = shapes(s, arg, w);
  const int wrong = wrong_arguments(x, s->nx, u, nu);
  if (wrong || !finite(x, n + s->nx) || !finite(g, n + s->nx))
    return fail(s, name, wrong ? wrong : DP_SLOT_NOT_FINITE);
  if (dp_rollout_adj(&s->model, s->steps, u, x, g, gu)) return fail(s, name, DP_SLOT_SINGULAR);
  write(g, s->nx, res[0]), write(gu, nu, res[1]);
  return 0;
}

static int jacobian(Slot* s, const char* name, const double** arg, double** res, double* w) {
  const int nx = s->nx, nu = s->nu;
  double *x = w, *x_next = w + nx;
  double *A = w + 2 * states_size(s) + 2 * (size_t)s->steps * nu, *B = A + nx * nx;
  read(arg[0], nx, x), read(arg[2], nx, x_next);
  const double* u = shapes(s, arg, w);
  const int wrong = wrong_arguments(x, nx, u, nu);
  if (wrong || !finite(x_next, nx)) return fail(s, name, wrong ? wrong : DP_SLOT_NOT_FINITE);
  if (dp_step_jac(&s->model, x, u, x_next, A, B)) return fail(s, name, DP_SLOT_SINGULAR);
  for (int i = 0; i < nx; i++) { /* to column-major */
    for (int j = 0; res[0] && j < nx; j++) res[0][j * nx + i] = A[i * nx + j];
    for (int j = 0; res[1] && j < nu; j++) res[1][j * nx + i] = B[i * nu + j];
  }
  return 0;
}

static int feet_at(Slot* s, const char* name, const double** arg, double** res, double* w) {
  read(arg[0], s->nx, w);
  const int wrong = wrong_arguments(w, s->nx, NULL, 0);
  if (wrong) return fail(s, name, wrong);
  if (res[0]) dp_feet(&s->model, w, res[0], NULL);
  return 0;
}

static int feet_jacobian(Slot* s, const char* name, const double** arg, double** res, double* w) {
  const int n = 3 * s->n_feet, nq = s->nq;
  double points[3 * DP_MAX_FEET], *jacobian = w + s->nx;
  if (!res[0]) return 0;
  read(arg[0], s->nx, w);
  const int wrong = wrong_arguments(w, s->nx, NULL, 0);
  if (wrong) return fail(s, name, wrong);
  dp_feet(&s->model, w, points, jacobian);
  for (int i = 0; i < n; i++) /* to column-major; positions do not depend on velocities */
    for (int j = 0; j < s->nx; j++) res[0][j * n + i] = j < nq ? jacobian[i * nq + j] : 0;
  return 0;
}

#define FUNCTION(name, s, signature, call)                                                       \
  DP_API Int name##_n_in(void) { return (signature).n_in; }                                      \
  DP_API Int name##_n_out(void) { return (signature).n_out; }                                    \
  DP_API const char* name##_name_in(Int i) { return (signature).in[i]; }                         \
  DP_API const char* name##_name_out(Int i) { return (signature).out[i]; }                       \
  DP_API const Int* name##_sparsity_in(Int i) {                                                  \
    return slots[s].dense[(signature).dimension_in[i]];                                          \
  }                                                                                              \
  DP_API const Int* name##_sparsity_out(Int i) {                                                 \
    return slots[s].dense[(signature).dimension_out[i]];                                         \
  }                                                                                              \
  DP_API int name##_work(Int* a, Int* r, Int* i, Int* w) { return work(slots + s, a, r, i, w); } \
  DP_API void name##_incref(void) { retain(slots + s); }                                         \
  DP_API void name##_decref(void) { release(slots + s); }                                        \
  DP_API int name##_config(int argc, const char** argv) {                                        \
    return configure(s, #name, argc, argv);                                                      \
  }                                                                                              \
  DP_API int name(const double** arg, double** res, Int* iw, double* w, int mem) {               \
    (void)iw, (void)mem;                                                                         \
    return call(slots + s, #name, arg, res, w);                                                  \
  }
#define SLOT(d, n)                                                  \
  FUNCTION(defplan_step_##d##n, 10 * d + n, STEP, evaluate)         \
  FUNCTION(jac_defplan_step_##d##n, 10 * d + n, STEP_JAC, jacobian) \
  FUNCTION(adj1_defplan_step_##d##n, 10 * d + n, STEP_ADJ, adjoint) \
  FUNCTION(defplan_rollout_##d##n, 10 * d + n, ROLLOUT, evaluate)   \
  FUNCTION(adj1_defplan_rollout_##d##n, 10 * d + n, ROLLOUT_ADJ, adjoint) \
  FUNCTION(defplan_feet_##d##n, 10 * d + n, FEET_AT, feet_at)       \
  FUNCTION(jac_defplan_feet_##d##n, 10 * d + n, FEET_JAC, feet_jacobian)
#define TEN(d)                                                    \
  SLOT(d, 0) SLOT(d, 1) SLOT(d, 2) SLOT(d, 3) SLOT(d, 4)          \
  SLOT(d, 5) SLOT(d, 6) SLOT(d, 7) SLOT(d, 8) SLOT(d, 9)
/* names have two digits: one can stand for another in a file (external.py) */
TEN(0) TEN(1) TEN(2) TEN(3) TEN(4) TEN(5) SLOT(6, 0) SLOT(6, 1) SLOT(6, 2) SLOT(6, 3)
