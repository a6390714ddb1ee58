/* The memory of a path, its configurations and what follows from each, the drag between two. */
#include "path.h"

size_t path_lay(Path* p, const Parts* parts, double* memory) {
  const Body* b = &parts->body;
  const size_t r = b->r, kp = b->kp, np = b->np, nf = parts->feet.np, nc = contacts_of(parts);
  Arena arena = {memory, 0}, *a = &arena;
  p->body = b, p->par = parts->model->par, p->feet = parts->feet, p->terrain = parts->terrain;
  p->n0 = p->nodes, p->n1 = p->nodes + 1, p->n2 = p->nodes + 2;
  p->n_near = p->mp = p->m = 0;
  for (int i = 0; i < 3; i++) {
    Node* n = p->nodes + i;
    n->zeta = take(a, (1 + r) * kp), n->dz = memory ? n->zeta + kp : NULL;
    n->P = take(a, (1 + r) * 9 * kp), n->Q = memory ? n->P + 9 * kp : NULL;
    n->y = take(a, (1 + r) * 3 * np), n->Jq = memory ? n->y + 3 * np : NULL;
    n->scratch = take(a, kinematics_scratch(b));
    n->tangents.tangent1 = take(a, 3 * np), n->tangents.tangent2 = take(a, 3 * np);
    n->area = take(a, 3 * np), n->touch = take(a, 3 * nc);
    n->touch_known = n->moments_known = 0;
  }
  p->local = take(a, (1 + r) * 3 * np), p->area_local = take(a, 3 * np);
  p->turned = take(a, 3 * np), p->columns = take(a, (6 + r) * 3 * np);
  p->mean01 = take(a, 3 * np), p->area12 = take(a, 3 * np), p->mean_f = take(a, 3 * np);
  p->f01 = take(a, 3 * np), p->f12 = take(a, 3 * np);
  p->D01 = take(a, 6 * np), p->D12 = take(a, 6 * np);
  p->feet_y = take(a, 3 * nf), p->feet_Jq = take(a, r * 3 * nf);
  p->near_field = take(a, kp * 3 * nc), p->near_Jq = take(a, r * 3 * nc);
  p->near_y1 = take(a, 3 * nc), p->near_y2 = take(a, 3 * nc), p->near_f = take(a, 3 * nc);
  p->touch_D = take(a, 9 * nc), p->touch_F = take(a, 9 * nc);
  p->along_P = take(a, 9 * kp), p->along_T = take(a, 9 * kp);
  double** pulls[] = {&p->along_local, &p->bend, &p->w,   &p->gw,  &p->gw_local,
                      &p->gp01,        &p->ga01, &p->gp12, &p->ga12,
                      &p->gp0,         &p->ga0,  &p->gp1, &p->ga1};
  for (size_t i = 0; i < sizeof pulls / sizeof *pulls; i++) *pulls[i] = take(a, 3 * np);
  p->pull_local = take(a, 9 * np);
  p->curvature = take(a, r * b->rp);
  return arena.used;
}

void node_set(const Path* p, Node* n, const Pose* pose, int what) {
  const Body* b = p->body;
  const int np = b->np, all = what < 0 ? 0 : what, tangent = all & TANGENT, areas = all & AREAS;
  if (&n->at != pose) {
    if (memcmp(&n->at, pose, sizeof n->at)) n->touch_known = 0;
    n->at = *pose;
  }
  n->moments_known = 0;
  quat_matrix(n->at.quat, n->R);
  if (what == PLACE) return;
  const int fields = all & DRAG_TANGENT ? 1 + b->r : 1;
  *p->spent += (double)b->kp * b->nf * (tangent ? 1 + b->r : 1);
  kinematics(b, n->at.q, tangent, n->zeta, n->scratch);
  if (what == SHAPE || !has_drag(b, p->par)) return;
  *p->spent += b->kp * 3. * np * (fields + (areas ? 2 : 0));
  field_apply(b, b->points, fields, n->zeta, np, p->local);
  for (int c = 0; c < fields; c++) rotate(n->R, p->local + c * 3 * np, np, n->y + c * 3 * np);
  if (areas) drag_areas(b, n->R, n->zeta, n->tangents, p->area_local, n->area);
}

void node_moments(const Path* p, Node* n) {
  if (!n->moments_known) moments_apply(p->body, 1, n->zeta, n->P);
  n->moments_known = 1;
}

void interval_drag(const Path* p, const Node* from, const Node* to, const double* area, double* f,
                   double* D) {
  double dc[3];
  for (int i = 0; i < 3; i++) dc[i] = to->at.c[i] - from->at.c[i];
  drag_forces(p->body, p->par, p->h, dc, from->y, to->y, area, f, D);
}
