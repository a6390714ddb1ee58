/* Measures of a state: energies, momenta, surface, clearance, contact, feet.
 *
 * dp_energy and dp_contacts take the configuration before to be h = timestep/substeps earlier, by
 * the state's velocity. If the last step was divided, its last substep was shorter, and its
 * velocity is over that: a state does not tell, so they then speak of an interval that was not one
 * of the step's. */
#include "kinematics.h"
#include "state.h"

void dp_energy(const dp_model* m, const double* x, double out[9]) {
  Parts p;
  memset(out, 0, 9 * sizeof(double));
  if (parts_view(&p, m)) return;
  const Body* b = &p.body;
  const double* par = m->par;
  const int kp = b->kp, r = b->r;
  const double h = par[DP_TIMESTEP] / p.substeps, ih = 1 / h, *v = x + 7 + r;
  Pose now, before;
  state_nodes(r, x, h, &now, &before);
  double zeta[2][MAX_ZETA], scratch[kinematics_scratch(b) + PAD], P[9 * kp], R[2][9];
  kinematics(b, now.q, 0, zeta[0], aligned(scratch));
  kinematics(b, before.q, 0, zeta[1], aligned(scratch));
  quat_matrix(now.quat, R[0]), quat_matrix(before.quat, R[1]);
  /* N = sum_v m_v (R_1 y_1) (R_0 y_0)^T */
  double N[9], Q[9];
  moments_apply(b, 1, zeta[1], P);
  moments_pair(P, zeta[0], kp, Q);
  to_world(R[0], Q, R[1], N);
  double spread = -2 * (N[0] + N[4] + N[8]);
  for (int t = 0; t < 2; t++)
    for (int a = 0; a < kp; a++) spread += (2 * b->trace[a] + zeta[t][a]) * zeta[t][a];
  out[0] = .5 * b->mass * dot3(v, v) + .5 * ih * ih * spread;
  /* the variational step takes elasticity at an interval's middle, other potentials at its ends */
  const double share = p.euler ? 1 : .5;
  for (int c = 0; c < r; c++) {
    const double q = share * now.q[c] + (1 - share) * before.q[c];
    out[1] += .5 * b->stiffness[c] * q * q;
  }
  const double z = x[2] + (1 - share) * before.c[2];
  const double upright = share * R[0][8] + (1 - share) * R[1][8];
  out[2] = -b->mass * par[DP_GRAVITY] * z +
           b->mass * STANDARD_GRAVITY * par[DP_RIGHTING] * (1 - upright);
  double orbit[3], momentum[3], spin[3];
  for (int i = 0; i < 3; i++) out[3 + i] = momentum[i] = b->mass * v[i];
  cross3(x, momentum, orbit);
  vee(N, spin); /* -(y1 x y0) summed */
  for (int i = 0; i < 3; i++) out[6 + i] = orbit[i] + spin[i] * ih;
}

void dp_surface(const double* blob, const double* qpos, double* points) {
  const dp_model model = {blob, NULL, NULL, NULL};
  Parts p;
  if (parts_view(&p, &model)) return;
  const Body b = p.body;
  double quat[4], R[9], zeta[MAX_ZETA], scratch[kinematics_scratch(&b) + PAD];
  memcpy(quat, qpos + 3, sizeof quat);
  quat_normalize(quat), quat_matrix(quat, R);
  kinematics(&b, qpos + 7, 0, zeta, aligned(scratch));
  const int n = b.ns;
  for (int from = 0; from < n; from += 64) { /* blocks bound the memory on the stack */
    const int count = n - from < 64 ? n - from : 64;
    double y[3 * 64] = {0};
    for (int a = 0; a <= b.k; a++)
      for (int i = 0; i < 3; i++) {
        const double z = zeta[a], *restrict row = b.surface + ((size_t)3 * a + i) * n + from;
        for (int s = 0; s < count; s++) y[i * 64 + s] += z * row[s];
      }
    for (int s = 0; s < count && from + s < b.n_surface; s++)
      for (int i = 0; i < 3; i++)
        points[3 * (from + s) + i] =
            qpos[i] + R[3 * i] * y[s] + R[3 * i + 1] * y[64 + s] + R[3 * i + 2] * y[128 + s];
  }
}

double dp_clearance(const double* blob, const double* qpos, int n_geom, const dp_geom* geoms,
                    double cutoff, int* geom, int* point) {
  Body b;
  double best = cutoff;
  if (geom) *geom = -1;
  if (point) *point = -1;
  if (body_view_own(&b, blob)) return best;
  if (!is_finite(qpos, 7 + b.r)) return NAN;
  /* the surface stays within 1.5 times its largest rest distance from the centre of mass */
  const double reach = 1.5 * b.radius;
  int near = 0;
  for (int i = 0; i < n_geom && !near; i++)
    near = dp_geom_distance(geoms + i, qpos, NULL) < reach + cutoff;
  if (!near) return best;
  double points[3 * (b.n_surface > 0 ? b.n_surface : 1)];
  dp_surface(blob, qpos, points);
  for (int i = 0; i < n_geom; i++) {
    if (!(dp_geom_distance(geoms + i, qpos, NULL) < reach + best)) continue;
    for (int s = 0; s < b.n_surface; s++) {
      double d = dp_geom_distance(geoms + i, points + 3 * s, NULL);
      if (d < best) {
        best = d;
        if (geom) *geom = i;
        if (point) *point = s;
      }
    }
  }
  return best;
}

/* World places of the contact points in a configuration, 3 x nc. */
static void contact_places(const Body* b, const double* origin, const Pose* at, double* out) {
  double R[9], zeta[MAX_ZETA], scratch[kinematics_scratch(b) + PAD], local[3 * DP_MAX_CONTACTS];
  quat_matrix(at->quat, R);
  kinematics(b, at->q, 0, zeta, aligned(scratch));
  field_apply(b, b->contacts, 1, zeta, b->nc, local);
  rotate(R, local, b->nc, out);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < b->nc; s++) out[i * b->nc + s] += origin[i] + at->c[i];
}

int dp_contacts(const dp_model* m, const double* x, double* points, double* forces, double* gaps) {
  Parts p;
  if (parts_view(&p, m)) return 0;
  const int n = p.body.n_contacts, nc = p.body.nc, parts = terrain_parts(&p.terrain);
  memset(forces, 0, sizeof(double) * 3 * n);
  if (!parts) return 0;
  /* the last substep led from `before` to x: the law knows the velocity by it */
  const double h = m->par[DP_TIMESTEP] / p.substeps;
  double now[3 * DP_MAX_CONTACTS], then[3 * DP_MAX_CONTACTS];
  Pose last, before;
  state_nodes(p.body.r, x, h, &last, &before);
  contact_places(&p.body, x, &last, now), contact_places(&p.body, x, &before, then);
  int count = 0;
  for (int s = 0; s < n; s++) {
    double place[3], v[3], normal[3], D[9] = {0}, F[9] = {0};
    int touching = 0;
    for (int i = 0; i < 3; i++) {
      place[i] = points[3 * s + i] = now[i * nc + s];
      v[i] = (now[i * nc + s] - then[i * nc + s]) / h;
    }
    for (int part = 0; part < parts; part++)
      touching |= contact_law(&p.terrain, p.terrain.friction, part, place, v, forces + 3 * s, D, F);
    gaps[s] = dp_terrain_gap(m->terrain, place, normal);
    count += touching;
  }
  return count;
}

void dp_feet(const dp_model* m, const double* qpos, double* points, double* jacobian) {
  Parts p;
  if (parts_view(&p, m)) return;
  const int n = p.feet.n, np = p.feet.np, r = p.body.r, nq = 7 + r;
  if (!n) return;
  double zeta[(1 + DP_MAX_MODES) * MAX_ZETA], scratch[kinematics_scratch(&p.body) + PAD];
  double quat[4], R[9], local[(1 + DP_MAX_MODES) * 3 * DP_MAX_FEET];
  double world[(1 + DP_MAX_MODES) * 3 * DP_MAX_FEET];
  memcpy(quat, qpos + 3, sizeof quat);
  quat_normalize(quat), quat_matrix(quat, R);
  kinematics(&p.body, qpos + 7, 1, zeta, aligned(scratch));
  field_apply(&p.body, p.feet.field, 1 + r, zeta, np, local);
  for (int c = 0; c <= r; c++) rotate(R, local + c * 3 * np, np, world + c * 3 * np);
  for (int s = 0; s < n; s++) {
    const double y[3] = {world[s], world[np + s], world[2 * np + s]};
    for (int i = 0; i < 3; i++) {
      points[3 * s + i] = qpos[i] + y[i];
      if (!jacobian) continue;
      double* row = jacobian + (size_t)(3 * s + i) * nq;
      for (int j = 0; j < 3; j++) row[j] = i == j;
      for (int c = 0; c < r; c++) row[7 + c] = world[((1 + c) * 3 + i) * np + s];
      /* a turn t moves the point by t x y */
      double g[3] = {0};
      g[(i + 1) % 3] = y[(i + 2) % 3], g[(i + 2) % 3] = -y[(i + 1) % 3];
      quaternion_pull(qpos + 3, g, row + 3);
    }
  }
}
