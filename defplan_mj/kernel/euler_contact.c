/* Forces on points of the body in implicit Euler's step: contact with the terrain, by the law of
 * contact_law.c with v = (p - p_1)/h, and given forces on its feet. All of it is taken at the end
 * of the step, so the equations are no longer those of a minimum. With `reference` the normal of
 * friction and its force are those there, and there is no damping: then friction has the potential
 * h mu |f_n| sqrt(|v|^2 + e^2), and the step is a minimisation again. */
#include "euler.h"

void point_forces(Work* w, const double* field, int n, const double* y, const double* Jq,
                  const double* f, double* back) {
  const int r = w->body->r, dim = 6 + r;
  double turn[3], bend[3], *g = w->g, *H = w->H;
  /* g_c = -sum f, g_t = -sum y x f, g_q = -sum Jq . f */
  sum_cross(y, f, n, turn);
  for (int i = 0; i < 3; i++) g[i] -= sum(f + i * n, n), g[3 + i] -= turn[i];
  for (int c = 0; c < r; c++) g[6 + c] -= inner(Jq + c * 3 * n, f, 3 * n);
  /* N += sum f y^T for H_tt, gz -= Phi^T R^T f for H_qq, H_tq -= sum Jq x f */
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) w->N[3 * i + j] += inner(f + i * n, y + j * n, n);
  rotate_back(w->now.R, f, n, back);
  for (int s = 0; s < 3 * n; s++) back[s] = -back[s];
  field_transpose(w->body, field, back, n, w->gz);
  for (int c = 0; c < r; c++) {
    sum_cross(Jq + c * 3 * n, f, n, bend);
    for (int i = 0; i < 3; i++) H[(3 + i) * dim + 6 + c] -= bend[i];
  }
}

void contact_places(const Work* w, const Config* cfg, double* out) {
  const Body* b = w->body;
  field_apply(b, b->contacts, 1, cfg->zeta, b->nc, w->touch_local);
  rotate(cfg->R, w->touch_local, b->nc, out);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < b->nc; s++) out[i * b->nc + s] += w->origin[i] + cfg->c[i];
}

void contact_prepare(Work* w) { contact_places(w, &w->one, w->touch_before); }

/* --- the force on one point that touches */

/* f += k d^2 a at a depth d along the gap's gradient a, A its Hessian; D = -df/dp */
static void spring(double k, double depth, const double* a, const double* A, double* f, double* D) {
  for (int i = 0; i < 3; i++) f[i] += k * depth * depth * a[i];
  for (int i = 0; i < 9; i++)
    D[i] += 2 * k * depth * a[i / 3] * a[i % 3] - k * depth * depth * A[i];
}

/* Friction by the normal force at `reference`: f -= mu f_n u / sqrt(|u|^2 + e^2),
 * u = (I - n n^T) v tangential; F = -df/dv; returns its potential. */
static double lagged_friction(const Work* w, int part, const double* v, const double* reference,
                              double* f, double* D, double* F) {
  const Terrain* t = &w->terrain;
  const double h = w->h, mu = w->friction;
  double a[3], u[3], n[3], s[3];
  const double depth = t->thickness - terrain_gap(t, part, reference, a, NULL);
  const double size = sqrt(dot3(a, a)), fn = depth > 0 ? t->stiffness * depth * depth * size : 0;
  if (!(fn > 0)) return 0;
  for (int i = 0; i < 3; i++) n[i] = a[i] / size;
  const double vn = dot3(v, n);
  for (int i = 0; i < 3; i++) u[i] = v[i] - vn * n[i];
  const double speed = sqrt(dot3(u, u) + t->slip * t->slip), c = mu * fn / speed;
  for (int i = 0; i < 3; i++) s[i] = u[i] / speed, f[i] -= mu * fn * s[i];
  for (int i = 0; i < 9; i++) {
    const double P = (i % 4 == 0) - n[i / 3] * n[i % 3] - s[i / 3] * s[i % 3];
    F[i] += c * P, D[i] += c * P / h;
  }
  return h * mu * fn * (speed - t->slip);
}

/* Force f (3) on a point at p that was at `before`, D = -df/dp in all, F = -df/dv; returns the
 * energy (with the law of contact_law.c, which has none, the spring's). */
static double contact_force(const Work* w, int part, const double* p, const double* before,
                            const double* reference, double* f, double* D, double* F) {
  const Terrain* t = &w->terrain;
  const double h = w->h, mu = w->friction, k = t->stiffness;
  double a[3], A[9], v[3], energy = 0;
  for (int i = 0; i < 3; i++) v[i] = (p[i] - before[i]) / h;
  const double depth = t->thickness - terrain_gap(t, part, p, a, A);
  const int touches = !(depth <= 0); /* also what is not a number, so that the step fails */
  if (touches) energy = k * depth * depth * depth / 3;
  if (!reference && mu != 0) {
    double now[9] = {0};
    contact_law(t, mu, part, p, v, f, D, now);
    for (int i = 0; i < 9; i++) F[i] += now[i], D[i] += now[i] / h;
    return energy;
  }
  if (touches) spring(k, depth, a, A, f, D);
  return reference && mu != 0 ? energy + lagged_friction(w, part, v, reference, f, D, F) : energy;
}

/* --- which points touch */

/* Radius of a ball around `centre` that holds all contact points, and the thickness more. */
static double contact_radius(const Work* w, const double* centre) {
  const int nc = w->body->nc;
  double most = 0;
  for (int s = 0; s < w->body->n_contacts; s++) {
    double d2 = 0;
    for (int i = 0; i < 3; i++) {
      const double d = w->touch_now[i * nc + s] - centre[i];
      d2 += d * d;
    }
    most = fmax(most, d2);
  }
  return sqrt(most) + w->terrain.thickness;
}

/* Whether that ball is beyond a part of the terrain's reach. */
static int is_far(const Work* w, int part, const double* centre, double radius) {
  const Terrain* t = &w->terrain;
  if (w->reference) return 0;
  return part < t->n_geoms ? terrain_gap(t, part, centre, NULL, NULL) > radius
                           : centre[2] - t->top - t->centre[2] > radius;
}

static void point_of(const double* places, int nc, int s, double* p) {
  for (int i = 0; i < 3; i++) p[i] = places[i * nc + s];
}

/* Points that touch a part of the terrain, or did at `reference`: their forces f (3 each), in the
 * order in which they were found, m of them so far; slot[s] - 1 is where point s is among them. */
static double touch_part(Work* w, int part, int* slot, int* which, int* m, double* f) {
  const Terrain* t = &w->terrain;
  const int nc = w->body->nc;
  double energy = 0, p[3], before[3], lagged[3];
  for (int s = 0; s < w->body->n_contacts; s++) {
    point_of(w->touch_now, nc, s, p);
    double gap = terrain_gap(t, part, p, NULL, NULL);
    if (w->reference) {
      point_of(w->reference, nc, s, lagged);
      gap = fmin(gap, terrain_gap(t, part, lagged, NULL, NULL));
    }
    if (gap >= t->thickness) continue;
    if (!slot[s]) {
      const int k = (*m)++;
      slot[s] = *m, which[k] = s;
      memset(w->touch_D + 9 * k, 0, 9 * sizeof(double));
      memset(w->touch_F + 9 * k, 0, 9 * sizeof(double));
      memset(f + 3 * k, 0, 3 * sizeof(double));
    }
    const int k = slot[s] - 1;
    point_of(w->touch_before, nc, s, before);
    energy += contact_force(w, part, p, before, w->reference ? lagged : NULL, f + 3 * k,
                            w->touch_D + 9 * k, w->touch_F + 9 * k);
  }
  return energy;
}

/* Take the m points `which`: places and forces, and their field if they are not those of before. */
static void gather(Work* w, const int* which, int m, const double* f, const double* centre) {
  const Body* b = w->body;
  const int nc = b->nc, mp = padded(m);
  if (m != w->m || memcmp(which, w->which, m * sizeof(int))) {
    memcpy(w->which, which, m * sizeof(int)), w->m = m, w->mp = mp;
    for (int row = 0; row < 3 * b->kp; row++)
      for (int s = 0; s < mp; s++)
        w->touch_field[row * mp + s] = s < m ? b->contacts[row * nc + which[s]] : 0;
  }
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < mp; s++) {
      w->touch_y[i * mp + s] = s < m ? w->touch_now[i * nc + which[s]] - centre[i] : 0;
      w->touch_f[i * mp + s] = s < m ? f[3 * s + i] : 0;
    }
}

/* The points that touch at the iterate; returns the energy of their forces. */
static double find_touching(Work* w) {
  int which[DP_MAX_CONTACTS], slot[DP_MAX_CONTACTS] = {0}, m = 0;
  double f[3 * DP_MAX_CONTACTS], centre[3], energy = 0;
  contact_places(w, &w->now, w->touch_now);
  for (int i = 0; i < 3; i++) centre[i] = w->origin[i] + w->now.c[i];
  const double radius = contact_radius(w, centre);
  for (int part = 0; part < terrain_parts(&w->terrain); part++)
    if (!is_far(w, part, centre, radius)) energy += touch_part(w, part, slot, which, &m, f);
  gather(w, which, m, f, centre);
  return energy;
}

/* --- what they do to the step's equations */

/* Jq (r x 3 n) = R Phi dz at the iterate */
static void modal_columns(const Work* w, const double* field, int n, double* Jq) {
  const int r = w->body->r;
  double local[DP_MAX_MODES * 3 * DP_MAX_CONTACTS];
  field_apply(w->body, field, r, w->now.dz, n, local);
  for (int c = 0; c < r; c++) rotate(w->now.R, local + c * 3 * n, n, Jq + c * 3 * n);
}

/* Given forces: E = -sum f . p, with p from `origin`, which is a constant less. */
static double feet_forces(Work* w) {
  const int n = w->feet.np, r = w->body->r;
  double local[3 * DP_MAX_FEET], back[3 * DP_MAX_FEET], energy = 0;
  field_apply(w->body, w->feet.field, 1, w->now.zeta, n, local);
  rotate(w->now.R, local, n, w->feet_y);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < n; s++) {
      const double f = s < w->feet.n ? w->u[r + 3 * s + i] : 0;
      w->feet_f[i * n + s] = f, energy -= f * (w->now.c[i] + w->feet_y[i * n + s]);
    }
  modal_columns(w, w->feet.field, n, w->feet_Jq);
  point_forces(w, w->feet.field, n, w->feet_y, w->feet_Jq, w->feet_f, back);
  return energy;
}

static double contact_forces(Work* w) {
  double back[3 * DP_MAX_CONTACTS];
  const double energy = find_touching(w);
  if (!w->m) return energy;
  modal_columns(w, w->touch_field, w->mp, w->touch_Jq);
  point_forces(w, w->touch_field, w->mp, w->touch_y, w->touch_Jq, w->touch_f, back);
  return energy;
}

double forces_evaluate(Work* w) {
  const double given = w->feet.n ? feet_forces(w) : 0;
  return terrain_parts(&w->terrain) ? given + contact_forces(w) : given;
}

/* H += J^T D J over what touches; D is not symmetric */
void forces_hessian(Work* w) {
  const int r = w->body->r, n = 6 + r, mp = w->mp;
  if (!terrain_parts(&w->terrain) || !w->m) return;
  double sums[MAX_N * ROW] = {0}, J[3][ROW];
  for (int s = 0; s < w->m; s++) {
    point_jacobian(w->touch_y + s, w->touch_Jq + s, r, mp, J);
    point_product(J, w->touch_D + 9 * s, J, n, sums);
  }
  for (int a = 0; a < n; a++)
    for (int j = 0; j < n; j++) w->H[a * n + j] += sums[a * ROW + j];
}

/* --- derivatives by the last configuration and by the input: L = -sum m.f, m the points' motion */

/* L by given forces: -m */
static void feet_mixed(Work* w, const double* lambda, double* gu) {
  const int n = w->feet.np, r = w->body->r;
  double m[3 * DP_MAX_FEET], local[3 * DP_MAX_FEET];
  points_along(w->body, w->feet.field, w->now.R, w->feet_y, lambda, w->along, n, local, m);
  for (int s = 0; s < w->feet.n; s++)
    for (int i = 0; i < 3; i++) gu[r + 3 * s + i] = -m[i * n + s];
}

/* L by where the points were, through v = (p - p_1)/h: dL/dp_1 = -F^T m / h */
static void contact_mixed(Work* w, const double* lambda, double* out, double* gz) {
  const Body* b = w->body;
  const int mp = w->mp, nc = b->nc;
  const double ih = 1 / w->h;
  double m[3 * DP_MAX_CONTACTS], pull[3 * DP_MAX_CONTACTS], y_one[3 * DP_MAX_CONTACTS];
  double local[3 * DP_MAX_CONTACTS];
  points_along(b, w->touch_field, w->now.R, w->touch_y, lambda, w->along, mp, local, m);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < mp; s++) {
      const int touches = s < w->m;
      double f = 0;
      for (int j = 0; touches && j < 3; j++) f += w->touch_F[9 * s + 3 * j + i] * m[j * mp + s];
      pull[i * mp + s] = -ih * f;
      const double c = w->origin[i] + w->one.c[i];
      y_one[i * mp + s] = touches ? w->touch_before[i * nc + w->which[s]] - c : 0;
    }
  places_pull(b, w->touch_field, w->one.R, y_one, pull, mp, local, out, gz);
}

void forces_mixed(Work* w, const double* lambda, double* out, double* gz, double* gu) {
  if (w->feet.n && gu) feet_mixed(w, lambda, gu);
  if (terrain_parts(&w->terrain) && w->m) contact_mixed(w, lambda, out, gz);
}
