/* Contact of the variational step. Most points are far from the terrain: only those that may touch
 * at node 2 by what nodes 0 and 1 say are looked at while it is sought, and the others once, at its
 * end. */
#include "path.h"

static const double PER_GAP = 50, PER_LAW = 300; /* multiplications, about */

/* Places of all contact points at a node. */
static void all_places(Path* p, Node* n) {
  const Body* b = p->body;
  double local[3 * DP_MAX_CONTACTS];
  if (n->touch_known) return;
  *p->spent += 3. * b->kp * b->nc;
  field_apply(b, b->contacts, 1, n->zeta, b->nc, local);
  rotate(n->R, local, b->nc, n->touch);
  n->touch_known = 1;
}

/* Gaps to a part of the terrain of n points at c + y (world), y as columns `stride` apart. */
static void gaps_of(const Path* p, int part, const double c[3], const double* restrict y, int n,
                    int stride, double* restrict gaps) {
  const Terrain* t = &p->terrain;
  const double* plane = t->geoms + TERRAIN_GEOM * part;
  *p->spent += PER_GAP * n;
  if (part < t->n_geoms && plane[0] == DP_PLANE) {
    /* the normal: R e_z */
    const double *at = plane + 4, x = plane[9], yy = plane[12], z = plane[15];
    const double offset = x * (c[0] - at[0]) + yy * (c[1] - at[1]) + z * (c[2] - at[2]);
    for (int s = 0; s < n; s++)
      gaps[s] = x * y[s] + yy * y[stride + s] + z * y[2 * stride + s] + offset;
    return;
  }
  for (int s = 0; s < n; s++) {
    const double place[3] = {c[0] + y[s], c[1] + y[stride + s], c[2] + y[2 * stride + s]};
    gaps[s] = terrain_gap(t, part, place, NULL, NULL);
  }
}

/* Whether a ball around c (world) comes near a part of the terrain. */
static int is_near(const Path* p, int part, const double c[3], double radius) {
  const Terrain* t = &p->terrain;
  *p->spent += PER_GAP;
  return !(part < t->n_geoms ? terrain_gap(t, part, c, NULL, NULL) > radius
                             : c[2] - t->top - t->centre[2] > radius);
}

static double radius_of(const double* y, int n, int stride) {
  double most = 0;
  for (int s = 0; s < n; s++) {
    const double a = y[s], b = y[stride + s], c = y[2 * stride + s];
    most = fmax(most, a * a + b * b + c * c);
  }
  return sqrt(most);
}

static void centre_of(const Path* p, const Node* n, double c[3]) {
  for (int i = 0; i < 3; i++) c[i] = p->origin[i] + n->at.c[i];
}

/* Marks points of node n that are nearer to the terrain than `reach` (per point, NULL: none) and
 * its thickness; returns how many were not marked before. */
static int mark(const Path* p, const Node* n, const double* reach, char* marked) {
  const Body* b = p->body;
  const double thickness = p->terrain.thickness;
  double c[3], gaps[DP_MAX_CONTACTS], most = 0;
  int count = 0;
  centre_of(p, n, c);
  for (int s = 0; reach && s < b->n_contacts; s++) most = fmax(most, reach[s]);
  const double radius = radius_of(n->touch, b->n_contacts, b->nc) + thickness + most;
  for (int part = 0; part < terrain_parts(&p->terrain); part++) {
    if (!is_near(p, part, c, radius)) continue;
    gaps_of(p, part, c, n->touch, b->n_contacts, b->nc, gaps);
    for (int s = 0; s < b->n_contacts; s++) {
      if (marked[s] || gaps[s] >= thickness + (reach ? reach[s] : 0)) continue;
      marked[s] = 1, count++;
    }
  }
  return count;
}

/* The marked points' field, and their places at node 1 with derivatives. */
static void gather(Path* p, const char* marked) {
  const Body* b = p->body;
  const int r = b->r, nc = b->nc;
  p->n_near = 0;
  for (int s = 0; s < b->n_contacts; s++)
    if (marked[s]) p->near[p->n_near++] = s;
  const int n = p->n_near, mp = p->mp = padded(n);
  for (int a = 0; a <= b->k; a++)
    for (int i = 0; i < 3; i++) {
      const double* from = b->contacts + (3 * (size_t)a + i) * nc;
      double* to = p->near_field + (3 * (size_t)a + i) * mp;
      for (int k = 0; k < mp; k++) to[k] = k < n ? from[p->near[k]] : 0;
    }
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < mp; k++)
      p->near_y1[i * mp + k] = k < n ? p->n1->touch[i * nc + p->near[k]] : 0;
  if (!n) return;
  *p->spent += 3. * mp * b->kp * (1 + r);
  double local[DP_MAX_MODES * 3 * DP_MAX_CONTACTS];
  field_apply(b, p->near_field, r, p->n1->dz, mp, local);
  for (int c = 0; c < r; c++) rotate(p->n1->R, local + c * 3 * mp, mp, p->near_Jq + c * 3 * mp);
}

void touch_prepare(Path* p) {
  const Body* b = p->body;
  const int nc = b->nc;
  p->m = p->n_near = p->mp = 0;
  if (!terrain_parts(&p->terrain)) return;
  all_places(p, p->n0), all_places(p, p->n1);
  double reach[DP_MAX_CONTACTS]; /* how far they went in the last interval, and a little */
  char marked[DP_MAX_CONTACTS] = {0};
  for (int s = 0; s < b->n_contacts; s++) {
    double went = 0;
    for (int i = 0; i < 3; i++) {
      const double d =
          p->n1->at.c[i] - p->n0->at.c[i] + p->n1->touch[i * nc + s] - p->n0->touch[i * nc + s];
      went += d * d;
    }
    reach[s] = 1.25 * sqrt(went) + p->terrain.thickness;
  }
  mark(p, p->n1, reach, marked);
  gather(p, marked);
}

int touch_missed(Path* p) {
  char marked[DP_MAX_CONTACTS] = {0};
  if (!terrain_parts(&p->terrain)) return 0;
  all_places(p, p->n2);
  for (int k = 0; k < p->n_near; k++) marked[p->near[k]] = 1;
  if (!mark(p, p->n2, NULL, marked)) return 0;
  gather(p, marked);
  return 1;
}

/* Force of a part of the terrain on near point k at node 2, c its centre (world), with the velocity
 * of the interval; `slot` is where its D and F are, -1 if it has none yet. */
static void touch_point(Path* p, int part, int k, const double* c, int* slot) {
  const Terrain* t = &p->terrain;
  const int mp = p->mp;
  const double ih = 1 / p->h, *y1 = p->near_y1, *y2 = p->near_y2;
  double x[3], v[3], f[3] = {0};
  if (*slot < 0) {
    *slot = p->m, p->which[p->m++] = k;
    memset(p->touch_D + 9 * *slot, 0, 9 * sizeof(double));
    memset(p->touch_F + 9 * *slot, 0, 9 * sizeof(double));
  }
  for (int i = 0; i < 3; i++) {
    const int at = i * mp + k;
    x[i] = c[i] + y2[at];
    v[i] = (p->n2->at.c[i] - p->n1->at.c[i] + y2[at] - y1[at]) * ih;
  }
  *p->spent += PER_LAW;
  contact_law(t, t->friction, part, x, v, f, p->touch_D + 9 * *slot, p->touch_F + 9 * *slot);
  for (int i = 0; i < 3; i++) p->near_f[i * mp + k] += f[i];
}

void touch_forces(Path* p) {
  const int mp = p->mp, n = p->n_near;
  const double thickness = p->terrain.thickness, ih = 1 / p->h;
  double c[3], local[3 * DP_MAX_CONTACTS], gaps[DP_MAX_CONTACTS];
  int slot[DP_MAX_CONTACTS];
  p->m = 0;
  if (!n) return;
  *p->spent += 3. * p->body->kp * mp;
  field_apply(p->body, p->near_field, 1, p->n2->zeta, mp, local);
  rotate(p->n2->R, local, mp, p->near_y2);
  memset(p->near_f, 0, 3 * mp * sizeof(double));
  for (int k = 0; k < n; k++) slot[k] = -1;
  centre_of(p, p->n2, c);
  const double radius = radius_of(p->near_y2, n, mp) + thickness;
  for (int part = 0; part < terrain_parts(&p->terrain); part++) {
    if (!is_near(p, part, c, radius)) continue;
    gaps_of(p, part, c, p->near_y2, n, mp, gaps);
    for (int k = 0; k < n; k++)
      if (!(gaps[k] >= thickness)) touch_point(p, part, k, c, slot + k);
  }
  for (int k = 0; k < 9 * p->m; k++) p->touch_D[k] += ih * p->touch_F[k];
}

void touch_matrix(Path* p, int exact, double* H) {
  const int r = p->body->r, n = 6 + r, mp = p->mp;
  double sums[MAX_N * ROW] = {0}, local[DP_MAX_MODES * 3 * DP_MAX_CONTACTS];
  double later[DP_MAX_MODES * 3 * DP_MAX_CONTACTS];
  *p->spent += p->m * 3. * ROW * n + (exact ? 3. * r * p->body->kp * mp : 0);
  if (exact) {
    field_apply(p->body, p->near_field, r, p->n2->dz, mp, local);
    for (int c = 0; c < r; c++) rotate(p->n2->R, local + c * 3 * mp, mp, later + c * 3 * mp);
  }
  for (int k = 0; k < p->m; k++) {
    const int s = p->which[k];
    double J[3][ROW], J2[3][ROW];
    point_jacobian(p->near_y1 + s, p->near_Jq + s, r, mp, J);
    if (exact) point_jacobian(p->near_y2 + s, later + s, r, mp, J2);
    else memcpy(J2, J, sizeof J);
    point_product(J, p->touch_D + 9 * k, J2, n, sums);
  }
  for (int a = 0; a < n; a++)
    for (int j = 0; j < n; j++) H[a * n + j] += sums[a * ROW + j];
}
