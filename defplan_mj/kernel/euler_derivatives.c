/* Exact derivatives of the implicit Euler step's equations. */
#include "work.h"

/* Both configurations in world tangent coordinates; after assemble at the solution. */
void euler_pull(Work* w, const double* lambda, double* a1, double* a2, double* au) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double h = w->h, ih2 = 1 / (h * h);
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
    moments_apply(b, 1, t ? dz : w->now.zeta, w->P);
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

void euler_linearise(Work* w, const Pose* next) {
  work_prepare(w, 1);
  memcpy(w->now.c, next->c, sizeof w->now.c), memcpy(w->now.quat, next->quat, sizeof w->now.quat);
  quat_matrix(w->now.quat, w->now.R);
  memcpy(w->q_now, next->q, sizeof w->q_now);
  w->now.q = w->q_now;
  work_assemble(w);
}
