/* A substep by implicit Euler, for comparison: euler_energy.c writes its energy down,
 * euler_contact.c the forces on points, euler_solve.c finds the minimum, euler_derivatives.c
 * differentiates it. */
#ifndef DEFPLAN_EULER_H
#define DEFPLAN_EULER_H
#include "drag.h"
#include "linear.h"
#include "state.h"

/* One configuration: c, orientation, q, and what follows from q. */
typedef struct {
  double c[3], quat[4], R[9], q[DP_MAX_MODES];
  double *zeta, *dz; /* kp: (1, z); r x kp: dz/dq, right behind it */
} Config;

/* What a substep needs in memory. Vectors in world axes, places from the centre c, unless said. */
typedef struct {
  const Body* body;
  const double *par, *u; /* options; target at the end of the substep (r), then forces on feet */
  double h;              /* substep, s */
  const double* origin;  /* world; what places c are told from */
  Feet feet;
  Terrain terrain;
  double* spent;        /* multiplications of this step so far, about: see DP_MAX_WORK */
  Config now, one, two; /* the iterate, the last configuration, the one before */
  double energy, g[MAX_N], H[MAX_N * MAX_N]; /* E, gradient and Hessian at the iterate */

  /* inertia */
  double guess[3];                  /* c^, where the centre goes by itself */
  double *scratch, *scratch_lagged; /* of the kinematics: at the iterate; before */
  double *P, *W;                    /* 9 x kp: moments of `one` or `two`; W_a of the energy */
  double* W_turn;                   /* 3 x kp: d2 E / dt dzeta = -([e_m] R) : W_a */
  double* gz;                       /* kp: dE/dzeta */
  double N[9]; /* sum_a zeta_a W_a R^T + sum_s f_s y_s^T: turning moments, for the Hessian by t */

  /* drag: at `one` (lagged), at the iterate, and columns of D J */
  Tangents tangents;             /* body axes */
  double *area_local, *area;     /* 3 np: area vectors, body and world axes */
  double *local_one, *y_one;     /* 3 np: places, body and world axes */
  double dc[3];                  /* way of the centre from there to the iterate */
  double *local, *y, *Jq;        /* (1 + r) x 3 np, body axes; 3 np; r x 3 np: dy/dq */
  double *f, *back, *D;          /* 3 np: forces; -R^T f; 6 np: -df/dp */
  double *turned, *D_turned, *DJ; /* 3 np: e_m x y, and D of it; r x 3 np: D Jq */

  /* forces on feet */
  double *feet_y, *feet_f, *feet_Jq; /* 3 nf, 3 nf, r x 3 nf */

  /* contact: where all points that can touch were, are, and were when friction took its normal
   * forces (`reference`: touch_lagged, or NULL: it takes them from the iterate), 3 nc, world */
  double *touch_before, *touch_now, *touch_lagged, *touch_local; /* the last: body axes */
  const double* reference;
  double friction; /* coefficient now */
  /* and what touches at the iterate, m of them padded to mp */
  int m, mp, which[DP_MAX_CONTACTS];
  double *touch_field, *touch_y, *touch_f, *touch_Jq; /* kp x 3 mp, 3 mp, 3 mp, r x 3 mp */
  double *touch_D, *touch_F;                          /* m x 9: -df/dp in all, -df/dv */

  /* derivatives: motion along lambda, and gradients */
  double *along, *along_T;                      /* kp: zeta; 9 x kp: T of euler_derivatives.c */
  double *now_P, *along_P;                      /* 9 x kp: moments of the iterate, of `along` */
  double *along_local, *along_y, *gp, *ga;      /* 3 np: body axes; world; by places, by areas */
  double* pull_local;                           /* 3 x 3 np */
} Work;

/* --- euler_energy.c */
/* Lay `w` out in memory (64-byte aligned), or, if that is NULL, only measure: how many doubles. */
size_t work_lay(Work* w, const Parts* parts, double* memory);
/* Take the last two configurations, their places told from `origin` (world), and the input. */
void work_begin(Work* w, const double* origin, const Pose* before, const Pose* last,
                const double* u, double h);
/* Everything that depends on these alone. With `derivatives`, dz of both as well. */
void work_prepare(Work* w, int derivatives);
/* Set the iterate. */
void work_set(Work* w, const Pose* now);
/* Energy, gradient and Hessian at the iterate w->now, in (c, t, q) with R = exp([t]) R_now. */
void work_assemble(Work* w);

/* --- euler_contact.c */
/* Add forces f on n points of a field, at y with modal derivatives Jq, as if they did not change:
 * g -= J^T f, and what the places' second derivatives need, in N, gz and H. `back` 3 n is set. */
void point_forces(Work* w, const double* field, int n, const double* y, const double* Jq,
                  const double* f, double* back);
/* Where the points that can touch were, after the last configuration is known. */
void contact_prepare(Work* w);
/* World places of those points in configuration cfg (its zeta known), 3 x nc. */
void contact_places(const Work* w, const Config* cfg, double* out);
/* Forces of terrain and feet at the iterate, by point_forces; returns their energy. */
double forces_evaluate(Work* w);
/* The rest of the Hessian, which is not symmetric: after it has been mirrored. */
void forces_hessian(Work* w);
/* What they add to euler_pull, the motion w->along known: by the last configuration (out: c and
 * turn; gz: zeta) and by the given forces (gu, may be NULL). */
void forces_mixed(Work* w, const double* lambda, double* out, double* gz, double* gu);

/* --- euler_solve.c */
/* Find the next configuration from `guess` or, if NULL, from the free motion; returns 1 if it was
 * found. */
int euler_solve(Work* w, const Pose* guess, Pose* next, dp_info* info);

/* --- euler_derivatives.c */
/* The substep is solved at `next`: prepare its derivatives. The Hessian is in w->H. */
void euler_linearise(Work* w, const Pose* next);
/* Gradients of lambda . dE/dQ by the last configuration, the one before (6 + r), and the input. */
void euler_pull(Work* w, const double* lambda, double* a1, double* a0, double* au);
#endif
