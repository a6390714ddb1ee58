/* The variational step: three configurations x0, x1, x2, a substep h apart, satisfy the discrete
 * Euler-Lagrange equation at x1 with the forces of both intervals half each (docs/kernel.md),
 *
 *   J_1^T M (p2 - 2 p1 + p0)/h^2 + K [(1 + k_c)(q0 + 2 q1 + q2)/4 - k_c u + b (q2 - q0)/2h]
 *     - J_1^T [(F_01 + F_12)/2 + F_contact(p2, (p2 - p1)/h) + gravity + F_feet] - righting(R1) = 0,
 *
 * J_1 the tangent at x1. The inertia that is projected there, and not at x2, is what conserves linear and
 * angular momentum (discrete Noether), and what makes the step second order. F_12 takes the area vectors
 * extrapolated, (3 a1 - a0)/2, F_01 their mean: second order, and no derivative of them in the matrix.
 *
 * It is solved by a Newton method whose matrix is that at x1, symmetric and nearly free, improved by
 * Broyden's updates; contact's part is renewed where it changes. Where that fails: the exact matrix. */
#include "path.h"

static const double MAX_TURN = .7; /* rad or units of q in one iteration */
enum { QUASI_NEWTON = 30, HALVINGS = 6 };
static const double PER_GAP = 50, PER_LAW = 300; /* multiplications, about */

void path_prepare(Path* p) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double h = p->h, ih2 = 1 / (h * h), mass = b->mass, *par = p->par;
  const Node *n0 = p->n0, *n1 = p->n1;
  double* g = p->base;
  /* inertia: node 0 and twice node 1 */
  for (int i = 0; i < 3; i++) g[i] = ih2 * mass * (n0->at.c[i] - 2 * n1->at.c[i]);
  g[2] -= mass * par[DP_GRAVITY];
  double C[9], N[9], M[9], turn[3], *gz = p->base_gz; /* C = R1^T R0; N = sum m y1 y0^T */
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      C[3 * i + j] = n1->R[i] * n0->R[j] + n1->R[3 + i] * n0->R[3 + j] + n1->R[6 + i] * n0->R[6 + j];
    }
  for (int i = 0; i < 9; i++) N[i] = inner(n0->P + i * kp, n1->zeta, kp);
  for (int a = 0; a < kp; a++) {
    double s = 0;
    for (int i = 0; i < 9; i++) s += C[i] * n0->P[i * kp + a];
    gz[a] = ih2 * (s - 2 * (b->trace[a] + n1->zeta[a]));
  }
  to_world(n1->R, N, n0->R, M); /* y1 y0^T: sum y1 x y0 is minus its vee */
  vee(M, turn);
  for (int i = 0; i < 3; i++) g[3 + i] = -ih2 * turn[i];
  /* righting: torque D (R e_z) x e_z */
  const double D = mass * STANDARD_GRAVITY * par[DP_RIGHTING];
  g[3] -= D * n1->R[5], g[4] += D * n1->R[2];
  if (np && par[DP_FLUID_DENSITY] != 0) {
    for (int s = 0; s < 3 * np; s++) {
      p->mean01[s] = .5 * (n0->area[s] + n1->area[s]);
      p->area12[s] = 1.5 * n1->area[s] - .5 * n0->area[s];
    }
    interval_drag(p, n0, n1, p->mean01, p->f01, p->D01);
  }
  if (p->feet.n) {
    const int nf = p->feet.np;
    double local[(1 + DP_MAX_MODES) * 3 * DP_MAX_FEET], force[3 * DP_MAX_FEET] = {0};
    field_apply(b, p->feet.field, 1, n1->zeta, nf, local);
    rotate(n1->R, local, nf, p->feet_y);
    field_apply(b, p->feet.field, r, n1->dz, nf, local);
    for (int c = 0; c < r; c++) rotate(n1->R, local + c * 3 * nf, nf, p->feet_Jq + c * 3 * nf);
    for (int s = 0; s < p->feet.n; s++)
      for (int i = 0; i < 3; i++) force[i * nf + s] = p->u[r + 3 * s + i];
    sum_cross(p->feet_y, force, nf, turn);
    for (int i = 0; i < 3; i++) g[i] -= sum(force + i * nf, nf), g[3 + i] -= turn[i];
    rotate_back(n1->R, force, nf, local);
    for (int s = 0; s < 3 * nf; s++) local[s] = -local[s];
    field_transpose(b, p->feet.field, local, nf, gz);
  }
  memset(p->known, 0, sizeof p->known);
}

/* Contact at node 2: forces and derivatives of the m points that touch. */
static void touch(Path* p) {
  const Body* b = p->body;
  const int nc = b->nc, parts = terrain_parts(&p->terrain);
  const Terrain* t = &p->terrain;
  const double ih = 1 / p->h, *y = p->n2->touch;
  double radius = 0, c[3];
  for (int i = 0; i < 3; i++) c[i] = p->origin[i] + p->n2->at.c[i];
  for (int s = 0; s < b->n_contacts; s++)
    radius = fmax(radius, y[s] * y[s] + y[nc + s] * y[nc + s] + y[2 * nc + s] * y[2 * nc + s]);
  radius = sqrt(radius) + t->thickness;
  p->m = 0, *p->spent += PER_GAP * parts;
  for (int part = 0; part < parts; part++) {
    if (part < t->n_geoms ? terrain_gap(t, part, c, NULL, NULL) > radius
                          : c[2] - t->top - t->centre[2] > radius) continue;
    *p->spent += PER_GAP * b->n_contacts;
    for (int s = 0; s < b->n_contacts; s++) {
      double x[3], v[3];
      for (int i = 0; i < 3; i++) x[i] = c[i] + y[i * nc + s];
      if (terrain_gap(t, part, x, NULL, NULL) >= t->thickness) continue;
      for (int i = 0; i < 3; i++)
        v[i] = (p->n2->at.c[i] - p->n1->at.c[i] + y[i * nc + s] - p->n1->touch[i * nc + s]) * ih;
      int k = 0;
      while (k < p->m && p->which[k] != s) k++;
      if (k == p->m) {
        p->which[p->m++] = s;
        memset(p->touch_f + 3 * k, 0, 3 * sizeof(double));
        memset(p->touch_D + 9 * k, 0, 9 * sizeof(double)), memset(p->touch_F + 9 * k, 0, 9 * sizeof(double));
      }
      *p->spent += PER_LAW;
      contact_law(t, t->friction, part, x, v, p->touch_f + 3 * k, p->touch_D + 9 * k, p->touch_F + 9 * k);
    }
  }
  for (int k = 0; k < 9 * p->m; k++) p->touch_D[k] += ih * p->touch_F[k];
}

void path_residual(Path* p) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, np = b->np, nc = b->nc;
  const double h = p->h, ih2 = 1 / (h * h), *par = p->par;
  const Node *n0 = p->n0, *n1 = p->n1, *n2 = p->n2;
  double *g = p->g, *gz = p->gz, C[9], N[9], M[9], turn[3];
  for (int i = 0; i < 3; i++) g[i] = p->base[i] + ih2 * b->mass * n2->at.c[i];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      C[3 * i + j] = n1->R[i] * n2->R[j] + n1->R[3 + i] * n2->R[3 + j] + n1->R[6 + i] * n2->R[6 + j];
  for (int i = 0; i < 9; i++) N[i] = inner(n2->P + i * kp, n1->zeta, kp), C[i] *= ih2;
  for (int a = 0; a < kp; a++) {
    double s = p->base_gz[a];
    for (int i = 0; i < 9; i++) s += C[i] * n2->P[i * kp + a];
    gz[a] = s;
  }
  to_world(n1->R, N, n2->R, M);
  vee(M, turn);
  for (int i = 0; i < 3; i++) g[3 + i] = p->base[3 + i] - ih2 * turn[i];
  double modal[DP_MAX_MODES] = {0};
  if (np && par[DP_FLUID_DENSITY] != 0) {
    interval_drag(p, n1, n2, p->area12, p->f12, NULL);
    double* restrict f = p->local;
    for (int s = 0; s < 3 * np; s++) f[s] = .5 * (p->f01[s] + p->f12[s]);
    sum_cross(n1->y, f, np, turn);
    for (int i = 0; i < 3; i++) g[i] -= sum(f + i * np, np), g[3 + i] -= turn[i];
    for (int c = 0; c < r; c++) modal[c] = -inner(n1->Jq + c * 3 * np, f, 3 * np);
  }
  p->m = 0;
  if (terrain_parts(&p->terrain)) {
    touch(p);
    for (int k = 0; k < p->m; k++) {
      const int s = p->which[k];
      const double *f = p->touch_f + 3 * k, y[3] = {n1->touch[s], n1->touch[nc + s], n1->touch[2 * nc + s]};
      double local[3];
      cross3(y, f, turn);
      mul_mtv(n1->R, f, local);
      for (int i = 0; i < 3; i++) g[i] -= f[i], g[3 + i] -= turn[i];
      for (int a = 1; a <= b->k; a++) {
        const double* row = b->contacts + (size_t)3 * a * nc + s;
        gz[a] -= row[0] * local[0] + row[nc] * local[1] + row[2 * nc] * local[2];
      }
    }
  }
  const double kc = par[DP_CONTROL], beta = par[DP_DAMPING] / (2 * h);
  for (int c = 0; c < r; c++) {
    const double q0 = n0->at.q[c], q1 = n1->at.q[c], q2 = n2->at.q[c];
    g[6 + c] = modal[c] + inner(n1->dz + c * kp, gz, kp) +
               b->stiffness[c] * ((1 + kc) * .25 * (q0 + 2 * q1 + q2) - kc * p->u[c] + beta * (q2 - q0));
  }
}

/* out (3 x n) = D v for the symmetric D of drag, times a factor */
static void apply_drag(const double* restrict D, const double* restrict v, int n, double* restrict out) {
  for (int s = 0; s < n; s++) {
    double x = v[s], y = v[n + s], z = v[2 * n + s];
    out[s] = .5 * (D[s] * x + D[n + s] * y + D[2 * n + s] * z);
    out[n + s] = .5 * (D[n + s] * x + D[3 * n + s] * y + D[4 * n + s] * z);
    out[2 * n + s] = .5 * (D[2 * n + s] * x + D[4 * n + s] * y + D[5 * n + s] * z);
  }
}

void drag_matrix(Path* p, const Node* nb, double* H) {
  const int r = p->body->r, np = p->body->np, n = 6 + r;
  const Node* na = p->n1;
  *p->spent += n * np * (20. + 3 * r);
  const double *restrict D = p->D12, *y = nb->y;
  double* col = p->local;
  double* out = p->local + 3 * np;
  for (int j = 0; j < n; j++) {
    const double* move = col;
    if (j >= 6) move = nb->Jq + (j - 6) * 3 * np;
    else if (j < 3)
      for (int i = 0; i < 3; i++)
        for (int s = 0; s < np; s++) col[i * np + s] = i == j;
    else { /* e_m x y */
      const int m = j - 3, m1 = (m + 1) % 3, m2 = (m + 2) % 3;
      for (int s = 0; s < np; s++)
        col[m * np + s] = 0, col[m1 * np + s] = -y[m2 * np + s], col[m2 * np + s] = y[m1 * np + s];
    }
    apply_drag(D, move, np, out);
    double turn[3];
    sum_cross(na->y, out, np, turn);
    for (int i = 0; i < 3; i++) H[i * n + j] += sum(out + i * np, np), H[(3 + i) * n + j] += turn[i];
    for (int c = 0; c < r; c++) H[(6 + c) * n + j] += inner(na->Jq + c * 3 * np, out, 3 * np);
  }
}

/* The matrix that node 2 would have at node 1, with drag at the present guess: symmetric, definite. */
static void free_matrix(Path* p, double* H) {
  const Body* b = p->body;
  const int r = b->r, kp = b->kp, n = 6 + r;
  const double h = p->h, ih2 = 1 / (h * h), *par = p->par;
  const Node* n1 = p->n1;
  memset(H, 0, sizeof(double) * n * n);
  if (b->np && par[DP_FLUID_DENSITY] != 0) {
    interval_drag(p, n1, p->n2, p->area12, p->f12, p->D12);
    drag_matrix(p, n1, H);
  }
  double N[9], M[9];
  for (int i = 0; i < 9; i++) N[i] = inner(n1->P + i * kp, n1->zeta, kp);
  to_world(n1->R, N, n1->R, M);
  const double trace = M[0] + M[4] + M[8];
  for (int i = 0; i < 3; i++) {
    H[i * n + i] += ih2 * b->mass;
    for (int j = 0; j < 3; j++) H[(3 + i) * n + 3 + j] += ih2 * ((i == j ? trace : 0) - M[3 * i + j]);
  }
  for (int c = 0; c < r; c++) {
    const double* dz = n1->dz + c * kp;
    double turn[3], world[3]; /* sum m y x (B dz) */
    for (int i = 0; i < 9; i++) N[i] = inner(n1->P + i * kp, dz, kp); /* (B dz)_i y_j */
    vee(N, turn), mul_mv(n1->R, turn, world);
    for (int i = 0; i < 3; i++) {
      H[(3 + i) * n + 6 + c] += ih2 * world[i], H[(6 + c) * n + 3 + i] += ih2 * world[i];
    }
    for (int d = c; d < r; d++) {
      const double s = ih2 * inner(dz, n1->dz + d * kp, kp);
      H[(6 + c) * n + 6 + d] += s;
      if (d != c) H[(6 + d) * n + 6 + c] += s;
    }
    H[(6 + c) * n + 6 + c] += b->stiffness[c] * (.25 * (1 + par[DP_CONTROL]) + par[DP_DAMPING] / (2 * h));
  }
}

/* Derivatives by q of contact point s at node 1, 3 x r. */
static const double* touch_modes(Path* p, int s) {
  const Body* b = p->body;
  const int r = b->r, nc = b->nc, kp = b->kp;
  double* J = p->touch_J + (size_t)3 * r * s;
  if (p->known[s]) return J;
  p->known[s] = 1;
  for (int c = 0; c < r; c++) {
    double local[3] = {0}, world[3];
    const double* dz = p->n1->dz + c * kp;
    for (int a = 1; a <= b->k; a++)
      for (int i = 0; i < 3; i++) local[i] += dz[a] * b->contacts[((size_t)3 * a + i) * nc + s];
    mul_mv(p->n1->R, local, world);
    for (int i = 0; i < 3; i++) J[i * r + c] = world[i];
  }
  return J;
}

/* J (3 x ROW) of a point at y from the centre with modal derivatives Jq (3 x r). */
static void point_jacobian(const double* y, const double* Jq, int r, double J[3][ROW]) {
  memset(J, 0, 3 * ROW * sizeof(double));
  for (int i = 0; i < 3; i++) {
    J[i][i] = 1;
    J[i][3 + (i + 1) % 3] = y[(i + 2) % 3], J[i][3 + (i + 2) % 3] = -y[(i + 1) % 3]; /* t x y */
    memcpy(J[i] + 6, Jq + i * r, sizeof(double) * r);
  }
}

void touch_matrix(Path* p, int exact, double* H) {
  const Body* b = p->body;
  const int r = b->r, n = 6 + r, nc = b->nc, kp = b->kp;
  double sums[MAX_N * ROW] = {0};
  *p->spent += p->m * (3. * ROW * n + (exact ? 2 : 1) * 3. * r * kp);
  for (int k = 0; k < p->m; k++) {
    const int s = p->which[k];
    double J[3][ROW], J2[3][ROW], DJ[3][ROW];
    const double *D = p->touch_D + 9 * k, *t = p->n1->touch, y[3] = {t[s], t[nc + s], t[2 * nc + s]};
    point_jacobian(y, touch_modes(p, s), r, J);
    memcpy(J2, J, sizeof J);
    if (exact) {
      double Jq[3 * DP_MAX_MODES], local[3], world[3];
      const double *t2 = p->n2->touch, y2[3] = {t2[s], t2[nc + s], t2[2 * nc + s]};
      for (int c = 0; c < r; c++) {
        memset(local, 0, sizeof local);
        for (int a = 1; a <= b->k; a++)
          for (int i = 0; i < 3; i++)
            local[i] += p->n2->dz[c * kp + a] * b->contacts[((size_t)3 * a + i) * nc + s];
        mul_mv(p->n2->R, local, world);
        for (int i = 0; i < 3; i++) Jq[i * r + c] = world[i];
      }
      point_jacobian(y2, Jq, r, J2);
    }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < ROW; j++)
        DJ[i][j] = D[3 * i] * J2[0][j] + D[3 * i + 1] * J2[1][j] + D[3 * i + 2] * J2[2][j];
    for (int a = 0; a < n; a++) {
      const double x = J[0][a], yy = J[1][a], z = J[2][a];
      double* restrict row = sums + a * ROW;
      for (int j = 0; j < ROW; j++) row[j] += x * DJ[0][j] + yy * DJ[1][j] + z * DJ[2][j];
    }
  }
  for (int a = 0; a < n; a++)
    for (int j = 0; j < n; j++) H[a * n + j] += sums[a * ROW + j];
}

/* Node 2 = from, moved by -alpha step. */
static void move(Path* p, const Pose* from, const double* step, double alpha, int level) {
  Pose to;
  double turn[3], dq[4];
  for (int i = 0; i < 3; i++) to.c[i] = from->c[i] - alpha * step[i], turn[i] = -alpha * step[3 + i];
  quat_exp(turn, dq);
  quat_mul(dq, from->quat, to.quat);
  quat_normalize(to.quat);
  for (int c = 0; c < p->body->r; c++) to.q[c] = from->q[c] - alpha * step[6 + c];
  node_set(p, p->n2, &to, level);
}

/* Factors of a matrix: symmetric and definite, or any. */
typedef struct {
  double A[MAX_N * MAX_N];
  int n, symmetric, pivot[MAX_N];
} Factors;

static int factorise(Factors* f, const double* H, int n, int symmetric) {
  int sign;
  f->n = n, f->symmetric = symmetric;
  if (symmetric) return cholesky(H, n, f->A);
  memcpy(f->A, H, sizeof(double) * n * n);
  return lu(f->A, n, f->pivot, &sign);
}
static void solve(const Factors* f, const double* rhs, double* x) {
  if (f->symmetric) cholesky_solve(f->A, f->n, rhs, x);
  else lu_solve(f->A, f->pivot, f->n, rhs, x);
}

static double largest_of(const double* a, int n) { /* infinity if one is not finite */
  double s = 0;
  for (int i = 0; i < n; i++) s = fabs(a[i]) <= s ? s : isfinite(a[i]) ? fabs(a[i]) : INFINITY;
  return s;
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

/* Newton with the matrix at node 1 and Broyden's updates of it; 1 if it converged. */
static int quasi_newton(Path* p, const Pose* guess, dp_info* info) {
  const int n = 6 + p->body->r;
  const double tolerance = 10 * p->par[DP_TOLERANCE] * p->par[DP_TOLERANCE];
  double free[MAX_N * MAX_N], steps[QUASI_NEWTON + 1][MAX_N], size2[QUASI_NEWTON + 1], next[MAX_N];
  Factors f;
  node_set(p, p->n2, guess, NODE_RESIDUAL);
  free_matrix(p, free);
  path_residual(p);
  int kept = 0; /* updates */
  double before = 0;
  for (int k = 0, fresh = 1; k < QUASI_NEWTON && *p->spent < DP_MAX_WORK; k++) {
    info->iterations++;
    if (fresh) {
      memcpy(p->H, free, sizeof(double) * n * n);
      if (p->m) touch_matrix(p, 0, p->H);
      if (!factorise(&f, p->H, n, !p->m)) return 0;
      solve(&f, p->g, steps[0]);
      kept = 0, fresh = 0;
    }
    double* z = steps[kept];
    const double largest = largest_of(z, n), turn = largest_of(z + 3, n - 3);
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    const Pose from = p->n2->at;
    const double rate = before > 0 ? fmin(1, largest / before) : 1;
    if (largest * rate < tolerance) { /* after this step nothing is left */
      move(p, &from, z, 1, NODE_RESIDUAL);
      return 1;
    }
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1, moved = INFINITY;
    const double size = inner(z, z, n);
    size2[kept] = size;
    for (int halvings = 0;; halvings++) {
      move(p, &from, z, alpha, NODE_RESIDUAL);
      path_residual(p);
      solve(&f, p->g, next);
      for (int j = 0; j < kept; j++) { /* earlier updates */
        const double share = inner(steps[j], next, n) / size2[j];
        for (int i = 0; i < n; i++) next[i] += share * steps[j + 1][i];
      }
      moved = inner(next, next, n);
      const double reduced = 1 - .25 * alpha;
      if (moved <= reduced * reduced * size) break;
      if (halvings == HALVINGS) return 0;
      alpha *= .5;
    }
    before = largest;
    if (alpha < 1 || (p->m && moved > .01 * size)) { /* far from linear: renew the matrix here */
      fresh = 1;
      continue;
    }
    const double along = 1 - inner(z, next, n) / size; /* Broyden's update by this step */
    if (!(along > .1)) { fresh = 1; continue; }
    kept++;
    for (int i = 0; i < n; i++) steps[kept][i] = next[i] / along;
  }
  return 0;
}

/* Newton with the exact matrix; a step is taken if the next one, with the same factors, is shorter
 * (Deuflhard's natural monotonicity test). */
static int newton(Path* p, const Pose* guess, dp_info* info) {
  const int n = 6 + p->body->r, limit = (int)fmin(p->par[DP_MAX_NEWTON], 1000);
  double step[MAX_N], next[MAX_N];
  Factors f;
  node_set(p, p->n2, guess, NODE_WHOLE);
  path_residual(p);
  for (int k = 0; k < limit && *p->spent < DP_MAX_WORK; k++) {
    info->iterations++;
    variational_matrix(p);
    if (!factorise(&f, p->H, n, 0)) return 0;
    solve(&f, p->g, step);
    const double largest = largest_of(step, n), turn = largest_of(step + 3, n - 3);
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    const Pose from = p->n2->at;
    if (largest < p->par[DP_TOLERANCE]) { /* quadratic convergence: after this step nothing is left */
      move(p, &from, step, 1, NODE_RESIDUAL);
      return 1;
    }
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
    const double size = inner(step, step, n);
    for (int halvings = 0;; halvings++) {
      move(p, &from, step, alpha, NODE_WHOLE);
      path_residual(p);
      solve(&f, p->g, next);
      const double reduced = 1 - .25 * alpha;
      if (inner(next, next, n) <= reduced * reduced * size) break;
      if (halvings == HALVINGS) return 0;
      alpha *= .5;
    }
  }
  return 0;
}

int variational_solve(Path* p, const Pose* guess, dp_info* info) {
  Pose start;
  if (guess) start = *guess;
  else go_on(p, &start);
  info->attempts++;
  if (quasi_newton(p, &start, info)) return 1;
  info->attempts++;
  return newton(p, &start, info);
}
