/* The force of the terrain on a point, and its derivatives.
 *
 * A point at gap s of a part of the terrain, with s < d, takes the normal force
 * k (d - s)^2 psi(-b ds/dt) along the gradient a of s: a spring that is soft at first touch, and
 * grows with the speed
 * of the approach (after Hunt and Crossley, 1975), so that an impact loses the same energy whatever
 * the time step. psi is max(0, 1 + x) rounded, so that nothing sticks. Friction: Coulomb's,
 * rounded, mu |f_n| v / sqrt(|v|^2 + e^2) against the tangential velocity v = (I - n n^T) dp/dt. */
#include "terrain.h"

static const double ROUNDING = .1; /* of psi at x = -1 */

/* psi(x) and its derivative */
static double damping(double x, double* slope) {
  const double root = sqrt((1 + x) * (1 + x) + ROUNDING * ROUNDING);
  const double norm = 1 + sqrt(1 + ROUNDING * ROUNDING);
  *slope = (1 + (1 + x) / root) / norm;
  return (1 + x + root) / norm;
}

int contact_law(const Terrain* t, double mu, int part, const double* p, const double* v, double* f,
                double* D, double* F) {
  const double k = t->stiffness;
  double a[3], A[9], slope;
  const double depth = t->thickness - terrain_gap(t, part, p, a, A);
  if (depth <= 0) return 0; /* what is not a number goes on, so that the step fails */
  const double psi = damping(-t->damping * dot3(a, v), &slope), push = k * depth * depth * psi;
  const double size = sqrt(dot3(a, a)), fn = push * size;
  double Av[3], An[3], by_p[3], by_v[3]; /* derivatives of push */
  mul_mv(A, v, Av), mul_mv(A, a, An);
  for (int i = 0; i < 3; i++) {
    by_v[i] = -k * depth * depth * slope * t->damping * a[i];
    by_p[i] = -2 * k * depth * psi * a[i] - k * depth * depth * slope * t->damping * Av[i];
    f[i] += push * a[i];
  }
  for (int i = 0; i < 9; i++) {
    D[i] += -a[i / 3] * by_p[i % 3] - push * A[i];
    F[i] += -a[i / 3] * by_v[i % 3];
  }
  if (mu == 0) return 1;
  double n[3], u[3], s[3], P[9], fn_p[3], fn_v[3];
  for (int i = 0; i < 3; i++) n[i] = a[i] / size;
  const double vn = dot3(v, n);
  for (int i = 0; i < 3; i++) {
    u[i] = v[i] - vn * n[i];
    fn_p[i] = size * by_p[i] + push * An[i] / size, fn_v[i] = size * by_v[i];
  }
  const double speed = sqrt(dot3(u, u) + t->slip * t->slip), c = mu * fn / speed;
  for (int i = 0; i < 3; i++) s[i] = u[i] / speed, f[i] -= mu * fn * s[i];
  /* dn/dp = (I - n n^T) A / size; du = P dv - (n v^T + v.n) dn */
  double nA[3], N[9], vN[3], M[9], sM[3];
  mul_mtv(A, n, nA);
  for (int i = 0; i < 9; i++) { /* P = (I - s s^T)(I - n n^T), s _|_ n */
    P[i] = (i % 4 == 0) - n[i / 3] * n[i % 3] - s[i / 3] * s[i % 3];
    N[i] = (A[i] - n[i / 3] * nA[i % 3]) / size;
  }
  mul_mtv(N, v, vN);
  for (int i = 0; i < 9; i++) M[i] = n[i / 3] * vN[i % 3] + vn * N[i];
  mul_mtv(M, s, sM);
  for (int i = 0; i < 9; i++) {
    F[i] += c * P[i] + mu * s[i / 3] * fn_v[i % 3];
    D[i] += mu * s[i / 3] * fn_p[i % 3] - c * (M[i] - s[i / 3] * sM[i % 3]);
  }
  return 1;
}
