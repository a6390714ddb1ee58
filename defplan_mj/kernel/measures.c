/* Measures of a state: energies, momenta, surface. */
#include "work.h"

void dp_energy(const double* blob, const double* par, const double* x, double out[9]) {
  Body b;
  memset(out, 0, 9 * sizeof(double));
  if (body_view(&b, blob, (size_t)blob[2])) return;
  WORK(w, &b, par, x);
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
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return;
  WORK(w, &b, NULL, NULL);
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
