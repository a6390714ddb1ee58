/* What the files of both integrators share, and the memory of an implicit Euler step: euler_energy.c writes
 * it down, euler_contact.c its contact, euler_solve.c solves it, euler_derivatives.c differentiates it. */
#ifndef DEFPLAN_WORK_H
#define DEFPLAN_WORK_H
#include "internal.h"

static const double SPEED2 = 1e-4; /* m^2/s^2: rounds the tangential drag at rest */
static const double STANDARD_GRAVITY = 9.81;

enum { MAX_N = 6 + DP_MAX_MODES, ROW = 24 }; /* unknowns; a padded row of them */
enum { MAX_STATE = 13 + 3 * DP_MAX_MODES };

/* A configuration. */
typedef struct {
  double c[3], quat[4], q[DP_MAX_MODES];
} Pose;

typedef struct {
  double* next;
} Arena;

static inline double* take(Arena* arena, size_t n) {
  double* p = arena->next;
  arena->next += (n + PAD - 1) / PAD * PAD;
  return p;
}

/* What a step needs in memory; everything is taken from one array on the caller's stack. */
typedef struct {
  const Body* body;
  const double *par, *u; /* options; target at the end of the substep (r), then forces on the feet */
  double h;              /* substep, s */
  const double* origin;  /* world; what places are told from */
  Feet feet;
  Terrain terrain;
  double* spent; /* multiplications of this step so far, about: see DP_MAX_WORK */
  Config now, one, two; /* the iterate, the last configuration, the one before */
  double q_one[DP_MAX_MODES], q_two[DP_MAX_MODES], q_now[DP_MAX_MODES];
  double guess[3];                  /* c^ */
  double *scratch, *scratch_lagged; /* kinematics */
  double *P, *W;                    /* 9 x kp */
  double *before, *area, *cn, *ct;  /* 3 np, 3 np, np, np: lagged drag quantities */
  double *body_points, *w, *f, *D;  /* (1 + r) x 3 np, 3 np, 3 np, 6 np */
  double *Jq, *DJ;                  /* r x 3 np */
  double *gzeta, *Wg;               /* kp, 9 x kp */
  double energy, g[MAX_N], H[MAX_N * MAX_N];
  double *feet_points, *feet_force, *feet_Jq; /* 3 x np of the feet, the same, r x that */
  /* contact: points that can touch, at the last configuration and at the one that friction takes its
   * normal forces from (NULL: the iterate); then what touches at the iterate, m of them padded to mp */
  double *touch_before, *touch_reference, *touch_now; /* 3 x nc */
  const double* reference;
  int m, mp, which[DP_MAX_CONTACTS];
  double *touch_field, *touch_points, *touch_force, *touch_Jq; /* kp x 3 mp, 3 mp, 3 mp, r x 3 mp */
  double *touch_D, *touch_F;                                   /* m x 9: -df/dp, -df/dv */
  double friction;                                             /* coefficient now */
} Work;

static inline size_t work_size(const Body* b, const Terrain* t, const Feet* f) {
  size_t kp = b->kp, np = b->np, r = b->r, k3 = kinematics_scratch(b), nc = terrain_parts(t) ? b->nc : 0;
  return PAD + 3 * (1 + r) * kp + 2 * (k3 + PAD) + 9 * kp * 2 + 3 * np * 2 + 2 * np + 3 * np * (3 + r) + 6 * np +
         2 * (r * 3 * np) + kp + 9 * kp + 3 * f->np * (2 + r) + 3 * nc * (5 + r + kp) + 18 * nc;
}

/* `memory` is 64-byte aligned. */
static inline void work_init(Work* w, double* memory, const Body* b, const dp_model* model, const Terrain* t,
                             const Feet* f) {
  Arena arena = {memory};
  size_t kp = b->kp, np = b->np, r = b->r, nc = terrain_parts(t) ? b->nc : 0;
  w->body = b, w->par = model->par, w->feet = *f, w->terrain = *t;
  Config* all[3] = {&w->now, &w->one, &w->two};
  for (int i = 0; i < 3; i++) all[i]->zeta = take(&arena, (1 + r) * kp), all[i]->dz = all[i]->zeta + kp;
  w->scratch = take(&arena, kinematics_scratch(b)), w->scratch_lagged = take(&arena, kinematics_scratch(b));
  w->P = take(&arena, 9 * kp), w->W = take(&arena, 9 * kp);
  w->before = take(&arena, 3 * np), w->area = take(&arena, 3 * np);
  w->cn = take(&arena, np), w->ct = take(&arena, np);
  w->body_points = take(&arena, (1 + r) * 3 * np), w->w = take(&arena, 3 * np), w->f = take(&arena, 3 * np);
  w->D = take(&arena, 6 * np);
  w->Jq = take(&arena, r * 3 * np), w->DJ = take(&arena, r * 3 * np);
  w->gzeta = take(&arena, kp), w->Wg = take(&arena, 9 * kp);
  w->feet_points = take(&arena, 3 * f->np), w->feet_force = take(&arena, 3 * f->np);
  w->feet_Jq = take(&arena, r * 3 * f->np);
  w->touch_before = take(&arena, 3 * nc), w->touch_reference = take(&arena, 3 * nc);
  w->touch_now = take(&arena, 3 * nc), w->touch_field = take(&arena, kp * 3 * nc);
  w->touch_points = take(&arena, 3 * nc), w->touch_force = take(&arena, 3 * nc);
  w->touch_Jq = take(&arena, r * 3 * nc), w->touch_D = take(&arena, 9 * nc), w->touch_F = take(&arena, 9 * nc);
  w->m = -1, w->reference = NULL, w->friction = t->friction;
}

/* A model's parts, checked and counted: the body, what it touches, where given forces act. */
typedef struct {
  const dp_model* model;
  Body body;
  Terrain terrain;
  Feet feet;
  int nu;              /* size of an input */
  int substeps, euler; /* of a step; whether implicit Euler is the integrator */
} Parts;

/* 0, or a negative code if something about the model cannot be: NO_BODY if `body` is not one. */
enum { NO_BODY = -1 };
int parts_view(Parts* p, const dp_model* m);

/* out (3 x n) = R in, points or vectors as structure of arrays */
static inline void rotate(const double* R, const double* restrict in, int n, double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[3 * i], b = R[3 * i + 1], c = R[3 * i + 2];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static inline void rotate_back(const double* R, const double* restrict in, int n, double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[i], b = R[3 + i], c = R[6 + i];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static inline double sum(const double* restrict a, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i];
  return s;
}
static inline double inner(const double* restrict a, const double* restrict b, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i] * b[i];
  return s;
}
/* sum over points of a x b */
static inline void sum_cross(const double* restrict a, const double* restrict b, int n, double* out) {
  double x = 0, y = 0, z = 0;
  for (int s = 0; s < n; s++) {
    x += a[n + s] * b[2 * n + s] - a[2 * n + s] * b[n + s];
    y += a[2 * n + s] * b[s] - a[s] * b[2 * n + s];
    z += a[s] * b[n + s] - a[n + s] * b[s];
  }
  out[0] = x, out[1] = y, out[2] = z;
}

/* --- step.c */
/* The last configuration of state x of a body with r modes, and the one before it, h earlier; their places
 * are told from x's own. */
void state_nodes(int r, const double* x, double h, Pose* last, Pose* before);

/* --- euler_energy.c */
/* Take the last configuration and the one before it, their places told from `origin` (world). */
void work_begin(Work* w, const double* origin, const Pose* before, const Pose* last, const double* u, double h);
/* Everything of a step that depends on the last two configurations only. With `derivatives`,
 * dz of both as well. */
void work_prepare(Work* w, int derivatives);
/* Energy, gradient and Hessian at the iterate w->now, in (c, t, q) with R = exp([t]) R_now. */
void work_assemble(Work* w);

/* --- euler_contact.c */
/* Where the points that can touch were, after the last configuration is known. */
void contact_prepare(Work* w);
/* World positions of those points in configuration cfg (its zeta known), 3 x nc. */
void contact_positions(const Work* w, const Config* cfg, double* out);
/* Forces of terrain and feet at the iterate: adds to energy, w->g, the upper w->H, dE/dzeta, and the
 * sum N of f p^T, as work_assemble needs them; the rest of the Hessian, no longer symmetric, after it
 * has been mirrored. */
double forces_evaluate(Work* w, double* N);
void forces_hessian(Work* w);
/* What they add to `mixed` in euler_derivatives.c: for a motion along lambda (dz of zeta), the gradients over
 * the last configuration (out: c and turn; gz: zeta) and over the given forces (gu, may be NULL). */
void forces_mixed(Work* w, const double* lambda, const double* dz, double* out, double* gz, double* gu);

/* --- euler_solve.c */
/* Find the next configuration from `guess` or, if NULL, from the free motion; returns 1 if it was found. */
int euler_solve(Work* w, const Pose* guess, Pose* next, dp_info* info);

/* --- euler_derivatives.c */
/* The step is solved at `next`: prepare its derivatives. The Hessian is in w->H. */
void euler_linearise(Work* w, const Pose* next);
/* Gradients of lambda . dE/dQ by the last configuration, the one before (6 + r) and the input. */
void euler_pull(Work* w, const double* lambda, double* a1, double* a0, double* au);

/* --- contact_law.c */
/* Add the force f (3) of a part of the terrain on a point at p with velocity v, and D = -df/dp, F = -df/dv
 * (3 x 3 each); 0 if it does not touch. mu: coefficient of friction. */
int contact_law(const Terrain* t, double mu, int part, const double* p, const double* v, double* f, double* D,
                double* F);

/* --- linear.c */
/* LU of A with row pivots, in place; 0 if it is singular; the sign of its determinant in *sign. */
int lu(double* A, int n, int* pivot, int* sign);
void lu_solve(const double* LU, const int* pivot, int n, const double* rhs, double* x);
void lu_solve_transposed(const double* LU, const int* pivot, int n, const double* rhs, double* x);
/* L of A = L L^T (row-major, lower); 0 if A is not positive definite. */
int cholesky(const double* A, int n, double* L);
void cholesky_solve(const double* L, int n, const double* rhs, double* x);
/* Factors of a matrix: symmetric and definite, or any; factorise returns 0 if it is singular. */
typedef struct {
  double A[MAX_N * MAX_N];
  int n, symmetric, pivot[MAX_N];
} Factors;
int factorise(Factors* f, const double* A, int n, int symmetric);
void solve(const Factors* f, const double* rhs, double* x);
void solve_transposed(const Factors* f, const double* rhs, double* x);
#endif
