/* Exact derivatives of the variational step's equations g(x0, x1, x2, u).
 *
 * g depends on node 2 through the places p2 alone, so that its matrix by them is J_1^T (...) J_2. For the
 * others take the scalar L = lambda . g with w = lambda_c + lambda_t x y1 + R1 B dz1 lambda_q the motion
 * of a point at node 1 along lambda,
 *
 *   L = sum_v m w.(p2 - 2 p1 + p0)/h^2 - sum_s w.(F_01 + F_12)/2 - sum_s w.F_contact - sum_s w.f_feet + ...,
 *
 * and differentiate it by places, area vectors and w; gradients by zeta go on to q by dz. */
#include "path.h"

void inertia_matrix(const Path* p, const Node* nb, double* H) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, n = 6 + r;
  const double ih2 = 1 / (p->h * p->h), *par = p->par;
  const double elastic = .25 * (1 + par[DP_CONTROL]) + par[DP_DAMPING] / (2 * p->h);
  const Node* n1 = p->n1;
  double N[9], M[9], C[9], turn[3], row[DP_MAX_BASIS + 2 * PAD];
  /* M = sum m y_b y_1^T */
  for (int i = 0; i < 9; i++) N[i] = inner(n1->P + i * kp, nb->zeta, kp);
  to_world(nb->R, N, n1->R, M);
  const double trace = M[0] + M[4] + M[8];
  for (int i = 0; i < 3; i++) {
    H[i * n + i] += ih2 * b->mass;
    for (int j = 0; j < 3; j++) H[(3 + i) * n + 3 + j] += ih2 * ((i == j ? trace : 0) - M[3 * i + j]);
  }
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      C[3 * i + j] = ih2 * (n1->R[i] * nb->R[j] + n1->R[3 + i] * nb->R[3 + j] + n1->R[6 + i] * nb->R[6 + j]);
    }
  for (int c = 0; c < r; c++) {
    const double* Q = n1->Q + (size_t)9 * kp * c; /* ji: sum m Phi_a,j (B dz1)_i */
    for (int i = 0; i < 9; i++) N[i] = inner(n1->P + i * kp, nb->dz + c * kp, kp); /* (B dz_b) y_1^T */
    to_world(nb->R, N, n1->R, M), vee(M, turn);
    for (int i = 0; i < 3; i++) H[(3 + i) * n + 6 + c] += ih2 * turn[i];
    for (int i = 0; i < 9; i++) N[i] = inner(Q + (i % 3 * 3 + i / 3) * kp, nb->zeta, kp); /* (B dz1) y_b^T */
    to_world(n1->R, N, nb->R, M), vee(M, turn);
    for (int i = 0; i < 3; i++) H[(6 + c) * n + 3 + i] += ih2 * turn[i];
    for (int a = 0; a < kp; a++) row[a] = 0;
    for (int i = 0; i < 9; i++) {
      const double factor = C[i % 3 * 3 + i / 3], *restrict Qi = Q + i * kp;
      for (int a = 0; a < kp; a++) row[a] += factor * Qi[a];
    }
    products(row, 1, nb->dz, r, kp, H + (6 + c) * n + 6, n);
    H[(6 + c) * n + 6 + c] += b->stiffness[c] * elastic;
  }
}

/* out (3 x n) = D v / 2 for the symmetric D of drag */
static void apply_drag(const double* restrict D, const double* restrict v, int n, double* restrict out) {
  for (int s = 0; s < n; s++) {
    double x = v[s], y = v[n + s], z = v[2 * n + s];
    out[s] = .5 * (D[s] * x + D[n + s] * y + D[2 * n + s] * z);
    out[n + s] = .5 * (D[n + s] * x + D[3 * n + s] * y + D[4 * n + s] * z);
    out[2 * n + s] = .5 * (D[2 * n + s] * x + D[4 * n + s] * y + D[5 * n + s] * z);
  }
}

void drag_matrix(Path* p, const double* y, const double* Jq, double* H) {
  const int r = p->body->r, np = p->body->np, n = 6 + r;
  const Node* n1 = p->n1;
  *p->spent += n * np * (20. + 3 * r);
  double* restrict move = p->local;
  for (int j = 0; j < n; j++) {
    double* out = p->columns + (size_t)j * 3 * np;
    if (j < 3)
      for (int i = 0; i < 3; i++)
        for (int s = 0; s < np; s++) move[i * np + s] = i == j;
    else if (j < 6) { /* e_m x y */
      const int m = j - 3, m1 = (m + 1) % 3, m2 = (m + 2) % 3;
      for (int s = 0; s < np; s++)
        move[m * np + s] = 0, move[m1 * np + s] = -y[m2 * np + s], move[m2 * np + s] = y[m1 * np + s];
    }
    apply_drag(p->D12, j < 6 ? p->local : Jq + (size_t)(j - 6) * 3 * np, np, out);
    double turn[3];
    sum_cross(n1->y, out, np, turn);
    for (int i = 0; i < 3; i++) H[i * n + j] += sum(out + i * np, np), H[(3 + i) * n + j] += turn[i];
  }
  products(n1->Jq, r, p->columns, n, 3 * np, H + 6 * n, n);
}

void variational_matrix(Path* p) {
  const int n = 6 + p->body->r;
  memset(p->H, 0, sizeof(double) * n * n);
  inertia_matrix(p, p->n2, p->H);
  if (has_drag(p)) {
    interval_drag(p, p->n1, p->n2, p->area12, p->f12, p->D12);
    drag_matrix(p, p->n2->y, p->n2->Jq, p->H);
  }
  if (p->m) touch_matrix(p, 1, p->H);
}

/* gz -= field^T R_1^T f: what forces f (3 x n, world) on points of a field do to zeta_1 */
static void force_on_zeta(Path* p, const double* field, const double* f, int n, double* gz) {
  double local[3 * DP_MAX_POINTS];
  rotate_back(p->n1->R, f, n, local);
  for (int s = 0; s < 3 * n; s++) local[s] = -local[s];
  field_transpose(p->body, field, local, n, gz);
}

/* The equations are known at node 2: what all of `variational_pull` share. */
void variational_pull_prepare(Path* p) {
  const Body* b = p->body;
  const int np = b->np, r = b->r, kp = b->kp, nf = p->feet.np;
  const double ih2 = 1 / (p->h * p->h);
  double gz[DP_MAX_BASIS + 2 * PAD]; /* the equations' force on zeta_1 */
  for (int a = 0; a < kp; a++) gz[a] = -2 * ih2 * (b->trace[a] + p->n1->zeta[a]);
  for (int t = 0; t < 2; t++) {
    Node* at = t ? p->n0 : p->n2;
    node_moments(p, at);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        const double *R1 = p->n1->R + i, *R = at->R + j, *P = at->P + (3 * i + j) * kp;
        const double C = ih2 * (R1[0] * R[0] + R1[3] * R[3] + R1[6] * R[6]);
        for (int a = 0; a < kp; a++) gz[a] += C * P[a];
      }
  }
  if (has_drag(p)) {
    double* f = p->pull_f;
    for (int s = 0; s < 3 * np; s++) f[s] = .5 * (p->f01[s] + p->f12[s]);
    force_on_zeta(p, b->points, f, np, gz);
  }
  if (p->m) force_on_zeta(p, p->near_field, p->near_f, p->mp, gz);
  if (p->feet.n) {
    double f[3 * DP_MAX_FEET] = {0};
    for (int i = 0; i < 3 * p->feet.n; i++) f[i % 3 * nf + i / 3] = p->u[r + i];
    force_on_zeta(p, p->feet.field, f, nf, gz);
  }
  memset(p->curvature, 0, sizeof(double) * r * b->rp);
  kinematics_curvature(b, gz, p->n1->scratch, p->curvature);
  for (int c = 0; c < r; c++)
    for (int d = 0; d < c; d++) p->curvature[c * b->rp + d] = p->curvature[d * b->rp + c];
}

/* Gradients of -w . F/2 of an interval by its places (pull: later end; minus it is that of the earlier)
 * and by its area vectors; w, both ends' difference and area 3 np each. */
static void drag_pull(const Path* p, const Node* from, const Node* to, const double* restrict area,
                      const double* restrict D, const double* restrict w, double* restrict gp,
                      double* restrict ga) {
  const int n = p->body->np;
  const double ih = 1 / p->h, rho = p->par[DP_FLUID_DENSITY];
  const double kn = .25 * rho * p->par[DP_DRAG_NORMAL], kt = .25 * rho * p->par[DP_DRAG_TANGENT];
  for (int s = 0; s < n; s++) {
    double v[3], a[3], d[3];
    for (int i = 0; i < 3; i++) {
      const int at = i * n + s;
      v[i] = (to->at.c[i] - from->at.c[i] + to->y[at] - from->y[at]) * ih, a[i] = area[at], d[i] = w[at];
    }
    const double A2 = dot3(a, a) + 1e-20, A = sqrt(A2), vn = dot3(v, a), av = fabs(vn), da = dot3(d, a);
    const double dv = dot3(d, v), speed = sqrt(dot3(v, v) + SPEED2), cn = kn / A2;
    gp[s] = .5 * (D[s] * d[0] + D[n + s] * d[1] + D[2 * n + s] * d[2]);
    gp[n + s] = .5 * (D[n + s] * d[0] + D[3 * n + s] * d[1] + D[4 * n + s] * d[2]);
    gp[2 * n + s] = .5 * (D[2 * n + s] * d[0] + D[4 * n + s] * d[1] + D[5 * n + s] * d[2]);
    for (int i = 0; i < 3; i++)
      ga[i * n + s] = cn * (2 * av * v[i] * da + vn * av * d[i] - 2 * vn * av * da * a[i] / A2) +
                      kt * speed * dv * a[i] / A;
  }
}

void variational_pull(Path* p, const double* lambda, double* a1, double* a0, double* au) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double h = p->h, ih2 = 1 / (h * h), *par = p->par, *lc = lambda, *lt = lambda + 3, *lq = lambda + 6;
  const Node *n0 = p->n0, *n1 = p->n1, *n2 = p->n2;
  double along[DP_MAX_BASIS + 2 * PAD]; /* motion of zeta_1 */
  double gz0[DP_MAX_BASIS + 2 * PAD] = {0}, gz1[DP_MAX_BASIS + 2 * PAD] = {0};
  double Rl[9], N[9], M[9], turn[3];
  for (int a = 0; a < kp; a++) {
    double s = 0;
    for (int c = 0; c < r; c++) s += lq[c] * n1->dz[c * kp + a];
    along[a] = s;
  }
  skew_mul(lt, n1->R, Rl);
  for (int i = 0; i < 6 + r; i++) a1[i] = a0[i] = 0;

  /* inertia by node 0: T_b = sum m w Phi_b^T (w world, Phi body axes) over h^2, without lambda_c */
  double T[9 * (DP_MAX_BASIS + 2 * PAD)];
  memset(T, 0, sizeof(double) * 9 * kp);
  double* restrict P = p->along_moments;
  memset(P, 0, sizeof(double) * 9 * kp);
  for (int c = 0; c < r; c++) {
    const double* restrict Q = n1->Q + (size_t)9 * kp * c;
    for (int a = 0; a < 9 * kp; a++) P[a] += lq[c] * Q[a];
  }
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      double* restrict Tij = T + (3 * i + j) * kp;
      for (int m = 0; m < 3; m++) {
        const double f = ih2 * Rl[3 * i + m], g = ih2 * n1->R[3 * i + m];
        const double *restrict P1 = n1->P + (3 * j + m) * kp, *restrict Pl = P + (3 * j + m) * kp;
        for (int a = 0; a < kp; a++) Tij[a] += f * P1[a] + g * Pl[a];
      }
    }
  for (int i = 0; i < 3; i++) a0[i] = ih2 * b->mass * lc[i], a1[i] = -2 * a0[i];
  for (int i = 0; i < 9; i++) N[i] = inner(T + i * kp, n0->zeta, kp);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) M[3 * i + j] = dot3(N + 3 * i, n0->R + 3 * j); /* w y0^T */
  vee(M, a0 + 3);
  for (int a = 0; a < kp; a++) {
    double s = 0;
    for (int i = 0; i < 9; i++) s += n0->R[i] * T[i * kp + a];
    gz0[a] = s;
  }

  /* inertia by node 1, Y = y2 + y0: L = lambda_t . sum m y1 x Y + sum m (R1 B along).(Y - 2 y1) */
  double Y1[9] = {0}, YB[9] = {0}; /* sum m Y y1^T; sum m (R1 B along) Y^T */
  for (int t = 0; t < 2; t++) {
    const Node* at = t ? n0 : n2;
    double Y[9];
    for (int i = 0; i < 9; i++) N[i] = inner(at->P + i * kp, n1->zeta, kp); /* y1 y^T, body axes */
    to_world(n1->R, N, at->R, Y);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) Y1[3 * i + j] += ih2 * Y[3 * j + i];
    for (int i = 0; i < 9; i++) N[i] = inner(at->P + i * kp, along, kp);
    to_world(n1->R, N, at->R, Y);
    for (int i = 0; i < 9; i++) YB[i] += ih2 * Y[i];
    /* by zeta_1 through y1: (R1 Phi_a).(Y x lambda_t) = -lambda_t . (Y x R1 Phi_a), Q = R1^T [lambda_t]^T R */
    double Q[9], LR[9];
    skew_mul(lt, at->R, LR); /* lambda_t x (R e_j) */
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        Q[3 * i + j] = -ih2 * (n1->R[i] * LR[j] + n1->R[3 + i] * LR[3 + j] + n1->R[6 + i] * LR[6 + j]);
    for (int a = 0; a < kp; a++) {
      double s = 0;
      for (int i = 0; i < 9; i++) s += Q[i] * at->P[i * kp + a];
      gz1[a] += s;
    }
  }
  const double trace = Y1[0] + Y1[4] + Y1[8];
  for (int i = 0; i < 3; i++) a1[3 + i] += dot3(Y1 + 3 * i, lt) - trace * lt[i];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) M[3 * i + j] = YB[3 * j + i]; /* Y (R1 B along)^T */
  vee(M, turn);
  for (int i = 0; i < 3; i++) a1[3 + i] += turn[i];
  for (int a = 1; a < kp; a++) gz1[a] -= 2 * ih2 * along[a];

  /* righting: L has -lambda_t . D (R1 e_z) x e_z */
  const double D = b->mass * STANDARD_GRAVITY * par[DP_RIGHTING];
  if (D != 0) {
    const double up[3] = {0, 0, 1}, z[3] = {n1->R[2], n1->R[5], n1->R[8]};
    double side[3];
    cross3(up, lt, side), cross3(z, side, turn);
    for (int i = 0; i < 3; i++) a1[3 + i] -= D * turn[i];
  }

  if (has_drag(p)) {
    double *w = p->pull_w, *arm = p->pull_arm, *gp01 = p->pull_01, *ga01 = p->pull_a01;
    double *gp12 = p->pull_12, *ga12 = p->pull_a12, *force = p->pull_f;
    field_apply(b, b->points, 1, along, np, p->local);
    rotate(n1->R, p->local, np, arm); /* R1 Phi along */
    double sum_turn[3] = {0};
    for (int s = 0; s < np; s++) {
      const double y[3] = {n1->y[s], n1->y[np + s], n1->y[2 * np + s]};
      const double F[3] = {.5 * (p->f01[s] + p->f12[s]), .5 * (p->f01[np + s] + p->f12[np + s]),
                           .5 * (p->f01[2 * np + s] + p->f12[2 * np + s])};
      const double bend[3] = {arm[s], arm[np + s], arm[2 * np + s]};
      double x[3], Fl[3];
      cross3(lt, y, x), cross3(F, lt, Fl);
      for (int i = 0; i < 3; i++) w[i * np + s] = lc[i] + x[i] + bend[i], force[i * np + s] = -Fl[i];
      /* by a turn of node 1, through w */
      const double yl = dot3(y, lt), yF = dot3(y, F);
      cross3(bend, F, x);
      for (int i = 0; i < 3; i++) sum_turn[i] -= F[i] * yl - lt[i] * yF + x[i];
    }
    for (int i = 0; i < 3; i++) a1[3 + i] += sum_turn[i];
    rotate_back(n1->R, force, np, p->local); /* by zeta_1 through y1 in w */
    field_transpose(b, b->points, p->local, np, gz1);
    drag_pull(p, n0, n1, p->mean01, p->D01, w, gp01, ga01);
    drag_pull(p, n1, n2, p->area12, p->D12, w, gp12, ga12);
    for (int s = 0; s < 3 * np; s++) {
      gp12[s] = gp01[s] - gp12[s], gp01[s] = -gp01[s]; /* places of node 1, of node 0 */
      const double a01 = .5 * ga01[s];
      ga01[s] = a01 - .5 * ga12[s], ga12[s] = a01 + 1.5 * ga12[s]; /* areas of node 0, of node 1 */
    }
    node_pull(p, n0, gp01, ga01, a0, gz0);
    node_pull(p, n1, gp12, ga12, a1, gz1);
  }

  /* forces on single points: contact and feet */
  const int given = p->feet.n, nf = p->feet.np;
  for (int k = 0; k < p->m + given; k++) {
    const int contact = k < p->m, s = contact ? p->which[k] : k - p->m, stride = contact ? p->mp : nf;
    const double *field = contact ? p->near_field : p->feet.field, *places = contact ? p->near_y1 : p->feet_y;
    double F[3];
    for (int i = 0; i < 3; i++) F[i] = contact ? p->near_f[i * p->mp + s] : p->u[r + 3 * s + i];
    const double y[3] = {places[s], places[stride + s], places[2 * stride + s]};
    double local[3] = {0}, bend[3], w[3], x[3], pull[3] = {0}, back[3];
    for (int a = 1; a <= b->k; a++)
      for (int i = 0; i < 3; i++) local[i] += along[a] * field[((size_t)3 * a + i) * stride + s];
    mul_mv(n1->R, local, bend);
    cross3(lt, y, x);
    for (int i = 0; i < 3; i++) w[i] = lc[i] + x[i] + bend[i];
    const double yl = dot3(y, lt), yF = dot3(y, F);
    cross3(bend, F, x);
    for (int i = 0; i < 3; i++) a1[3 + i] -= F[i] * yl - lt[i] * yF + x[i];
    cross3(lt, F, pull); /* by y1 through w */
    if (contact) { /* and by p1 through the velocity; that by p2 is in the matrix */
      double by[3];
      mul_mtv(p->touch_F + 9 * k, w, by);
      for (int i = 0; i < 3; i++) by[i] = -by[i] / h, a1[i] += by[i];
      cross3(y, by, turn);
      for (int i = 0; i < 3; i++) a1[3 + i] += turn[i], pull[i] += by[i];
    } else
      for (int i = 0; i < 3; i++) au[r + 3 * s + i] = -w[i];
    mul_mtv(n1->R, pull, back);
    for (int a = 1; a <= b->k; a++)
      for (int i = 0; i < 3; i++) gz1[a] += field[((size_t)3 * a + i) * stride + s] * back[i];
  }

  const double kc = par[DP_CONTROL], beta = par[DP_DAMPING] / (2 * h);
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c] * lq[c];
    a0[6 + c] += inner(n0->dz + c * kp, gz0, kp) + K * (.25 * (1 + kc) - beta);
    a1[6 + c] += inner(n1->dz + c * kp, gz1, kp) + inner(p->curvature + c * b->rp, lq, r) +
                 K * .5 * (1 + kc);
    au[c] = -K * kc;
  }
}
