/* A path of the body: configurations a substep apart, what follows from each, and the equations
 * that a variational step asks of three of them. node.c: one configuration; touch.c: contact;
 * variational.c: equations and their solution; variational_matrix.c: their derivatives by the
 * unknown node; variational_derivatives.c: by all else. */
#ifndef DEFPLAN_PATH_H
#define DEFPLAN_PATH_H
#include "drag.h"
#include "linear.h"
#include "state.h"

/* One configuration and what follows from it. Vectors in world axes, places from the centre c. */
typedef struct {
  Pose at;
  double R[9];
  double *zeta, *dz; /* kp: (1, z); r x kp: dz/dq, right behind it */
  double *scratch;   /* of the kinematics */
  double *P, *Q;     /* 9 x kp: P_ij,a = sum_v m Phi_a,i y_j; r x 9 x kp, right behind it: dP/dq */
  double *y, *Jq;    /* 3 np: drag points; r x 3 np: their derivatives by q, right behind them */
  Tangents tangents; /* body axes */
  double* area;      /* 3 np: area vectors */
  double* touch;                      /* 3 nc: contact points */
  int touch_known, moments_known;     /* whether `touch` and P are those of this configuration */
} Node;

/* What of a node is computed: its attitude alone; zeta, too; places of the drag points, too, and
 * beside them dz; Jq (with it); area vectors. The rest is where it is needed. */
enum { PLACE = -2, SHAPE = -1, PLACES = 0, TANGENT = 1, DRAG_TANGENT = 2, AREAS = 4 };

typedef struct {
  const Body* body;
  const double *par, *u; /* options; target at node 1 (r), then forces on the feet */
  double h;
  const double* origin; /* world; what places c are told from */
  Feet feet;
  Terrain terrain;
  double* spent; /* multiplications of this step so far, about: see DP_MAX_WORK */
  Node nodes[3], *n0, *n1, *n2; /* before, now, next */
  double *local, *area_local;   /* (1 + r) x 3 np, 3 np: drag points, area vectors, body axes */
  double *turned, *columns;     /* 3 np: a column of J_2; (6 + r) x 3 np: of D J_2 / 2 */
  double* mean_f;               /* 3 np: (f01 + f12)/2 */
  double *mean01, *area12;      /* 3 np: area vectors of the two intervals */
  double *f01, *f12, *D01, *D12; /* 3 np: forces of the intervals; 6 np: -dF/dp of later ends */
  double base[MAX_N];            /* equations without what depends on node 2 */
  double g[MAX_N], H[MAX_N * MAX_N]; /* equations and a matrix of theirs */
  double *feet_y, *feet_Jq;     /* 3 nf, r x 3 nf: places of the feet at node 1 */
  /* contact (touch.c): n_near points that may touch at node 2, padded to mp; m of them do */
  int n_near, mp, near[DP_MAX_CONTACTS], m, which[DP_MAX_CONTACTS];
  double *near_field, *near_y1, *near_y2; /* kp x 3 mp; 3 mp: places at nodes 1 and 2 */
  double* near_Jq;                        /* r x 3 mp: at node 1 */
  double *near_f, *touch_D, *touch_F;     /* 3 mp: forces; m x 9: -df/dp in all, -df/dv */
  /* derivatives: motion along lambda (variational_pull), gradients by places and area vectors */
  double *along_P, *along_T;         /* 9 x kp: sum_c lambda_c Q_c; T */
  double *along_local, *bend, *w;    /* 3 np: motion of the shape, body and world axes; of points */
  double *gw, *gw_local;             /* 3 np: gradient by y_1 in w, world and body axes */
  double *gp01, *ga01, *gp12, *ga12; /* 3 np: of an interval, by its later places, area vectors */
  double *gp0, *ga0, *gp1, *ga1;     /* 3 np: of nodes 0 and 1 */
  double* pull_local;                /* 3 x 3 np */
  double* curvature; /* r x rp: sum_a gz_a d2 zeta_a / dq2 at node 1, gz the force on zeta_1 */
} Path;

/* Lay `p` out in memory (64-byte aligned), or, if that is NULL, only measure: how many doubles. */
size_t path_lay(Path* p, const Parts* parts, double* memory);

/* --- node.c */
void node_set(const Path* p, Node* n, const Pose* at, int what);
/* P of a node. */
void node_moments(const Path* p, Node* n);
/* Drag of the interval from a to b with these area vectors: f, D = -df/dp_b (NULL: not wanted). */
void interval_drag(const Path* p, const Node* a, const Node* b, const double* area, double* f,
                   double* D);

/* --- touch.c */
/* Nodes 0 and 1 are set: choose the points that may touch at node 2. */
void touch_prepare(Path* p);
/* Forces at node 2 on what touches of them. */
void touch_forces(Path* p);
/* Whether other points touch at node 2 as well: they are taken in from now on. */
int touch_missed(Path* p);
/* H (6 + r, square) += J_1^T D J_b over what touches, J_b of node 2 if `exact`, else of node 1. */
void touch_matrix(Path* p, int exact, double* H);

/* --- variational.c */
/* Nodes 0 and 1 are set; everything of the equations that does not depend on node 2. */
void path_prepare(Path* p);
/* The equations at node 2: p->g. */
void path_residual(Path* p);
/* Find node 2, from `guess` or (NULL) from the free motion; returns 1 if it was found. */
int variational_solve(Path* p, const Pose* guess, dp_info* info);

/* --- variational_matrix.c */
/* H += the equations' derivatives by node b (its zeta and dz known) in inertia and elasticity. */
void inertia_matrix(const Path* p, const Node* b, double* H);
/* H += J_1^T D J_b / 2 over the drag points, D = p->D12, J_b by the places y and Jq. */
void drag_matrix(Path* p, const double* y, const double* Jq, double* H);
/* The same with J_1 in the place of J_b, which makes it symmetric: cheaper, for the iterations. */
void drag_matrix_of_1(Path* p, double* H);
/* Exact matrix dg/d(node 2) in p->H; node 2 is set whole. */
void variational_matrix(Path* p);

/* --- variational_derivatives.c */
/* After path_residual and variational_matrix at node 2. */
void variational_pull_prepare(Path* p);
/* Gradients of lambda . g by nodes 1 and 0 (6 + r), the target (r), forces on feet behind it. */
void variational_pull(Path* p, const double* lambda, double* a1, double* a0, double* au);
#endif
