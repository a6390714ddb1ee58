/* States and nodes, and gradients from one to the other. */
#include "state.h"

void state_nodes(int r, const double* x, double h, Pose* last, Pose* before) {
  const double *v = x + 7 + r, *omega = v + 3, *qdot = v + 6;
  double turn[3], back[4];
  memcpy(last->quat, x + 3, sizeof last->quat);
  quat_normalize(last->quat);
  for (int i = 0; i < 3; i++) last->c[i] = 0, before->c[i] = -h * v[i], turn[i] = -h * omega[i];
  quat_exp(turn, back);
  quat_mul(last->quat, back, before->quat);
  memset(last->q, 0, sizeof last->q), memset(before->q, 0, sizeof before->q);
  for (int c = 0; c < r; c++) last->q[c] = x[7 + c], before->q[c] = x[7 + c] - h * qdot[c];
}

void state_pack(int r, const double* origin, const Pose* last, const Pose* before, const double* u,
                double h, double* x) {
  const double ih = 1 / h, *from = before->quat, back[4] = {from[0], -from[1], -from[2], -from[3]};
  double turn[4], omega[3], *v = x + 7 + r;
  quat_mul(back, last->quat, turn);
  quat_log(turn, omega);
  for (int i = 0; i < 3; i++) {
    x[i] = origin[i] + last->c[i];
    v[i] = (last->c[i] - before->c[i]) * ih, v[3 + i] = omega[i] * ih;
  }
  memcpy(x + 3, last->quat, sizeof last->quat);
  for (int c = 0; c < r; c++) x[7 + c] = last->q[c], v[6 + c] = (last->q[c] - before->q[c]) * ih;
  memcpy(x + 13 + 2 * r, u, sizeof(double) * r);
}

void state_pack_pull(int r, const Pose* last, const Pose* before, double h, const double* g_next,
                        double* g_last, double* g_before, double* gu) {
  const double ih = 1 / h, *gq = g_next + 3, *gv = g_next + 7 + r, *qn = last->quat;
  const double back[4] = {before->quat[0], -before->quat[1], -before->quat[2], -before->quat[3]};
  double J[9], R[9], turn[3], t[3], omega[3], cr[3], quat[4];
  quat_mul(back, last->quat, quat);
  quat_log(quat, omega);
  quat_matrix(before->quat, R);
  cross3(qn + 1, gq + 1, cr);
  so3_left_jacobian(omega, 1, J);
  mul_mtv(J, gv + 3, t);
  mul_mv(R, t, turn);
  for (int i = 0; i < 3; i++) {
    g_last[i] = g_next[i] + gv[i] * ih, g_before[i] = -gv[i] * ih;
    const double g_turn = ih * turn[i];
    g_last[3 + i] = .5 * (-gq[0] * qn[1 + i] + qn[0] * gq[1 + i] + cr[i]) + g_turn;
    g_before[3 + i] = -g_turn;
  }
  for (int c = 0; c < r; c++) {
    g_last[6 + c] = g_next[7 + c] + gv[6 + c] * ih, g_before[6 + c] = -gv[6 + c] * ih;
    gu[c] = g_next[13 + 2 * r + c];
  }
}

void quaternion_pull(const double* quat, const double* g, double* out) {
  const double norm2 = quat[0] * quat[0] + dot3(quat + 1, quat + 1);
  double cr[3];
  cross3(quat + 1, g, cr);
  out[0] = -2 * dot3(g, quat + 1) / norm2;
  for (int i = 0; i < 3; i++) out[1 + i] = 2 * (quat[0] * g[i] - cr[i]) / norm2;
}

void state_nodes_pull(int r, const double* x, const Pose* last, double h, const double* g_last,
                      const double* g_before, double* gx) {
  const double* omega = x + 7 + r + 3;
  double *gv = gx + 7 + r, J[9], R[9], local[3], turn[3], t[3];
  const double back[3] = {-h * omega[0], -h * omega[1], -h * omega[2]};
  for (int i = 0; i < 3; i++) {
    gx[i] = g_last[i] + g_before[i], gv[i] = -h * g_before[i];
    turn[i] = g_last[3 + i] + g_before[3 + i];
  }
  so3_left_jacobian(back, 0, J);
  quat_matrix(last->quat, R);
  mul_mtv(R, g_before + 3, local);
  mul_mtv(J, local, t);
  for (int i = 0; i < 3; i++) gv[3 + i] = -h * t[i];
  quaternion_pull(x + 3, turn, gx + 3);
  for (int c = 0; c < r; c++)
    gx[7 + c] = g_last[6 + c] + g_before[6 + c], gv[6 + c] = -h * g_before[6 + c];
}
