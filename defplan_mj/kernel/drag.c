/* Drag of the points of an interval, their area vectors, and gradients back from them. */
#include "drag.h"

void drag_areas(const Body* b, const double* R, const double* zeta, Tangents t, double* local,
                double* area) {
  const int np = b->np;
  double *restrict t1 = t.tangent1, *restrict t2 = t.tangent2, *restrict a = local;
  field_apply(b, b->tangent1, 1, zeta, np, t1);
  field_apply(b, b->tangent2, 1, zeta, np, t2);
  for (int s = 0; s < np; s++) {
    a[s] = b->areas[s] * (t1[np + s] * t2[2 * np + s] - t1[2 * np + s] * t2[np + s]);
    a[np + s] = b->areas[s] * (t1[2 * np + s] * t2[s] - t1[s] * t2[2 * np + s]);
    a[2 * np + s] = b->areas[s] * (t1[s] * t2[np + s] - t1[np + s] * t2[s]);
  }
  rotate(R, a, np, area);
}

static inline __attribute__((always_inline)) double forces_loop(
    const Body* b, const double* par, double h, const double* dc, const double* restrict y0,
    const double* restrict y1, const double* restrict a, double* restrict f, double* restrict D,
    const int derivative) {
  const int n = b->np;
  const double ih = 1 / h, rho = par[DP_FLUID_DENSITY], dx = dc[0], dy = dc[1], dz = dc[2];
  const double kn = .5 * rho * par[DP_DRAG_NORMAL], kt = .5 * rho * par[DP_DRAG_TANGENT];
  double e = 0;
  for (int s = 0; s < n; s++) {
    double vx = (dx + y1[s] - y0[s]) * ih, vy = (dy + y1[n + s] - y0[n + s]) * ih;
    double vz = (dz + y1[2 * n + s] - y0[2 * n + s]) * ih;
    double ax = a[s], ay = a[n + s], az = a[2 * n + s];
    /* padding has no area, and must have no drag */
    double A2 = ax * ax + ay * ay + az * az, cn = kn / (A2 + 1e-20), ct = kt * sqrt(A2);
    double vn = vx * ax + vy * ay + vz * az, av = fabs(vn);
    double v2 = vx * vx + vy * vy + vz * vz + SPEED2, speed = sqrt(v2);
    double fn = cn * av * vn, ft = ct * speed;
    f[s] = -fn * ax - ft * vx, f[n + s] = -fn * ay - ft * vy, f[2 * n + s] = -fn * az - ft * vz;
    if (!derivative) continue;
    double dn = 2 * cn * av * ih, dt = ct / speed * ih, d0 = ft * ih;
    D[s] = dn * ax * ax + dt * vx * vx + d0, D[n + s] = dn * ax * ay + dt * vx * vy;
    D[2 * n + s] = dn * ax * az + dt * vx * vz, D[3 * n + s] = dn * ay * ay + dt * vy * vy + d0;
    D[4 * n + s] = dn * ay * az + dt * vy * vz, D[5 * n + s] = dn * az * az + dt * vz * vz + d0;
    e += cn * av * vn * vn + ct * v2 * speed;
  }
  return h * e / 3;
}

double drag_forces(const Body* b, const double* par, double h, const double* dc, const double* y0,
                   const double* y1, const double* area, double* f, double* D) {
  return D ? forces_loop(b, par, h, dc, y0, y1, area, f, D, 1)
           : forces_loop(b, par, h, dc, y0, y1, area, f, NULL, 0);
}

/* d/da of cn |v.a| (v.a) (w.a) + ct |v| (w.v), cn = k_n / |a|^2 and ct = k_t |a| */
void drag_area_gradient(const Body* b, const double* par, double factor, double h, const double* dc,
                        const double* restrict y0, const double* restrict y1,
                        const double* restrict area, const double* restrict w,
                        double* restrict ga) {
  const int n = b->np;
  const double ih = 1 / h, rho = par[DP_FLUID_DENSITY];
  const double kn = .5 * factor * rho * par[DP_DRAG_NORMAL];
  const double kt = .5 * factor * rho * par[DP_DRAG_TANGENT];
  for (int s = 0; s < n; s++) {
    double v[3], a[3], d[3];
    for (int i = 0; i < 3; i++) {
      const int at = i * n + s;
      v[i] = (dc[i] + y1[at] - y0[at]) * ih, a[i] = area[at], d[i] = w[at];
    }
    const double A2 = dot3(a, a) + 1e-20, A = sqrt(A2), vn = dot3(v, a), av = fabs(vn);
    const double da = dot3(d, a), dv = dot3(d, v), speed = sqrt(dot3(v, v) + SPEED2), cn = kn / A2;
    for (int i = 0; i < 3; i++) {
      const double normal = 2 * av * v[i] * da + vn * av * d[i] - 2 * vn * av * da * a[i] / A2;
      ga[i * n + s] = cn * normal + kt * speed * dv * a[i] / A;
    }
  }
}

/* The area vector is A0 R (t1 x t2): d/dt1 = A0 t2 x R^T g, d/dt2 = A0 R^T g x t1. */
static void pull_tangents(const Body* b, Tangents t, const double* restrict g, double* restrict g1,
                          double* restrict g2) {
  const int n = b->np;
  for (int s = 0; s < n; s++) {
    double gs[3], t1[3], t2[3], x1[3], x2[3];
    for (int i = 0; i < 3; i++) {
      gs[i] = b->areas[s] * g[i * n + s];
      t1[i] = t.tangent1[i * n + s], t2[i] = t.tangent2[i * n + s];
    }
    cross3(t2, gs, x1), cross3(gs, t1, x2);
    for (int i = 0; i < 3; i++) g1[i * n + s] = x1[i], g2[i * n + s] = x2[i];
  }
}

void drag_pull(const Body* b, const double* R, const double* y, const double* area, Tangents t,
               const double* gp, const double* ga, double* local, double* out, double* gz) {
  const int np = b->np;
  double turn[3], *g1 = local + 3 * np, *g2 = local + 6 * np;
  places_pull(b, b->points, R, y, gp, np, local, out, gz);
  sum_cross(area, ga, np, turn);
  for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
  rotate_back(R, ga, np, local);
  pull_tangents(b, t, local, g1, g2);
  field_transpose(b, b->tangent1, g1, np, gz);
  field_transpose(b, b->tangent2, g2, np, gz);
}
