/* Measures of a state: energies, momenta, surface. */
#include "work.h"

void dp_energy(const dp_model* m, const double* x, double out[9]) {
  Parts p;
  memset(out, 0, 9 * sizeof(double));
  if (parts_view(&p, m)) return;
  const Body b = p.body;
  const double* par = m->par;
  WORK(w, &p, x);
  work_unpack(&w, x);
  const int kp = b.kp;
  const double h = par[DP_TIMESTEP], ih = 1 / h, *v = x + 7 + b.r;
  kinematics(&b, w.one.q, 0, w.one.zeta, w.scratch);
  kinematics(&b, w.two.q, 0, w.two.zeta, w.scratch);
  /* N = sum_v m_v (R_1 y_1) (R_2 y_2)^T */
  double N[9], Q[9], RQ[9];
  moments_apply(&b, w.two.zeta, w.P); /* P_a,ij = sum_v m Phi_a,i y_2,j */
  for (int i = 0; i < 9; i++) Q[i] = inner(w.P + i * kp, w.one.zeta, kp);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      RQ[3 * i + j] = w.one.R[3 * i] * Q[j] + w.one.R[3 * i + 1] * Q[3 + j] + w.one.R[3 * i + 2] * Q[6 + j];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(RQ + 3 * i, w.two.R + 3 * j);
  double spread = -2 * (N[0] + N[4] + N[8]);
  for (int t = 0; t < 2; t++) {
    const double* z = t ? w.two.zeta : w.one.zeta;
    for (int a = 0; a < kp; a++) spread += (2 * b.trace[a] + z[a]) * z[a];
  }
  out[0] = .5 * b.mass * dot3(v, v) + .5 * ih * ih * spread;
  for (int c = 0; c < b.r; c++) out[1] += .5 * b.stiffness[c] * x[7 + c] * x[7 + c];
  out[2] = -b.mass * par[DP_GRAVITY] * x[2] + b.mass * STANDARD_GRAVITY * par[DP_RIGHTING] * (1 - w.one.R[8]);
  double spin[3], orbit[3], momentum[3];
  for (int i = 0; i < 3; i++) out[3 + i] = momentum[i] = b.mass * v[i];
  cross3(x, momentum, orbit);
  spin[0] = N[7] - N[5], spin[1] = N[2] - N[6], spin[2] = N[3] - N[1]; /* -(y1 x y2) summed */
  for (int i = 0; i < 3; i++) out[6 + i] = orbit[i] + spin[i] * ih;
}

void dp_surface(const double* blob, const double* qpos, double* points) {
  const dp_model model = {blob, NULL, NULL, NULL};
  Parts p;
  if (parts_view(&p, &model)) return;
  const Body b = p.body;
  WORK(w, &p, NULL);
  double quat[4], R[9];
  memcpy(quat, qpos + 3, sizeof quat);
  quat_normalize(quat), quat_matrix(quat, R);
  kinematics(&b, qpos + 7, 0, w.one.zeta, w.scratch);
  const int n = b.ns;
  for (int from = 0; from < n; from += 64) { /* blocks bound the memory on the stack */
    const int count = n - from < 64 ? n - from : 64;
    double y[3 * 64] = {0};
    for (int a = 0; a <= b.k; a++)
      for (int i = 0; i < 3; i++) {
        const double z = w.one.zeta[a], *restrict row = b.surface + ((size_t)3 * a + i) * n + from;
        for (int s = 0; s < count; s++) y[i * 64 + s] += z * row[s];
      }
    for (int s = 0; s < count && from + s < b.n_surface; s++)
      for (int i = 0; i < 3; i++)
        points[3 * (from + s) + i] =
            qpos[i] + R[3 * i] * y[s] + R[3 * i + 1] * y[64 + s] + R[3 * i + 2] * y[128 + s];
  }
}

int dp_contacts(const dp_model* m, const double* x, double* points, double* forces, double* gaps) {
  Parts p;
  if (parts_view(&p, m)) return 0;
  const int n = p.body.n_contacts, nc = p.body.nc, r = p.body.r;
  double u[DP_MAX_INPUT] = {0};
  WORK(w, &p, u);
  if (!terrain_parts(&p.terrain)) return 0;
  /* the last step led from `two` to x: friction knows the velocity by it */
  work_unpack(&w, x);
  kinematics(&p.body, w.two.q, 0, w.two.zeta, w.scratch);
  contact_positions(&w, &w.two, w.touch_before);
  w.now = w.one, w.now.zeta = w.one.zeta, w.now.dz = w.one.dz;
  memcpy(w.q_now, x + 7, sizeof(double) * r), w.now.q = w.q_now;
  kinematics(&p.body, w.now.q, 1, w.now.zeta, w.scratch);
  memset(w.g, 0, sizeof w.g), memset(w.H, 0, sizeof w.H), memset(w.gzeta, 0, sizeof(double) * p.body.kp);
  double N[9] = {0};
  forces_evaluate(&w, N);
  memset(forces, 0, sizeof(double) * 3 * n);
  for (int s = 0; s < n; s++) {
    double normal[3];
    for (int i = 0; i < 3; i++) points[3 * s + i] = w.touch_now[i * nc + s];
    gaps[s] = dp_terrain_gap(m->terrain, points + 3 * s, normal);
  }
  for (int k = 0; k < w.m; k++)
    for (int i = 0; i < 3; i++) forces[3 * w.which[k] + i] = w.touch_force[i * w.mp + k];
  return w.m;
}

void dp_feet(const dp_model* m, const double* qpos, double* points, double* jacobian) {
  Parts p;
  if (parts_view(&p, m)) return;
  const int n = p.feet.n, np = p.feet.np, r = p.body.r, nq = 7 + r;
  WORK(w, &p, NULL);
  double norm = 0, quat[4], R[9], local[(1 + DP_MAX_MODES) * 3 * DP_MAX_FEET], world[(1 + DP_MAX_MODES) * 3 * DP_MAX_FEET];
  for (int i = 0; i < 4; i++) norm += qpos[3 + i] * qpos[3 + i];
  memcpy(quat, qpos + 3, sizeof quat);
  quat_normalize(quat), quat_matrix(quat, R);
  kinematics(&p.body, qpos + 7, 1, w.one.zeta, w.scratch);
  field_apply(&p.body, p.feet.field, 1 + r, w.one.zeta, np, local);
  for (int c = 0; c <= r; c++) rotate(R, local + c * 3 * np, np, world + c * 3 * np);
  for (int s = 0; s < n; s++) {
    const double y[3] = {world[s], world[np + s], world[2 * np + s]};
    for (int i = 0; i < 3; i++) {
      points[3 * s + i] = qpos[i] + y[i];
      if (!jacobian) continue;
      double* row = jacobian + (size_t)(3 * s + i) * nq;
      for (int j = 0; j < 3; j++) row[j] = i == j;
      for (int c = 0; c < r; c++) row[7 + c] = world[((1 + c) * 3 + i) * np + s];
      /* a turn t moves the point by t x y; dt over the quaternion as in derivatives.c */
      double g[3] = {0}, cr[3];
      g[(i + 1) % 3] = y[(i + 2) % 3], g[(i + 2) % 3] = -y[(i + 1) % 3];
      cross3(qpos + 4, g, cr);
      row[3] = -2 * dot3(g, qpos + 4) / norm;
      for (int k = 0; k < 3; k++) row[4 + k] = 2 * (qpos[3] * g[k] - cr[k]) / norm;
    }
  }
}
