/* Exact derivatives of the variational step's equations g(x0, x1, x2, u) by nodes 0 and 1 and by
 * the input; variational_matrix.c has those by node 2.
 *
 * For a vector lambda over the equations take the scalar L = lambda . g, with the motion
 * w = lambda_c + lambda_t x y1 + bend, bend = R1 B dz1 lambda_q, of a point at node 1 along lambda,
 *
 *   L = sum_v m w.(p2 - 2 p1 + p0)/h^2 - sum_s w.[(F_01 + F_12)/2 + F_contact + f_feet]
 *     + lambda_q . K [...] - lambda_t . righting,
 *
 * and differentiate it by places, area vectors and w; gradients by zeta go on to q by dz, and w's
 * own derivative by q through dz1 is the curvature. docs/kernel.md goes through it term by term. */
#include "path.h"

/* --- what all lambda share: the curvature sum_a gz_a d2 zeta_a / dq2 */

/* gz -= Phi^T R_1^T f: what forces f (3 x n, world) on points of a field do to zeta_1 */
static void force_on_zeta(Path* p, const double* field, const double* f, int n, double* gz) {
  double local[3 * DP_MAX_POINTS];
  rotate_back(p->n1->R, f, n, local);
  for (int s = 0; s < 3 * n; s++) local[s] = -local[s];
  field_transpose(p->body, field, local, n, gz);
}

/* gz += sum m Phi^T R_1^T (p2 - 2 p1 + p0)/h^2: that of the acceleration */
static void inertia_on_zeta(Path* p, double* gz) {
  const Body* b = p->body;
  const double ih2 = 1 / (p->h * p->h);
  double C[9];
  for (int a = 0; a < b->kp; a++) gz[a] -= 2 * ih2 * (b->trace[a] + p->n1->zeta[a]);
  for (int t = 0; t < 2; t++) {
    Node* at = t ? p->n0 : p->n2;
    node_moments(p, at);
    mul_mtm(p->n1->R, at->R, C);
    moments_contract(ih2, C, at->P, b->kp, gz);
  }
}

static void feet_on_zeta(Path* p, double* gz) {
  const int nf = p->feet.np;
  double f[3 * DP_MAX_FEET] = {0};
  for (int i = 0; i < 3 * p->feet.n; i++) f[i % 3 * nf + i / 3] = p->u[p->body->r + i];
  force_on_zeta(p, p->feet.field, f, nf, gz);
}

void variational_pull_prepare(Path* p) {
  const Body* b = p->body;
  const int r = b->r, rp = b->rp;
  double gz[MAX_ZETA] = {0};
  inertia_on_zeta(p, gz);
  if (has_drag(b, p->par)) force_on_zeta(p, b->points, p->mean_f, b->np, gz);
  if (p->m) force_on_zeta(p, p->near_field, p->near_f, p->mp, gz);
  if (p->feet.n) feet_on_zeta(p, gz);
  memset(p->curvature, 0, sizeof(double) * r * rp);
  kinematics_curvature(b, gz, p->n1->scratch, p->curvature);
  for (int c = 0; c < r; c++)
    for (int d = 0; d < c; d++) p->curvature[c * rp + d] = p->curvature[d * rp + c];
}

/* --- one lambda. Gradients a by c and turn (6), gz by zeta of a node. */

typedef struct {
  const double *c, *t, *q; /* lambda's parts */
  double zeta[MAX_ZETA];   /* motion of zeta_1: dz_1 lambda_q */
} Along;

/* T_ij,a = sum m w_i Phi_a,j / h^2 without lambda_c: [lambda_t] R_1 P_1 + R_1 sum_c lambda_c Q_c */
static void moments_along(Path* p, const Along* l) {
  const int kp = p->body->kp;
  const double ih2 = 1 / (p->h * p->h);
  const Node* n1 = p->n1;
  double turned[9], *restrict P = p->along_P;
  memset(P, 0, sizeof(double) * 9 * kp);
  for (int c = 0; c < p->body->r; c++) {
    const double* restrict Q = n1->Q + (size_t)9 * kp * c;
    for (int a = 0; a < 9 * kp; a++) P[a] += l->q[c] * Q[a];
  }
  skew_mul(l->t, n1->R, turned);
  memset(p->along_T, 0, sizeof(double) * 9 * kp);
  moments_turn(ih2, turned, n1->P, kp, p->along_T);
  moments_turn(ih2, n1->R, P, kp, p->along_T);
}

/* L = sum m w.p0 / h^2 by node 0: c, turn (vee of sum m w y0^T), zeta (R0 : T) */
static void inertia_by_0(const Path* p, const Along* l, double* a0, double* gz0) {
  const Node* n0 = p->n0;
  const int kp = p->body->kp;
  double Tz[9], wy[9];
  for (int i = 0; i < 3; i++) a0[i] = p->body->mass / (p->h * p->h) * l->c[i];
  moments_pair(p->along_T, n0->zeta, kp, Tz);
  mul_mmt(Tz, n0->R, wy);
  vee(wy, a0 + 3);
  moments_contract(1, n0->R, p->along_T, kp, gz0);
}

/* L = lambda_t . sum m y1 x Y + sum m bend.(Y - 2 y1), over h^2, with Y = y2 + y0, by node 1: turns
 * of y1 and of bend; zeta_1 in y1, (R1 Phi_a).(Y x lambda_t), and in bend.y1 = zeta's own
 * product */
static void inertia_by_1(Path* p, const Along* l, double* a1, double* gz1) {
  const Body* b = p->body;
  const Node* n1 = p->n1;
  const int kp = b->kp;
  const double ih2 = 1 / (p->h * p->h);
  double Y1[9] = {0}, BY[9] = {0}; /* sum m y1 Y^T and sum m bend Y^T */
  for (int t = 0; t < 2; t++) {
    const Node* at = t ? p->n0 : p->n2;
    double N[9], M[9], turned[9], C[9];
    moments_pair(at->P, n1->zeta, kp, N); /* sum m y1 y^T, body axes */
    to_world(n1->R, N, at->R, M);
    for (int i = 0; i < 9; i++) Y1[i] += ih2 * M[i];
    moments_pair(at->P, l->zeta, kp, N);
    to_world(n1->R, N, at->R, M);
    for (int i = 0; i < 9; i++) BY[i] += ih2 * M[i];
    skew_mul(l->t, at->R, turned);
    mul_mtm(n1->R, turned, C);
    moments_contract(-ih2, C, at->P, kp, gz1);
  }
  const double trace = Y1[0] + Y1[4] + Y1[8];
  double turn[3];
  vee(BY, turn); /* that of the transposed is its negative */
  for (int i = 0; i < 3; i++) {
    const double Yl = Y1[i] * l->t[0] + Y1[3 + i] * l->t[1] + Y1[6 + i] * l->t[2];
    a1[i] = -2 * ih2 * b->mass * l->c[i];
    a1[3 + i] = Yl - trace * l->t[i] - turn[i];
  }
  for (int a = 1; a < kp; a++) gz1[a] -= 2 * ih2 * l->zeta[a];
}

/* L = -lambda_t . d M 9.81 (R1 e_z) x e_z */
static void righting_by_1(const Path* p, const Along* l, double* a1) {
  const double D = p->body->mass * STANDARD_GRAVITY * p->par[DP_RIGHTING], *R = p->n1->R;
  const double up[3] = {0, 0, 1}, z[3] = {R[2], R[5], R[8]};
  double side[3], turn[3];
  cross3(up, l->t, side), cross3(z, side, turn);
  for (int i = 0; i < 3; i++) a1[3 + i] -= D * turn[i];
}

/* L = -w . F of a point at y by a turn of node 1, which turns y and bend in w: out += it */
static void motion_by_turn(const double* t, const double* y, const double* bend, const double* F,
                           double* out) {
  const double yt = dot3(y, t), yF = dot3(y, F);
  double x[3];
  cross3(bend, F, x);
  for (int i = 0; i < 3; i++) out[i] -= F[i] * yt - t[i] * yF + x[i];
}

/* L = -w.(F_01 + F_12)/2 through w: w itself, its turn, and y1 in it (lambda_t x F) */
static void drag_by_motion(Path* p, const Along* l, double* a1, double* gz1) {
  const Body* b = p->body;
  const Node* n1 = p->n1;
  const int np = b->np;
  double by_turn[3] = {0};
  field_apply(b, b->points, 1, l->zeta, np, p->along_local);
  rotate(n1->R, p->along_local, np, p->bend);
  for (int s = 0; s < np; s++) {
    double y[3], F[3], bend[3], x[3], gw[3];
    for (int i = 0; i < 3; i++) {
      y[i] = n1->y[i * np + s], F[i] = p->mean_f[i * np + s], bend[i] = p->bend[i * np + s];
    }
    cross3(l->t, y, x), cross3(l->t, F, gw);
    for (int i = 0; i < 3; i++) {
      p->w[i * np + s] = l->c[i] + x[i] + bend[i], p->gw[i * np + s] = gw[i];
    }
    motion_by_turn(l->t, y, bend, F, by_turn);
  }
  for (int i = 0; i < 3; i++) a1[3 + i] += by_turn[i];
  rotate_back(n1->R, p->gw, np, p->gw_local);
  field_transpose(b, b->points, p->gw_local, np, gz1);
}

/* L = -w . F/2 of an interval by places (gp: its later end, minus it the earlier) and areas */
static void drag_by_interval(const Path* p, const Node* from, const Node* to, const double* area,
                             const double* D, double* gp, double* ga) {
  double dc[3];
  for (int i = 0; i < 3; i++) dc[i] = to->at.c[i] - from->at.c[i];
  drag_apply(.5, D, p->w, p->body->np, gp);
  drag_area_gradient(p->body, p->par, .5, p->h, dc, from->y, to->y, area, p->w, ga);
}

/* The same by nodes 0 and 1, in both intervals: F_01 has the areas (a_0 + a_1)/2, F_12 has
 * (3 a_1 - a_0)/2 */
static void drag_by_nodes(Path* p, double* a1, double* gz1, double* a0, double* gz0) {
  const Body* b = p->body;
  const Node *n0 = p->n0, *n1 = p->n1;
  drag_by_interval(p, n0, n1, p->mean01, p->D01, p->gp01, p->ga01);
  drag_by_interval(p, n1, p->n2, p->area12, p->D12, p->gp12, p->ga12);
  for (int s = 0; s < 3 * b->np; s++) {
    p->gp0[s] = -p->gp01[s], p->gp1[s] = p->gp01[s] - p->gp12[s];
    const double half = .5 * p->ga01[s];
    p->ga0[s] = half - .5 * p->ga12[s], p->ga1[s] = half + 1.5 * p->ga12[s];
  }
  drag_pull(b, n0->R, n0->y, n0->area, n0->tangents, p->gp0, p->ga0, p->pull_local, a0, gz0);
  drag_pull(b, n1->R, n1->y, n1->area, n1->tangents, p->gp1, p->ga1, p->pull_local, a1, gz1);
}

/* A single point s of a field that takes the force F at y: its motion w; adds the turn's part of
 * L = -w . F to a1, and gives that by y1 in w (lambda_t x F). */
static void point_motion(const Path* p, const Along* l, const double* field, int stride, int s,
                         const double* y, const double* F, double* w, double* by_y, double* a1) {
  double local[3] = {0}, bend[3], x[3];
  for (int a = 1; a <= p->body->k; a++)
    for (int i = 0; i < 3; i++) local[i] += l->zeta[a] * field[((size_t)3 * a + i) * stride + s];
  mul_mv(p->n1->R, local, bend);
  cross3(l->t, y, x);
  for (int i = 0; i < 3; i++) w[i] = l->c[i] + x[i] + bend[i];
  motion_by_turn(l->t, y, bend, F, a1 + 3);
  cross3(l->t, F, by_y);
}

/* gz1 += Phi^T R_1^T g of a single point */
static void point_pull(const Path* p, const double* field, int stride, int s, const double* g,
                       double* gz1) {
  double back[3];
  mul_mtv(p->n1->R, g, back);
  for (int a = 1; a <= p->body->k; a++)
    for (int i = 0; i < 3; i++) gz1[a] += field[((size_t)3 * a + i) * stride + s] * back[i];
}

/* L = -w . F_contact(p2, (p2 - p1)/h): through w, and through p1 in the velocity,
 * dL/dp1 = -F^T w / h (that by p2 is in the matrix) */
static void contact_by_1(const Path* p, const Along* l, double* a1, double* gz1) {
  const int mp = p->mp;
  for (int k = 0; k < p->m; k++) {
    const int s = p->which[k];
    double y[3], F[3], w[3], by_y[3], by_p[3], turn[3];
    for (int i = 0; i < 3; i++) y[i] = p->near_y1[i * mp + s], F[i] = p->near_f[i * mp + s];
    point_motion(p, l, p->near_field, mp, s, y, F, w, by_y, a1);
    mul_mtv(p->touch_F + 9 * k, w, by_p);
    for (int i = 0; i < 3; i++) by_p[i] = -by_p[i] / p->h, a1[i] += by_p[i];
    cross3(y, by_p, turn);
    for (int i = 0; i < 3; i++) a1[3 + i] += turn[i], by_y[i] += by_p[i];
    point_pull(p, p->near_field, mp, s, by_y, gz1);
  }
}

/* L = -w . f of given forces: through w, and by f itself */
static void feet_by_1(const Path* p, const Along* l, double* a1, double* gz1, double* af) {
  const int nf = p->feet.np;
  for (int s = 0; s < p->feet.n; s++) {
    double y[3], w[3], by_y[3];
    for (int i = 0; i < 3; i++) y[i] = p->feet_y[i * nf + s];
    point_motion(p, l, p->feet.field, nf, s, y, p->u + p->body->r + 3 * s, w, by_y, a1);
    for (int i = 0; i < 3; i++) af[3 * s + i] = -w[i];
    point_pull(p, p->feet.field, nf, s, by_y, gz1);
  }
}

void variational_pull(Path* p, const double* lambda, double* a1, double* a0, double* au) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp;
  const Node *n0 = p->n0, *n1 = p->n1;
  const double kc = p->par[DP_CONTROL], beta = p->par[DP_DAMPING] / (2 * p->h);
  double gz0[MAX_ZETA] = {0}, gz1[MAX_ZETA] = {0};
  Along l = {.c = lambda, .t = lambda + 3, .q = lambda + 6};
  modes_along(b, n1->dz, l.q, l.zeta);
  moments_along(p, &l);
  inertia_by_0(p, &l, a0, gz0);
  inertia_by_1(p, &l, a1, gz1);
  if (p->par[DP_RIGHTING] != 0) righting_by_1(p, &l, a1);
  if (has_drag(b, p->par)) {
    drag_by_motion(p, &l, a1, gz1);
    drag_by_nodes(p, a1, gz1, a0, gz0);
  }
  contact_by_1(p, &l, a1, gz1);
  feet_by_1(p, &l, a1, gz1, au + r);
  for (int c = 0; c < r; c++) { /* through zeta, dz_1, and the elastic terms */
    const double K = b->stiffness[c] * l.q[c];
    a0[6 + c] = inner(n0->dz + c * kp, gz0, kp) + K * (.25 * (1 + kc) - beta);
    a1[6 + c] = inner(n1->dz + c * kp, gz1, kp) + inner(p->curvature + c * b->rp, l.q, r);
    a1[6 + c] += K * .5 * (1 + kc);
    au[c] = -K * kc;
  }
}
