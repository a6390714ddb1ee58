/* The drag of a medium on the body's drag points in the interval between two configurations: its
 * law, derivatives of it, and the area vectors that it takes (drag.c). Symmetric matrices D of
 * points are kept as xx xy xz yy yz zz, np each. */
#ifndef DEFPLAN_DRAG_H
#define DEFPLAN_DRAG_H
#include "kinematics.h"

static const double SPEED2 = 1e-4; /* m^2/s^2: rounds the tangential drag at rest */

static inline int has_drag(const Body* b, const double* par) {
  return b->np && par[DP_FLUID_DENSITY] != 0;
}

/* Forces f (3 np) on points of area vectors a that went from y0 to y1 in h, centres dc apart,
 *   f = -c_n |v.a| (v.a) a - c_t sqrt(|v|^2 + e^2) v,  c_n = rho C_d/2|a|^2, c_t = rho C_f |a|/2,
 * v = (dc + y1 - y0)/h, and D = -df/dy1 (NULL: not wanted). With D, returns the potential that f
 * has: E = h sum [c_n |v.a|^3 + c_t (|v|^2 + e^2)^{3/2}] / 3, f = -dE/dy1. */
double drag_forces(const Body* b, const double* par, double h, const double* dc, const double* y0,
                   const double* y1, const double* area, double* f, double* D);

/* out (3 x n) = factor D v */
static inline __attribute__((always_inline)) void drag_apply(
    const double factor, const double* restrict D, const double* restrict v, int n,
    double* restrict out) {
  for (int s = 0; s < n; s++) {
    double x = v[s], y = v[n + s], z = v[2 * n + s];
    out[s] = factor * (D[s] * x + D[n + s] * y + D[2 * n + s] * z);
    out[n + s] = factor * (D[n + s] * x + D[3 * n + s] * y + D[4 * n + s] * z);
    out[2 * n + s] = factor * (D[2 * n + s] * x + D[4 * n + s] * y + D[5 * n + s] * z);
  }
}

/* out (3 x n): e_m x y, the motion of points at y from the centre by a turn about axis m */
static inline void turn_column(int m, const double* restrict y, int n, double* restrict out) {
  const int m1 = (m + 1) % 3, m2 = (m + 2) % 3;
  for (int s = 0; s < n; s++)
    out[m * n + s] = 0, out[m1 * n + s] = -y[m2 * n + s], out[m2 * n + s] = y[m1 * n + s];
}

/* What area vectors follow from: tangents in body axes, 3 np each. */
typedef struct {
  double *tangent1, *tangent2;
} Tangents;
/* area (3 np) = A0 R (t1 x t2) at a shape; `local` 3 np is overwritten. */
void drag_areas(const Body* b, const double* R, const double* zeta, Tangents t, double* local,
                double* area);
/* Gradient ga (3 np) by the area vectors of factor sum -w . f, f that of drag_forces. */
void drag_area_gradient(const Body* b, const double* par, double factor, double h, const double* dc,
                        const double* y0, const double* y1, const double* area, const double* w,
                        double* ga);
/* Gradients by places y of the drag points (gp) and by area vectors (ga), world axes, of a
 * configuration -> add to those by c and turn (out, 6) and by zeta (gz). `local`, 3 x 3 np, is
 * overwritten. */
void drag_pull(const Body* b, const double* R, const double* y, const double* area, Tangents t,
               const double* gp, const double* ga, double* local, double* out, double* gz);
#endif
