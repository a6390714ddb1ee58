/* One configuration of a path: what follows from it, and gradients back to it. */
#include "path.h"

static double* at(double* memory, size_t* used, size_t n) {
  double* here = memory ? memory + *used : NULL;
  *used += (n + PAD - 1) / PAD * PAD;
  return here;
}

size_t path_lay(Path* p, const Parts* parts, double* memory) {
  const Body* b = &parts->body;
  const size_t r = b->r, kp = b->kp, np = b->np, nf = parts->feet.np;
  const size_t nc = terrain_parts(&parts->terrain) ? b->nc : 0;
  size_t used = 0;
  p->body = b, p->par = parts->model->par, p->feet = parts->feet, p->terrain = parts->terrain;
  p->n0 = p->nodes, p->n1 = p->nodes + 1, p->n2 = p->nodes + 2;
  p->n_near = p->mp = p->m = 0;
  for (int i = 0; i < 3; i++) {
    Node* n = p->nodes + i;
    n->zeta = at(memory, &used, (1 + r) * kp), n->dz = memory ? n->zeta + kp : NULL;
    n->P = at(memory, &used, (1 + r) * 9 * kp), n->Q = memory ? n->P + 9 * kp : NULL;
    n->y = at(memory, &used, (1 + r) * 3 * np), n->Jq = memory ? n->y + 3 * np : NULL;
    n->scratch = at(memory, &used, kinematics_scratch(b));
    n->tangent1 = at(memory, &used, 3 * np), n->tangent2 = at(memory, &used, 3 * np);
    n->area = at(memory, &used, 3 * np), n->touch = at(memory, &used, 3 * nc);
    n->touch_known = n->moments_known = 0;
  }
  p->local = at(memory, &used, (1 + r) * 3 * np), p->columns = at(memory, &used, (6 + r) * 3 * np);
  p->mean01 = at(memory, &used, 3 * np), p->area12 = at(memory, &used, 3 * np);
  p->f01 = at(memory, &used, 3 * np), p->f12 = at(memory, &used, 3 * np);
  p->D01 = at(memory, &used, 6 * np), p->D12 = at(memory, &used, 6 * np);
  p->feet_y = at(memory, &used, 3 * nf), p->feet_Jq = at(memory, &used, r * 3 * nf);
  p->near_field = at(memory, &used, kp * 3 * nc), p->near_Jq = at(memory, &used, r * 3 * nc);
  p->near_y1 = at(memory, &used, 3 * nc), p->near_y2 = at(memory, &used, 3 * nc);
  p->near_f = at(memory, &used, 3 * nc);
  p->touch_D = at(memory, &used, 9 * nc), p->touch_F = at(memory, &used, 9 * nc);
  double** pulls[7] = {&p->pull_w, &p->pull_arm, &p->pull_01, &p->pull_a01, &p->pull_12, &p->pull_a12, &p->pull_f};
  for (int i = 0; i < 7; i++) *pulls[i] = at(memory, &used, 3 * np);
  p->along_moments = at(memory, &used, 9 * kp);
  p->curvature = at(memory, &used, r * b->rp);
  return used;
}

static void area_vectors(const Path* p, Node* n) {
  const Body* b = p->body;
  const int np = b->np;
  double *restrict t1 = n->tangent1, *restrict t2 = n->tangent2, *restrict a = p->local;
  field_apply(b, b->tangent1, 1, n->zeta, np, t1);
  field_apply(b, b->tangent2, 1, n->zeta, np, t2);
  for (int s = 0; s < np; s++) {
    a[s] = b->areas[s] * (t1[np + s] * t2[2 * np + s] - t1[2 * np + s] * t2[np + s]);
    a[np + s] = b->areas[s] * (t1[2 * np + s] * t2[s] - t1[s] * t2[2 * np + s]);
    a[2 * np + s] = b->areas[s] * (t1[s] * t2[np + s] - t1[np + s] * t2[s]);
  }
  rotate(n->R, a, np, n->area);
}

void node_set(const Path* p, Node* n, const Pose* pose, int what) {
  const Body* b = p->body;
  const int np = b->np, tangent = what & TANGENT, areas = what & AREAS;
  if (&n->at != pose) {
    if (memcmp(&n->at, pose, sizeof n->at)) n->touch_known = 0;
    n->at = *pose;
  }
  n->moments_known = 0;
  const int fields = what & DRAG_TANGENT ? 1 + b->r : 1;
  *p->spent += (double)b->kp * b->nf * (tangent ? 1 + b->r : 1);
  quat_matrix(n->at.quat, n->R);
  kinematics(b, n->at.q, tangent, n->zeta, n->scratch);
  if (!has_drag(p)) return;
  *p->spent += b->kp * 3. * np * (fields + (areas ? 2 : 0));
  field_apply(b, b->points, fields, n->zeta, np, p->local);
  for (int c = 0; c < fields; c++) rotate(n->R, p->local + c * 3 * np, np, n->y + c * 3 * np);
  if (areas) area_vectors(p, n);
}

void node_moments(const Path* p, Node* n) {
  if (!n->moments_known) moments_apply(p->body, 1, n->zeta, n->P);
  n->moments_known = 1;
}

void node_pull(const Path* p, const Node* n, double* gp, double* ga, double* out, double* gz) {
  const Body* b = p->body;
  const int np = b->np;
  double turn[3];
  for (int i = 0; i < 3; i++) out[i] += sum(gp + i * np, np);
  sum_cross(n->y, gp, np, turn);
  for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
  rotate_back(n->R, gp, np, p->local);
  field_transpose(b, b->points, p->local, np, gz);
  sum_cross(n->area, ga, np, turn);
  for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
  /* area vector A0 R (t1 x t2): d/dt1 = A0 t2 x R^T g, d/dt2 = A0 R^T g x t1 */
  rotate_back(n->R, ga, np, p->local);
  for (int s = 0; s < np; s++) {
    double g[3], t1[3], t2[3], g1[3], g2[3];
    for (int i = 0; i < 3; i++) {
      g[i] = b->areas[s] * p->local[i * np + s];
      t1[i] = n->tangent1[i * np + s], t2[i] = n->tangent2[i * np + s];
    }
    cross3(t2, g, g1), cross3(g, t1, g2);
    for (int i = 0; i < 3; i++) gp[i * np + s] = g1[i], ga[i * np + s] = g2[i];
  }
  field_transpose(b, b->tangent1, gp, np, gz);
  field_transpose(b, b->tangent2, ga, np, gz);
}

void to_world(const double* Ra, const double* N, const double* Rb, double* out) {
  double T[9];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      T[3 * i + j] = Ra[3 * i] * N[j] + Ra[3 * i + 1] * N[3 + j] + Ra[3 * i + 2] * N[6 + j];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) out[3 * i + j] = dot3(T + 3 * i, Rb + 3 * j);
}

static inline __attribute__((always_inline)) void drag_loop(const Path* p, const Node* from, const Node* to,
                                                           const double* restrict a, double* restrict f,
                                                           double* restrict D, const int derivative) {
  const int n = p->body->np;
  const double ih = 1 / p->h, rho = p->par[DP_FLUID_DENSITY];
  const double kn = .5 * rho * p->par[DP_DRAG_NORMAL], kt = .5 * rho * p->par[DP_DRAG_TANGENT];
  const double dx = to->at.c[0] - from->at.c[0], dy = to->at.c[1] - from->at.c[1];
  const double dz = to->at.c[2] - from->at.c[2];
  const double *restrict y1 = to->y, *restrict y0 = from->y;
  for (int s = 0; s < n; s++) {
    double vx = (dx + y1[s] - y0[s]) * ih, vy = (dy + y1[n + s] - y0[n + s]) * ih;
    double vz = (dz + y1[2 * n + s] - y0[2 * n + s]) * ih;
    double ax = a[s], ay = a[n + s], az = a[2 * n + s];
    /* padding has no area, and must have no drag */
    double A2 = ax * ax + ay * ay + az * az, cn = kn / (A2 + 1e-20), ct = kt * sqrt(A2);
    double vn = vx * ax + vy * ay + vz * az, av = fabs(vn), v2 = vx * vx + vy * vy + vz * vz + SPEED2;
    double speed = sqrt(v2), fn = cn * av * vn, ft = ct * speed;
    f[s] = -fn * ax - ft * vx, f[n + s] = -fn * ay - ft * vy, f[2 * n + s] = -fn * az - ft * vz;
    if (!derivative) continue;
    double dn = 2 * cn * av * ih, dt = ct / speed * ih, d0 = ft * ih;
    D[s] = dn * ax * ax + dt * vx * vx + d0, D[n + s] = dn * ax * ay + dt * vx * vy;
    D[2 * n + s] = dn * ax * az + dt * vx * vz, D[3 * n + s] = dn * ay * ay + dt * vy * vy + d0;
    D[4 * n + s] = dn * ay * az + dt * vy * vz, D[5 * n + s] = dn * az * az + dt * vz * vz + d0;
  }
}

void interval_drag(const Path* p, const Node* from, const Node* to, const double* area, double* f, double* D) {
  if (D) drag_loop(p, from, to, area, f, D, 1);
  else drag_loop(p, from, to, area, f, NULL, 0);
}
