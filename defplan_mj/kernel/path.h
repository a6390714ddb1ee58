/* A path of the body: configurations a substep apart, what follows from each, and the equations that
 * a variational step asks of three of them. node.c: one configuration; touch.c: contact; variational.c:
 * equations and their solution; variational_derivatives.c: their derivatives. */
#ifndef DEFPLAN_PATH_H
#define DEFPLAN_PATH_H
#include "work.h"

/* One configuration and what follows from it. Vectors in world axes, places from the centre c. */
typedef struct {
  Pose at;
  double R[9];
  double *zeta, *dz; /* kp: (1, z); r x kp: dz/dq, right behind it */
  double *scratch;   /* of the kinematics */
  double *P, *Q;     /* 9 x kp: P_ij,a = sum_v m Phi_a,i y_j, body axes; r x 9 x kp, right behind it: dP/dq */
  double *y, *Jq;    /* 3 np: drag points; r x 3 np: their derivatives by q, right behind them */
  double *tangent1, *tangent2, *area; /* 3 np each: body axes; area vectors */
  double* touch;                      /* 3 nc: contact points */
  int touch_known, moments_known;     /* whether `touch` and P are those of this configuration */
} Node;

/* What of a node is computed beside its places: dz; Jq (with it); area vectors. P, Q, touch: where needed. */
enum { PLACES = 0, TANGENT = 1, DRAG_TANGENT = 2, AREAS = 4 };

typedef struct {
  const Body* body;
  const double *par, *u; /* options; target at node 1 (r), then forces on the feet */
  double h;
  const double* origin; /* world; what places c are told from */
  Feet feet;
  Terrain terrain;
  double* spent; /* multiplications of this step so far, about: see DP_MAX_WORK */
  Node nodes[3], *n0, *n1, *n2; /* before, now, next */
  double *local, *columns;      /* (1 + r) x 3 np, body axes; (6 + r) x 3 np */
  double *mean01, *area12;      /* 3 np: area vectors of the two intervals */
  double *f01, *f12, *D01, *D12; /* 3 np forces of the intervals; 6 np: -dF/dp of their later ends */
  double base[MAX_N];            /* equations without what depends on node 2 */
  double g[MAX_N], H[MAX_N * MAX_N]; /* equations and a matrix of theirs */
  double *feet_y, *feet_Jq;     /* 3 nf, r x 3 nf: places of the feet at node 1 */
  /* contact (touch.c): n_near points that may touch at node 2, padded to mp, and m of them that do */
  int n_near, mp, near[DP_MAX_CONTACTS], m, which[DP_MAX_CONTACTS];
  double *near_field, *near_y1, *near_y2, *near_Jq; /* kp x 3 mp; 3 mp at nodes 1 and 2; r x 3 mp at node 1 */
  double *near_f, *touch_D, *touch_F; /* 3 mp: forces; m x 9: -df/dp in all, and its part by the velocity */
  /* derivatives */
  double *pull_w, *pull_arm, *pull_01, *pull_a01, *pull_12, *pull_a12, *pull_f; /* 3 np each */
  double* along_moments; /* 9 x kp */
  double* curvature;     /* r x rp: sum_a gz_a d2 zeta_a / dq2 at node 1, gz the force on zeta_1 */
} Path;

/* Lay `p` out in memory (64-byte aligned), or, if that is NULL, only measure; returns the doubles. */
size_t path_lay(Path* p, const Parts* parts, double* memory);
static inline int has_drag(const Path* p) { return p->body->np && p->par[DP_FLUID_DENSITY] != 0; }

/* --- node.c */
void node_set(const Path* p, Node* n, const Pose* at, int what);
/* P of a node. */
void node_moments(const Path* p, Node* n);
/* Gradients by places of the drag points (gp) and by area vectors (ga), world axes, of node n -> add
 * to the gradient by c and turn (out, 6) and by zeta (gz). gp and ga are overwritten. */
void node_pull(const Path* p, const Node* n, double* gp, double* ga, double* out, double* gz);
/* N = sum_v m a_v b_v^T in world axes from N in body axes of a (Ra) and b (Rb). */
void to_world(const double* Ra, const double* N, const double* Rb, double* out);
/* Drag of the interval from a to b with these area vectors: force f, and D = -df/dp_b (NULL: not wanted). */
void interval_drag(const Path* p, const Node* a, const Node* b, const double* area, double* f, double* D);

/* --- touch.c */
/* Nodes 0 and 1 are set: choose the points that may touch at node 2. */
void touch_prepare(Path* p);
/* Forces at node 2 on what touches of them. */
void touch_forces(Path* p);
/* Whether other points touch at node 2 as well: they are taken in from now on. */
int touch_missed(Path* p);
/* H += J_1^T D J_b over what touches, J_b of node 2 if `exact`, else of node 1. H is (6 + r) x (6 + r). */
void touch_matrix(Path* p, int exact, double* H);

/* --- variational.c */
/* Nodes 0 and 1 are set; everything of the equations that does not depend on node 2. */
void path_prepare(Path* p);
/* The equations at node 2: p->g. */
void path_residual(Path* p);
/* Find node 2, from `guess` or (NULL) from the free motion; returns 1 if it was found. */
int variational_solve(Path* p, const Pose* guess, dp_info* info);

/* --- variational_derivatives.c */
/* H += the equations' derivatives by node b (its zeta and dz known) in inertia and elasticity. */
void inertia_matrix(const Path* p, const Node* b, double* H);
/* H += J_1^T D J_b / 2 over the drag points, D = p->D12, J_b by the places y and Jq. */
void drag_matrix(Path* p, const double* y, const double* Jq, double* H);
/* Exact matrix dg/d(node 2) in p->H, and what `variational_pull` needs; node 2 is set whole. */
void variational_matrix(Path* p);
/* After path_residual and variational_matrix at node 2. */
void variational_pull_prepare(Path* p);
/* Gradients of lambda . g by node 1 and node 0 (6 + r), the target (r) and forces on feet (behind it). */
void variational_pull(Path* p, const double* lambda, double* a1, double* a0, double* au);
#endif
