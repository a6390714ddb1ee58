/* One implicit step of the reduced body as the minimum of an incremental energy E(c, R, q),
 *
 *   E = M |c - c^|^2 / 2h^2 + zeta^T tr(S) zeta / 2h^2 - <R, sum_a zeta_a W_a>          (inertia)
 *     + q^T K q / 2 + k_c (q - u)^T K (q - u) / 2 + b (q - q_i)^T K (q - q_i) / 2h      (elastic)
 *     + h sum_s [rho C_d |v.a|^3 / 6 |a|^2 + rho C_f |a| (|v|^2 + e)^{3/2} / 6],        (drag)
 *
 * with W_a = (2 R_i P_a(zeta_i)^T - R_{i-1} P_a(zeta_{i-1})^T) / h^2 and the area vectors a lagged,
 * so that the step stays a minimisation. The rotation is updated by R <- exp([t]) R from wherever
 * the iterate stands, so no attitude is special. The previous configuration is recomputed from the
 * velocities: a saved state replays to the bit. Derivatives by the implicit function theorem. */
#include "work.h"

void work_begin(Work* w, const double* origin, const Pose* before, const Pose* last, const double* u, double h) {
  Config *one = &w->one, *two = &w->two;
  w->u = u, w->h = h, w->origin = origin, w->m = -1, w->reference = NULL;
  memcpy(one->c, last->c, sizeof one->c), memcpy(one->quat, last->quat, sizeof one->quat);
  memcpy(two->c, before->c, sizeof two->c), memcpy(two->quat, before->quat, sizeof two->quat);
  memcpy(w->q_one, last->q, sizeof w->q_one), memcpy(w->q_two, before->q, sizeof w->q_two);
  one->q = w->q_one, two->q = w->q_two;
  quat_matrix(one->quat, one->R), quat_matrix(two->quat, two->R);
}

/* Everything of a step that depends on the last two configurations only. With `derivatives`,
 * dz of both as well. */
void work_prepare(Work* w, int derivatives) {
  const Body* b = w->body;
  const int kp = b->kp, np = b->np;
  const double h = w->h, ih2 = 1 / (h * h);
  for (int i = 0; i < 9 * kp; i++) w->W[i] = 0;
  for (int t = 0; t < 2; t++) {
    Config* cfg = t ? &w->two : &w->one;
    const double factor = (t ? -1 : 2) * ih2;
    kinematics(b, cfg->q, derivatives, cfg->zeta, w->scratch_lagged);
    moments_apply(b, 1, cfg->zeta, w->P);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        double* restrict Wij = w->W + (3 * i + j) * kp;
        for (int m = 0; m < 3; m++) {
          const double f = factor * cfg->R[3 * i + m], *restrict P = w->P + (3 * j + m) * kp;
          for (int a = 0; a < kp; a++) Wij[a] += f * P[a];
        }
      }
  }
  for (int i = 0; i < 3; i++) w->guess[i] = 2 * w->one.c[i] - w->two.c[i];
  w->guess[2] += h * h * w->par[DP_GRAVITY];
  w->W[8 * kp] += b->mass * STANDARD_GRAVITY * w->par[DP_RIGHTING]; /* potential -M g D R_zz */
  if (terrain_parts(&w->terrain)) contact_prepare(w);
  if (!np || w->par[DP_FLUID_DENSITY] == 0) return;

  /* patch centres and area vectors of the last configuration */
  double *t1 = w->Jq, *t2 = w->DJ; /* not yet in use */
  field_apply(b, b->points, 1, w->one.zeta, np, w->body_points);
  rotate(w->one.R, w->body_points, np, w->before);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < np; s++) w->before[i * np + s] += w->one.c[i];
  field_apply(b, b->tangent1, 1, w->one.zeta, np, t1);
  field_apply(b, b->tangent2, 1, w->one.zeta, np, t2);
  double *restrict n = w->f, *restrict area = w->area;
  for (int s = 0; s < np; s++) {
    n[s] = b->areas[s] * (t1[np + s] * t2[2 * np + s] - t1[2 * np + s] * t2[np + s]);
    n[np + s] = b->areas[s] * (t1[2 * np + s] * t2[s] - t1[s] * t2[2 * np + s]);
    n[2 * np + s] = b->areas[s] * (t1[s] * t2[np + s] - t1[np + s] * t2[s]);
  }
  rotate(w->one.R, n, np, area);
  const double rho = w->par[DP_FLUID_DENSITY];
  for (int s = 0; s < np; s++) {
    /* padding has no area, and must have no drag */
    double A2 = area[s] * area[s] + area[np + s] * area[np + s] + area[2 * np + s] * area[2 * np + s];
    w->cn[s] = .5 * rho * w->par[DP_DRAG_NORMAL] / (A2 + 1e-20);
    w->ct[s] = .5 * rho * w->par[DP_DRAG_TANGENT] * sqrt(A2);
  }
}

/* Drag forces f on the patches at the iterate; D = -df/dp (xx xy xz yy yz zz); returns the energy. */
static double drag(Work* w) {
  const int n = w->body->np;
  const double h = w->h, ih = 1 / h, *c = w->now.c;
  const double *restrict p = w->w, *restrict p0 = w->before, *restrict a = w->area;
  const double *restrict cn = w->cn, *restrict ct = w->ct;
  double *restrict f = w->f, *restrict D = w->D, e = 0;
  for (int s = 0; s < n; s++) {
    double vx = (c[0] + p[s] - p0[s]) * ih, vy = (c[1] + p[n + s] - p0[n + s]) * ih;
    double vz = (c[2] + p[2 * n + s] - p0[2 * n + s]) * ih;
    double ax = a[s], ay = a[n + s], az = a[2 * n + s];
    double vn = vx * ax + vy * ay + vz * az, av = fabs(vn), v2 = vx * vx + vy * vy + vz * vz + SPEED2;
    double speed = sqrt(v2), fn = cn[s] * av * vn, ft = ct[s] * speed;
    f[s] = -fn * ax - ft * vx, f[n + s] = -fn * ay - ft * vy, f[2 * n + s] = -fn * az - ft * vz;
    double dn = 2 * cn[s] * av * ih, dt = ct[s] / speed * ih, d0 = ft * ih;
    D[s] = dn * ax * ax + dt * vx * vx + d0, D[n + s] = dn * ax * ay + dt * vx * vy;
    D[2 * n + s] = dn * ax * az + dt * vx * vz, D[3 * n + s] = dn * ay * ay + dt * vy * vy + d0;
    D[4 * n + s] = dn * ay * az + dt * vy * vz, D[5 * n + s] = dn * az * az + dt * vz * vz + d0;
    e += cn[s] * av * vn * vn + ct[s] * v2 * speed;
  }
  return h * e / 3;
}

/* out (3 x n) = D v for the symmetric D of drag */
static void apply_drag_matrix(const double* restrict D, const double* restrict v, int n, double* restrict out) {
  for (int s = 0; s < n; s++) {
    double x = v[s], y = v[n + s], z = v[2 * n + s];
    out[s] = D[s] * x + D[n + s] * y + D[2 * n + s] * z;
    out[n + s] = D[n + s] * x + D[3 * n + s] * y + D[4 * n + s] * z;
    out[2 * n + s] = D[2 * n + s] * x + D[4 * n + s] * y + D[5 * n + s] * z;
  }
}

/* Energy, gradient and Hessian at the iterate w->now, in (c, t, q) with R = exp([t]) R_now. */
void work_assemble(Work* w) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, rp = b->rp, np = b->np, n = 6 + r;
  const double h = w->h, ih2 = 1 / (h * h), *R = w->now.R;
  double *g = w->g, *H = w->H, *zeta = w->now.zeta, *dz = w->now.dz, e = 0;
  *w->spent += kp * ((1 + r) * (b->nf + 3. * np) + 9 * kp + 3 * b->nc * (1 + r));
  kinematics(b, w->now.q, 1, zeta, w->scratch);
  memset(H, 0, sizeof(double) * n * n);

  /* inertia; trace: 0, 1 x 1 block (1, z): S_00, S_0a, identity */
  for (int i = 0; i < 3; i++) {
    double d = w->now.c[i] - w->guess[i];
    e += .5 * ih2 * b->mass * d * d, g[i] = ih2 * b->mass * d, H[i * n + i] = ih2 * b->mass;
  }
  double* gz = w->gzeta; /* dE/dzeta, first the inertia's part */
  double Rw[3][9];
  for (int m = 0; m < 3; m++) {
    double axis[3] = {m == 0, m == 1, m == 2};
    skew_mul(axis, R, Rw[m]);
  }
  double* restrict turn[3] = {w->Wg, w->Wg + kp, w->Wg + 2 * kp}; /* d2 E / dt dzeta, inertia */
  for (int a = 0; a < kp; a++) {
    double s = 0, t0 = 0, t1 = 0, t2 = 0;
    for (int i = 0; i < 9; i++) {
      double W = w->W[i * kp + a];
      s += R[i] * W, t0 += Rw[0][i] * W, t1 += Rw[1][i] * W, t2 += Rw[2][i] * W;
    }
    gz[a] = ih2 * (b->trace[a] + zeta[a]) - s, turn[0][a] = -t0, turn[1][a] = -t1, turn[2][a] = -t2;
    e += .5 * ih2 * (2 * b->trace[a] + zeta[a]) * zeta[a] - s * zeta[a];
  }
  double N[9]; /* sum_a zeta_a W_a R^T, then the point forces' part */
  double Wz[9];
  for (int i = 0; i < 9; i++) Wz[i] = inner(w->W + i * kp, zeta, kp);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(Wz + 3 * i, R + 3 * j);
  vee(N, g + 3);
  for (int i = 0; i < 3; i++) g[3 + i] = -g[3 + i];

  /* modal: elasticity, control, damping, inertia through dz */
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c], q = w->now.q[c], du = q - w->u[c], dq = q - w->one.q[c];
    const double kc = w->par[DP_CONTROL], beta = w->par[DP_DAMPING] / h;
    e += .5 * K * (q * q + kc * du * du + beta * dq * dq);
    g[6 + c] = K * (q + kc * du + beta * dq) + inner(dz + c * kp, gz, kp);
    H[(6 + c) * n + 6 + c] = K * (1 + kc + beta);
    for (int d = c; d < r; d++) H[(6 + c) * n + 6 + d] += ih2 * inner(dz + c * kp, dz + d * kp, kp);
    for (int m = 0; m < 3; m++) H[(3 + m) * n + 6 + c] = inner(turn[m], dz + c * kp, kp);
  }

  if (np && w->par[DP_FLUID_DENSITY] != 0) {
    field_apply(b, b->points, 1 + r, zeta, np, w->body_points); /* points, then their modal derivatives */
    rotate(R, w->body_points, np, w->w);
    e += drag(w);
    const double *restrict D = w->D, *restrict p = w->w, *restrict f = w->f;
    double *back = w->DJ, torque[3]; /* R^T f, before DJ is in use */
    for (int i = 0; i < 3; i++) g[i] -= sum(f + i * np, np);
    sum_cross(p, f, np, torque);
    for (int i = 0; i < 3; i++) g[3 + i] -= torque[i];
    rotate_back(R, f, np, back);
    for (int s = 0; s < 3 * np; s++) back[s] = -back[s];
    field_transpose(b, b->points, back, np, gz);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) N[3 * i + j] += inner(f + i * np, p + j * np, np);
    /* columns: translation, rotation t x p, modes R B dz; H += J^T D J */
    static const int at[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
    for (int i = 0; i < 3; i++)
      for (int j = i; j < 3; j++) H[i * n + j] += sum(D + at[i][j] * np, np);
    double* restrict DJ = w->DJ;
    for (int m = 0; m < 3; m++) { /* column m of the rotation: e_m x p */
      double* restrict col = w->body_points; /* not needed any more */
      const int m1 = (m + 1) % 3, m2 = (m + 2) % 3;
      for (int s = 0; s < np; s++)
        col[m * np + s] = 0, col[m1 * np + s] = -p[m2 * np + s], col[m2 * np + s] = p[m1 * np + s];
      apply_drag_matrix(D, col, np, DJ);
      double torque_row[3];
      sum_cross(p, DJ, np, torque_row);
      for (int i = 0; i < 3; i++) H[i * n + 3 + m] += sum(DJ + i * np, np);
      for (int i = 0; i <= m; i++) H[(3 + i) * n + 3 + m] += torque_row[i];
    }
    for (int c = 0; c < r; c++) {
      double *Jc = w->Jq + c * 3 * np, *DJc = w->DJ + c * 3 * np;
      rotate(R, w->body_points + (1 + c) * 3 * np, np, Jc);
      apply_drag_matrix(D, Jc, np, DJc);
      double torque_row[3], bend[3];
      sum_cross(p, DJc, np, torque_row), sum_cross(Jc, f, np, bend);
      g[6 + c] -= inner(Jc, f, 3 * np);
      for (int i = 0; i < 3; i++) {
        H[i * n + 6 + c] += sum(DJc + i * np, np);
        H[(3 + i) * n + 6 + c] += torque_row[i] - bend[i];
      }
      for (int d = 0; d <= c; d++) H[(6 + d) * n + 6 + c] += inner(w->Jq + d * 3 * np, DJc, 3 * np);
    }
  }

  const int forces = w->feet.n || terrain_parts(&w->terrain);
  if (forces) e += forces_evaluate(w, N);

  /* second derivatives of the rotation (exp at 0) and of zeta(q) */
  const double tr = N[0] + N[4] + N[8];
  for (int i = 0; i < 3; i++)
    for (int j = i; j < 3; j++)
      H[(3 + i) * n + 3 + j] -= .5 * (N[3 * i + j] + N[3 * j + i]) - (i == j ? tr : 0);
  double curvature[DP_MAX_MODES * DP_MAX_MODES] = {0};
  kinematics_curvature(b, gz, w->scratch, curvature);
  for (int c = 0; c < r; c++)
    for (int d = c; d < r; d++) H[(6 + c) * n + 6 + d] += curvature[c * rp + d];
  for (int i = 0; i < n; i++)
    for (int j = 0; j < i; j++) H[i * n + j] = H[j * n + i];
  if (forces) forces_hessian(w);
  w->energy = e;
}
