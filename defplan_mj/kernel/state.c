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

/* The state of nodes whose places are told from `origin`. */
void state_pack(int r, const double* origin, const Pose* last, const Pose* before, const double* u, double h,
                 double* x) {
  const double ih = 1 / h, back[4] = {before->quat[0], -before->quat[1], -before->quat[2], -before->quat[3]};
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

/* Gradients of a step's result by its nodes: g_next over x_next -> over the last node and the one before
 * (6 + r each, tangent), and over the target. */
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
    g_last[3 + i] = .5 * (-gq[0] * qn[1 + i] + qn[0] * gq[1 + i] + cr[i]) + g_turn, g_before[3 + i] = -g_turn;
  }
  for (int c = 0; c < r; c++) {
    g_last[6 + c] = g_next[7 + c] + gv[6 + c] * ih, g_before[6 + c] = -gv[6 + c] * ih;
    gu[c] = g_next[13 + 2 * r + c];
  }
}

/* Gradients over the last two nodes (tangent) -> gradient over the state x; its target's part is left. */
void state_nodes_pull(int r, const double* x, const Pose* last, double h, const double* g1, const double* g0,
                       double* gx) {
  const double* omega = x + 7 + r + 3;
  double* gv = gx + 7 + r;
  double back[3] = {-h * omega[0], -h * omega[1], -h * omega[2]}, J[9], R[9], local[3], g[3], t[3];
  for (int i = 0; i < 3; i++) gx[i] = g1[i] + g0[i], gv[i] = -h * g0[i], g[i] = g1[3 + i] + g0[3 + i];
  so3_left_jacobian(back, 0, J);
  quat_matrix(last->quat, R);
  mul_mtv(R, g0 + 3, local);
  mul_mtv(J, local, t);
  for (int i = 0; i < 3; i++) gv[3 + i] = -h * t[i];
  const double* q = x + 3; /* as given, not normalised */
  double norm2 = q[0] * q[0] + dot3(q + 1, q + 1), cr[3];
  cross3(q + 1, g, cr);
  gx[3] = -2 * dot3(g, q + 1) / norm2;
  for (int i = 0; i < 3; i++) gx[4 + i] = 2 * (q[0] * g[i] - cr[i]) / norm2;
  for (int c = 0; c < r; c++) {
    gx[7 + c] = g1[6 + c] + g0[6 + c], gv[6 + c] = -h * g0[6 + c];
  }
}
