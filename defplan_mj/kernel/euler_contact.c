/* Forces on points of the body in implicit Euler's step: contact with the terrain, by the law of
 * contact_law.c with v = (p - p_1)/h, and given forces on its feet. All of it is taken at the end of the
 * step, so the equations are no longer those of a minimum. With `reference` the normal of friction and its
 * force are those there, and there is no damping: then friction has the potential
 * h mu |f_n| sqrt(|v|^2 + e^2), and the step is a minimisation again. */
#include "work.h"

void contact_positions(const Work* w, const Config* cfg, double* out) {
  const Body* b = w->body;
  double* local = w->touch_Jq; /* not in use while positions are */
  field_apply(b, b->contacts, 1, cfg->zeta, b->nc, local);
  rotate(cfg->R, local, b->nc, out);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < b->nc; s++) out[i * b->nc + s] += w->origin[i] + cfg->c[i];
}

void contact_prepare(Work* w) { contact_positions(w, &w->one, w->touch_before); }

/* Force f (3) on a point at p, its derivatives D = -df/dp in all, F = -df/dv; returns the energy. Without
 * `reference` the law is that of contact_law.c, which has no energy: the spring's is returned. */
static double contact_force(const Work* w, int part, const double* p, const double* before,
                            const double* reference, double* f, double* D, double* F) {
  const Terrain* t = &w->terrain;
  const double h = w->h, mu = w->friction, k = t->stiffness;
  double a[3], A[9], v[3], energy = 0;
  for (int i = 0; i < 3; i++) v[i] = (p[i] - before[i]) / h;
  const double depth = t->thickness - terrain_gap(t, part, p, a, A);
  if (!(depth <= 0)) energy = k * depth * depth * depth / 3;
  if (!reference && mu != 0) {
    double now[9] = {0};
    contact_law(t, mu, part, p, v, f, D, now);
    for (int i = 0; i < 9; i++) F[i] += now[i], D[i] += now[i] / h;
    return energy;
  }
  if (!(depth <= 0)) { /* also what is not a number, so that the step fails */
    for (int i = 0; i < 3; i++) f[i] += k * depth * depth * a[i];
    for (int i = 0; i < 9; i++) D[i] += 2 * k * depth * a[i / 3] * a[i % 3] - k * depth * depth * A[i];
  }
  if (!reference || mu == 0) return energy;
  const double lagged = t->thickness - terrain_gap(t, part, reference, a, NULL), size = sqrt(dot3(a, a));
  const double fn = lagged > 0 ? k * lagged * lagged * size : 0;
  if (!(fn > 0)) return energy;
  double u[3], n[3], s[3];
  for (int i = 0; i < 3; i++) n[i] = a[i] / size;
  const double vn = dot3(v, n);
  for (int i = 0; i < 3; i++) u[i] = v[i] - vn * n[i];
  const double speed = sqrt(dot3(u, u) + t->slip * t->slip), c = mu * fn / speed;
  for (int i = 0; i < 3; i++) s[i] = u[i] / speed, f[i] -= mu * fn * s[i];
  for (int i = 0; i < 9; i++) {
    const double P = (i % 4 == 0) - n[i / 3] * n[i % 3] - s[i / 3] * s[i % 3];
    F[i] += c * P, D[i] += c * P / h;
  }
  return energy + h * mu * fn * (speed - t->slip);
}

/* Forces on n points at p (from the centre of mass), padded to np, of a field: what work_assemble
 * does for drag, without the force's own derivative. Jq (r x 3 np) is filled. */
static void add_forces(Work* w, const double* field, int np, const double* p, const double* f, double* Jq,
                       double* N) {
  const Body* b = w->body;
  const int r = b->r, n = 6 + r;
  const double* R = w->now.R;
  double back[3 * DP_MAX_CONTACTS], torque[3], *g = w->g, *H = w->H;
  for (int i = 0; i < 3; i++) g[i] -= sum(f + i * np, np);
  sum_cross(p, f, np, torque);
  for (int i = 0; i < 3; i++) g[3 + i] -= torque[i];
  rotate_back(R, f, np, back);
  for (int s = 0; s < 3 * np; s++) back[s] = -back[s];
  field_transpose(b, field, back, np, w->gzeta);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) N[3 * i + j] += inner(f + i * np, p + j * np, np);
  double local[DP_MAX_MODES * 3 * DP_MAX_CONTACTS];
  field_apply(b, field, r, w->now.dz, np, local);
  for (int c = 0; c < r; c++) {
    double *Jc = Jq + c * 3 * np, bend[3];
    rotate(R, local + c * 3 * np, np, Jc);
    sum_cross(Jc, f, np, bend);
    g[6 + c] -= inner(Jc, f, 3 * np);
    for (int i = 0; i < 3; i++) H[(3 + i) * n + 6 + c] -= bend[i];
  }
}

/* The points that touch at the iterate, with their field. */
static double find_touching(Work* w) {
  const Body* b = w->body;
  const int nc = b->nc, parts = terrain_parts(&w->terrain);
  int which[DP_MAX_CONTACTS], m = 0;
  double f[3 * DP_MAX_CONTACTS], energy = 0;
  contact_positions(w, &w->now, w->touch_now);
  double radius = 0, centre[3];
  for (int i = 0; i < 3; i++) centre[i] = w->origin[i] + w->now.c[i];
  for (int s = 0; s < b->n_contacts; s++) {
    double d2 = 0;
    for (int i = 0; i < 3; i++) d2 += (w->touch_now[i * nc + s] - centre[i]) * (w->touch_now[i * nc + s] - centre[i]);
    radius = fmax(radius, d2);
  }
  radius = sqrt(radius) + w->terrain.thickness;
  int touching[DP_MAX_CONTACTS] = {0};
  for (int part = 0; part < parts; part++) {
    if (part < w->terrain.n_geoms ? terrain_gap(&w->terrain, part, centre, NULL, NULL) > radius
                                  : centre[2] - w->terrain.top - w->terrain.centre[2] > radius)
      if (!w->reference) continue;
    for (int s = 0; s < b->n_contacts; s++) {
      double p[3], before[3], reference[3];
      for (int i = 0; i < 3; i++) {
        p[i] = w->touch_now[i * nc + s], before[i] = w->touch_before[i * nc + s];
        if (w->reference) reference[i] = w->reference[i * nc + s];
      }
      double gap = terrain_gap(&w->terrain, part, p, NULL, NULL);
      if (w->reference) gap = fmin(gap, terrain_gap(&w->terrain, part, reference, NULL, NULL));
      if (gap >= w->terrain.thickness) continue;
      if (!touching[s]) {
        touching[s] = ++m, which[m - 1] = s;
        memset(w->touch_D + 9 * (m - 1), 0, 9 * sizeof(double)), memset(w->touch_F + 9 * (m - 1), 0, 9 * sizeof(double));
        f[3 * m - 3] = f[3 * m - 2] = f[3 * m - 1] = 0;
      }
      const int k = touching[s] - 1;
      energy += contact_force(w, part, p, before, w->reference ? reference : NULL, f + 3 * k, w->touch_D + 9 * k,
                              w->touch_F + 9 * k);
    }
  }
  const int mp = (m + PAD - 1) / PAD * PAD;
  if (m != w->m || memcmp(which, w->which, m * sizeof(int))) {
    memcpy(w->which, which, m * sizeof(int)), w->m = m, w->mp = mp;
    for (int row = 0; row < 3 * b->kp; row++)
      for (int s = 0; s < mp; s++) w->touch_field[row * mp + s] = s < m ? b->contacts[row * nc + which[s]] : 0;
  }
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < mp; s++) {
      w->touch_points[i * mp + s] = s < m ? w->touch_now[i * nc + which[s]] - centre[i] : 0;
      w->touch_force[i * mp + s] = s < m ? f[3 * s + i] : 0;
    }
  return energy;
}

double forces_evaluate(Work* w, double* N) {
  double energy = 0;
  if (w->feet.n) {
    const int np = w->feet.np;
    double local[3 * DP_MAX_FEET];
    field_apply(w->body, w->feet.field, 1, w->now.zeta, np, local);
    rotate(w->now.R, local, np, w->feet_points);
    for (int i = 0; i < 3; i++)
      for (int s = 0; s < np; s++) {
        const double f = s < w->feet.n ? w->u[w->body->r + 3 * s + i] : 0;
        w->feet_force[i * np + s] = f, energy -= f * (w->now.c[i] + w->feet_points[i * np + s]); /* places from the origin: a constant */
      }
    add_forces(w, w->feet.field, np, w->feet_points, w->feet_force, w->feet_Jq, N);
  }
  if (terrain_parts(&w->terrain)) {
    energy += find_touching(w);
    if (w->m) add_forces(w, w->touch_field, w->mp, w->touch_points, w->touch_force, w->touch_Jq, N);
  }
  return energy;
}

void forces_hessian(Work* w) {
  const int r = w->body->r, n = 6 + r, mp = w->mp;
  if (!terrain_parts(&w->terrain) || !w->m) return;
  double H[MAX_N * ROW] = {0};
  for (int s = 0; s < w->m; s++) {
    double J[3][ROW] = {{0}}, DJ[3][ROW];
    const double *D = w->touch_D + 9 * s, p[3] = {w->touch_points[s], w->touch_points[mp + s], w->touch_points[2 * mp + s]};
    for (int i = 0; i < 3; i++) {
      J[i][i] = 1;
      J[i][3 + (i + 1) % 3] = p[(i + 2) % 3], J[i][3 + (i + 2) % 3] = -p[(i + 1) % 3]; /* t x p */
      for (int c = 0; c < r; c++) J[i][6 + c] = w->touch_Jq[(c * 3 + i) * mp + s];
    }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < ROW; j++) DJ[i][j] = D[3 * i] * J[0][j] + D[3 * i + 1] * J[1][j] + D[3 * i + 2] * J[2][j];
    for (int a = 0; a < n; a++) {
      const double x = J[0][a], y = J[1][a], z = J[2][a];
      double* restrict row = H + a * ROW;
      for (int j = 0; j < ROW; j++) row[j] += x * DJ[0][j] + y * DJ[1][j] + z * DJ[2][j];
    }
  }
  for (int a = 0; a < n; a++)
    for (int j = 0; j < n; j++) w->H[a * n + j] += H[a * ROW + j];
}

/* World motion of points p of a field along lambda. */
static void motion(const Work* w, const double* field, int np, const double* p, const double* lambda,
                   const double* dz, double* out) {
  double local[3 * DP_MAX_CONTACTS];
  const double* l = lambda;
  field_apply(w->body, field, 1, dz, np, local);
  rotate(w->now.R, local, np, out);
  for (int s = 0; s < np; s++) {
    const double x = p[s], y = p[np + s], z = p[2 * np + s];
    out[s] += l[0] + l[4] * z - l[5] * y;
    out[np + s] += l[1] + l[5] * x - l[3] * z;
    out[2 * np + s] += l[2] + l[3] * y - l[4] * x;
  }
}

void forces_mixed(Work* w, const double* lambda, const double* dz, double* out, double* gz, double* gu) {
  const Body* b = w->body;
  double along[3 * DP_MAX_CONTACTS];
  /* dz of zeta counts displacements only: its entry of the rest shape is zero */
  if (w->feet.n && gu) {
    const int np = w->feet.np;
    motion(w, w->feet.field, np, w->feet_points, lambda, dz, along);
    for (int s = 0; s < w->feet.n; s++)
      for (int i = 0; i < 3; i++) gu[b->r + 3 * s + i] = -along[i * np + s];
  }
  if (!terrain_parts(&w->terrain) || !w->m) return;
  const int mp = w->mp, nc = b->nc;
  const double ih = 1 / w->h;
  double pull[3 * DP_MAX_CONTACTS], arm[3 * DP_MAX_CONTACTS], local[3 * DP_MAX_CONTACTS], turn[3];
  motion(w, w->touch_field, mp, w->touch_points, lambda, dz, along);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < mp; s++) {
      double f = 0;
      for (int j = 0; s < w->m && j < 3; j++) f += w->touch_F[9 * s + 3 * j + i] * along[j * mp + s];
      pull[i * mp + s] = -ih * f;
      arm[i * mp + s] = s < w->m ? w->touch_before[i * nc + w->which[s]] - w->origin[i] - w->one.c[i] : 0;
    }
  for (int i = 0; i < 3; i++) out[i] += sum(pull + i * mp, mp);
  sum_cross(arm, pull, mp, turn);
  for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
  rotate_back(w->one.R, pull, mp, local);
  field_transpose(b, w->touch_field, local, mp, gz);
}
