/* Exact derivatives of a step, by the implicit function theorem at its solution. */
#include "work.h"

/* a1, a2 (6 + r), au (r): gradients of lambda . dE/dQ with respect to the last configuration, the
 * one before (both in world tangent coordinates) and u (nu); after assemble at the solution. */
static void mixed(Work* w, const double* lambda, double* a1, double* a2, double* au) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double h = w->par[DP_TIMESTEP], ih2 = 1 / (h * h);
  double* dz = w->gzeta; /* motion of zeta along lambda */
  for (int a = 0; a < kp; a++) dz[a] = 0;
  for (int c = 0; c < r; c++)
    for (int a = 0; a < kp; a++) dz[a] += lambda[6 + c] * w->now.dz[c * kp + a];
  double Rl[9];
  skew_mul(lambda + 3, w->now.R, Rl);
  /* T_b = sum_v m_v w_v Phi_b^T for the motion w of the vertices along lambda, over h^2 */
  double* T = w->Wg;
  for (int i = 0; i < 9 * kp; i++) T[i] = 0;
  for (int t = 0; t < 2; t++) {
    const double* A = t ? w->now.R : Rl;
    moments_apply(b, t ? dz : w->now.zeta, w->P);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        double* restrict Tij = T + (3 * i + j) * kp;
        for (int m = 0; m < 3; m++) {
          const double f = ih2 * A[3 * i + m], *restrict P = w->P + (3 * j + m) * kp;
          for (int a = 0; a < kp; a++) Tij[a] += f * P[a];
        }
      }
  }
  double gz[DP_MAX_BASIS + 1 + PAD], Tz[9], N[9];
  for (int t = 0; t < 2; t++) {
    const Config* cfg = t ? &w->two : &w->one;
    const double factor = t ? 1 : -2;
    double* out = t ? a2 : a1;
    for (int i = 0; i < 3; i++) out[i] = factor * ih2 * b->mass * lambda[i];
    for (int i = 0; i < 9; i++) Tz[i] = factor * inner(T + i * kp, cfg->zeta, kp);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(Tz + 3 * i, cfg->R + 3 * j);
    vee(N, out + 3);
    for (int a = 0; a < kp; a++) {
      double s = 0;
      for (int i = 0; i < 9; i++) s += cfg->R[i] * T[i * kp + a];
      gz[a] = factor * s;
    }
    if (t == 0 && np && w->par[DP_FLUID_DENSITY] != 0) {
      const double *a = w->area, *p = w->w, *p0 = w->before, ih = 1 / h, *R = cfg->R;
      double *restrict dp = w->body_points, *restrict gp = w->f, *restrict ga = w->DJ;
      double* yd = w->D; /* the Hessian is done with it */
      field_apply(b, b->points, 1, dz, np, yd);
      rotate(w->now.R, yd, np, dp);
      const double* l = lambda;
      for (int s = 0; s < np; s++) {
        double x = p[s], y = p[np + s], z = p[2 * np + s];
        dp[s] += l[0] + l[4] * z - l[5] * y;
        dp[np + s] += l[1] + l[5] * x - l[3] * z;
        dp[2 * np + s] += l[2] + l[3] * y - l[4] * x;
        double v[3], n[3], d[3];
        for (int i = 0; i < 3; i++) {
          v[i] = (w->now.c[i] + p[i * np + s] - p0[i * np + s]) * ih;
          n[i] = a[i * np + s], d[i] = dp[i * np + s];
        }
        double A2 = dot3(n, n) + 1e-20, A = sqrt(A2), vn = dot3(v, n), av = fabs(vn), tau = dot3(n, d);
        double vd = dot3(v, d), speed = sqrt(dot3(v, v) + SPEED2), cn = w->cn[s], ct = w->ct[s];
        for (int i = 0; i < 3; i++) {
          double gv = 2 * cn * av * tau * n[i] + ct * (v[i] * vd / speed + speed * d[i]);
          ga[i * np + s] = cn * (2 * av * v[i] * tau + vn * av * d[i] - 2 * vn * av * tau * n[i] / A2) +
                           ct / A * speed * vd * n[i] / A;
          gp[i * np + s] = -ih * gv;
        }
      }
      double turn[3];
      for (int i = 0; i < 3; i++) out[i] += sum(gp + i * np, np);
      double* arm = w->D; /* p0 - c0 */
      for (int i = 0; i < 3; i++)
        for (int s = 0; s < np; s++) arm[i * np + s] = p0[i * np + s] - cfg->c[i];
      sum_cross(arm, gp, np, turn);
      for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
      sum_cross(a, ga, np, turn);
      for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
      double* local = w->D;
      rotate_back(R, gp, np, local);
      field_transpose(b, b->points, local, np, gz);
      /* area vector A0 R (t1 x t2): d/dt1 = A0 t2 x R^T g, d/dt2 = A0 R^T g x t1 */
      double *t1 = w->body_points, *t2 = w->f, *gt = w->DJ;
      rotate_back(R, ga, np, local);
      field_apply(b, b->tangent1, 1, cfg->zeta, np, t1);
      field_apply(b, b->tangent2, 1, cfg->zeta, np, t2);
      for (int s = 0; s < np; s++) {
        double A0 = b->areas[s], g[3], x1[3], x2[3], o1[3], o2[3];
        for (int i = 0; i < 3; i++) g[i] = A0 * local[i * np + s], x1[i] = t1[i * np + s], x2[i] = t2[i * np + s];
        cross3(x2, g, o1), cross3(g, x1, o2);
        for (int i = 0; i < 3; i++) gt[i * np + s] = o1[i], t1[i * np + s] = o2[i];
      }
      field_transpose(b, b->tangent1, gt, np, gz);
      field_transpose(b, b->tangent2, t1, np, gz);
    }
    if (t == 0) forces_mixed(w, lambda, dz, out, gz, au);
    for (int c = 0; c < r; c++) out[6 + c] = inner(cfg->dz + c * kp, gz, kp);
  }
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c];
    a1[6 + c] -= K * w->par[DP_DAMPING] / h * lambda[6 + c];
    au[c] = -K * w->par[DP_CONTROL] * lambda[6 + c];
  }
}

/* A solved step, ready for its derivatives: the Hessian at x_next and its factors. With contact it is
 * not symmetric. */
typedef struct {
  double factors[MAX_N * MAX_N];
  int n, symmetric, pivot[MAX_N];
} Linear;

static int linearise(Work* w, const double* x, const double* x_next, Linear* l) {
  const int r = w->body->r, n = 6 + r;
  work_unpack(w, x);
  work_prepare(w, 1);
  memcpy(w->now.c, x_next, sizeof w->now.c), memcpy(w->now.quat, x_next + 3, sizeof w->now.quat);
  quat_normalize(w->now.quat);
  quat_matrix(w->now.quat, w->now.R);
  memcpy(w->q_now, x_next + 7, sizeof(double) * r);
  w->now.q = w->q_now;
  work_assemble(w);
  l->n = n, l->symmetric = !terrain_parts(&w->terrain);
  if (l->symmetric) return cholesky(w->H, n, l->factors);
  int sign;
  memcpy(l->factors, w->H, sizeof(double) * n * n);
  return lu(l->factors, n, l->pivot, &sign);
}

/* H^T x = rhs */
static void solve_transposed(const Linear* l, const double* rhs, double* x) {
  if (l->symmetric) cholesky_solve(l->factors, l->n, rhs, x);
  else lu_solve_transposed(l->factors, l->pivot, l->n, rhs, x);
}

/* Gradient g_next over x_next -> gradient over the new configuration (out, 6 + r) and what goes
 * straight to the last one (direct, 6 + r), both in tangent coordinates. */
static void pull_output(const Work* w, const double* x_next, const double* g_next, double* out, double* direct) {
  const int r = w->body->r;
  const double ih = 1 / w->par[DP_TIMESTEP], *gq = g_next + 3, *gv = g_next + 7 + r, *qn = w->now.quat;
  double J[9], turn[3], t[3], omega[3], cr[3];
  for (int i = 0; i < 3; i++) {
    out[i] = g_next[i] + gv[i] * ih, direct[i] = -gv[i] * ih;
    omega[i] = x_next[7 + r + 3 + i] / ih;
  }
  cross3(qn + 1, gq + 1, cr);
  so3_left_jacobian(omega, 1, J);
  mul_mtv(J, gv + 3, t);
  mul_mv(w->one.R, t, turn);
  for (int i = 0; i < 3; i++) {
    double g_turn = ih * turn[i];
    out[3 + i] = .5 * (-gq[0] * qn[1 + i] + qn[0] * gq[1 + i] + cr[i]) + g_turn, direct[3 + i] = -g_turn;
  }
  for (int c = 0; c < r; c++)
    out[6 + c] = g_next[7 + c] + gv[6 + c] * ih, direct[6 + c] = -gv[6 + c] * ih;
}

/* Gradients over the last two configurations (tangent) -> gradient over the state x. */
static void pull_input(const Work* w, const double* x, const double* g1, const double* g2, double* gx) {
  const int r = w->body->r;
  const double h = w->par[DP_TIMESTEP], *omega = x + 7 + r + 3;
  double* gv = gx + 7 + r;
  double back[3] = {-h * omega[0], -h * omega[1], -h * omega[2]}, J[9], local[3], g[3], t[3];
  for (int i = 0; i < 3; i++) gx[i] = g1[i] + g2[i], gv[i] = -h * g2[i], g[i] = g1[3 + i] + g2[3 + i];
  so3_left_jacobian(back, 0, J);
  mul_mtv(w->one.R, g2 + 3, local);
  mul_mtv(J, local, t);
  for (int i = 0; i < 3; i++) gv[3 + i] = -h * t[i];
  const double* q = x + 3; /* as given, not normalised */
  double norm2 = q[0] * q[0] + dot3(q + 1, q + 1), cr[3];
  cross3(q + 1, g, cr);
  gx[3] = -2 * dot3(g, q + 1) / norm2;
  for (int i = 0; i < 3; i++) gx[4 + i] = 2 * (q[0] * g[i] - cr[i]) / norm2;
  for (int c = 0; c < r; c++) gx[7 + c] = g1[6 + c] + g2[6 + c], gv[6 + c] = -h * g2[6 + c];
}

static int adjoint(const Parts* p, const double* x, const double* u, const double* x_next, const double* g_next,
                   double* gx, double* gu) {
  const int n = 6 + p->body.r;
  Linear linear;
  double out[MAX_N], direct[MAX_N], lambda[MAX_N], a1[MAX_N], a2[MAX_N];
  WORK(w, p, u);
  if (!linearise(&w, x, x_next, &linear)) {
    memset(gx, 0, sizeof(double) * (13 + 2 * p->body.r)), memset(gu, 0, sizeof(double) * p->nu);
    return 1;
  }
  pull_output(&w, x_next, g_next, out, direct);
  solve_transposed(&linear, out, lambda);
  mixed(&w, lambda, a1, a2, gu);
  for (int i = 0; i < n; i++) a1[i] = direct[i] - a1[i], a2[i] = -a2[i];
  for (int c = 0; c < p->nu; c++) gu[c] = -gu[c];
  pull_input(&w, x, a1, a2, gx);
  return 0;
}

int dp_step_adj(const dp_model* m, const double* x, const double* u, const double* x_next, const double* g_next,
                double* gx, double* gu) {
  Parts p;
  if (parts_view(&p, m)) return 1;
  return adjoint(&p, x, u, x_next, g_next, gx, gu);
}

int dp_step_jac(const dp_model* m, const double* x, const double* u, const double* x_next, double* A, double* B) {
  Parts p;
  if (parts_view(&p, m)) return 1;
  const int r = p.body.r, n = 6 + r, nx = 13 + 2 * r, nu = p.nu;
  Linear linear;
  double M1[MAX_N * MAX_N], M2[MAX_N * MAX_N], Mu[MAX_N * DP_MAX_INPUT];
  WORK(w, &p, u);
  if (!linearise(&w, x, x_next, &linear)) return 1;
  for (int i = 0; i < n; i++) { /* rows: lambda = e_i */
    double unit[MAX_N] = {0};
    unit[i] = 1;
    mixed(&w, unit, M1 + i * n, M2 + i * n, Mu + i * nu);
  }
  for (int o = 0; o < nx; o++) {
    double seed[13 + 2 * DP_MAX_MODES] = {0}, out[MAX_N], direct[MAX_N], lambda[MAX_N], g1[MAX_N], g2[MAX_N];
    seed[o] = 1;
    pull_output(&w, x_next, seed, out, direct);
    solve_transposed(&linear, out, lambda);
    for (int j = 0; j < n; j++) {
      g1[j] = direct[j], g2[j] = 0;
      for (int i = 0; i < n; i++) g1[j] -= lambda[i] * M1[i * n + j], g2[j] -= lambda[i] * M2[i * n + j];
    }
    for (int c = 0; c < nu; c++) {
      double s = 0;
      for (int i = 0; i < n; i++) s -= lambda[i] * Mu[i * nu + c];
      B[o * nu + c] = s;
    }
    pull_input(&w, x, g1, g2, A + (size_t)o * nx);
  }
  return 0;
}

int dp_rollout_adj(const dp_model* m, int N, const double* u, const double* xs, double* gxs, double* gu) {
  Parts p;
  if (parts_view(&p, m)) return N;
  const int nx = 13 + 2 * p.body.r;
  int failed = 0;
  double gx[13 + 2 * DP_MAX_MODES];
  for (int i = N - 1; i >= 0; i--) {
    failed += adjoint(&p, xs + (size_t)i * nx, u + (size_t)i * p.nu, xs + (size_t)(i + 1) * nx,
                      gxs + (size_t)(i + 1) * nx, gx, gu + (size_t)i * p.nu);
    for (int j = 0; j < nx; j++) gxs[(size_t)i * nx + j] += gx[j];
  }
  return failed;
}
