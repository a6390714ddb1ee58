/* Signed distances of points to simple solids with two derivatives. */
#include "terrain.h"

/* Nearest point on an ellipsoid with semi-axes a, first octant: bisection on the Lagrange
 * multiplier, sum (a_i p_i / (t + a_i^2))^2 = 1 (Eberly, Distance from a Point to an Ellipsoid). */
static void ellipsoid_nearest(const double* a, const double* p, double* out) {
  double low = 0, high = 0, least = fmin(a[0], fmin(a[1], a[2]));
  low = -least * least;
  for (int i = 0; i < 3; i++) low = fmax(low, a[i] * p[i] - a[i] * a[i]);
  high = sqrt(a[0] * a[0] * p[0] * p[0] + a[1] * a[1] * p[1] * p[1] + a[2] * a[2] * p[2] * p[2]) -
         least * least;
  for (int k = 0; k < 120 && high > low; k++) {
    double t = .5 * (low + high), s = 0;
    if (t == low || t == high) break;
    for (int i = 0; i < 3; i++) {
      double d = t + a[i] * a[i], e = d > 0 ? a[i] * p[i] / d : 0;
      s += e * e;
    }
    if (s > 1) low = t; else high = t;
  }
  double t = .5 * (low + high), s = 0;
  int flat = -1;
  for (int i = 0; i < 3; i++) {
    double d = t + a[i] * a[i];
    if (d <= 1e-14 * a[i] * a[i] ||
        (p[i] == 0 && a[i] == least && t < 0 && fabs(d) < 1e-9 * a[i] * a[i])) {
      out[i] = 0, flat = i;
    } else {
      out[i] = a[i] * a[i] * p[i] / d;
    }
    s += out[i] * out[i] / (a[i] * a[i]);
  }
  if (flat >= 0 && s < 1)
    out[flat] = a[flat] * sqrt(1 - s); /* on the axis inside: the side is free */
}

/* hessian (local, row-major) += factor a a^T */
static void add_square(double* hessian, double factor, double x, double y, double z) {
  const double a[3] = {x, y, z};
  for (int i = 0; i < 9; i++) hessian[i] += factor * a[i / 3] * a[i % 3];
}

/* Hessian of the distance to a surface with shape operator S at the nearest point,
 * S (I + dist S)^-1. */
static void curved(const double* size, const double* near, const double* n, double dist,
                   double* hessian) {
  double S[9], A[9], length = 0;
  for (int i = 0; i < 3; i++) length += near[i] * near[i] / pow(size[i], 4);
  length = sqrt(length);
  for (int i = 0; i < 9; i++) {
    double s = 0;
    for (int k = 0; k < 3; k++)
      s +=
          ((i / 3 == k) - n[i / 3] * n[k]) / (size[k] * size[k]) * ((i % 3 == k) - n[k] * n[i % 3]);
    S[i] = s / length, A[i] = (i % 4 == 0) + dist * S[i];
  }
  double c[9], inverse[9];
  for (int i = 0; i < 3; i++) cross3(A + 3 * ((i + 1) % 3), A + 3 * ((i + 2) % 3), c + 3 * i);
  const double det = dot3(A, c);
  for (int i = 0; i < 9; i++) inverse[i] = c[3 * (i % 3) + i / 3] / det;
  for (int i = 0; i < 9; i++) {
    hessian[i] = 0;
    for (int k = 0; k < 3; k++) hessian[i] += S[3 * (i / 3) + k] * inverse[3 * k + i % 3];
  }
}

double geom_gap(const dp_geom* g, const double p[3], double* normal, double* hessian) {
  double d[3] = {p[0] - g->pos[0], p[1] - g->pos[1], p[2] - g->pos[2]};
  double l[3], n[3] = {0, 0, 1}, dist;
  double unused[9], *h = hessian ? hessian : unused;
  mul_mtv(g->mat, d, l);
  const double* size = g->size;
  memset(h, 0, 9 * sizeof(double));
  switch (g->type) {
    case DP_PLANE:
      dist = l[2];
      break;
    case DP_SPHERE:
    case DP_CAPSULE: {
      double z = g->type == DP_SPHERE ? 0 : fmax(-size[1], fmin(size[1], l[2]));
      double v[3] = {l[0], l[1], l[2] - z}, length = sqrt(dot3(v, v));
      if (length > 0)
        for (int i = 0; i < 3; i++) n[i] = v[i] / length;
      dist = length - size[0];
      if (length > 0) {
        const int side = g->type == DP_CAPSULE && fabs(l[2]) < size[1];
        for (int i = 0; i < 3; i++) h[4 * i] = side && i == 2 ? 0 : 1 / length;
        add_square(h, -1 / length, n[0], n[1], n[2]);
      }
      break;
    }
    case DP_CYLINDER: {
      double rho = sqrt(l[0] * l[0] + l[1] * l[1]);
      double side = rho - size[0], cap = fabs(l[2]) - size[1];
      double c = rho > 0 ? l[0] / rho : 1, s = rho > 0 ? l[1] / rho : 0, up = l[2] < 0 ? -1 : 1;
      if (side > 0 && cap > 0) {
        dist = sqrt(side * side + cap * cap);
        n[0] = c * side / dist, n[1] = s * side / dist, n[2] = up * cap / dist;
        add_square(h, 1 / dist, c * cap / dist, s * cap / dist, -up * side / dist);
        add_square(h, side / (dist * rho), -s, c, 0);
      } else if (side > cap) {
        dist = side, n[0] = c, n[1] = s, n[2] = 0;
        if (rho > 0) add_square(h, 1 / rho, -s, c, 0);
      } else {
        dist = cap, n[0] = n[1] = 0, n[2] = up;
      }
      break;
    }
    case DP_BOX: {
      double q[3], out[3], outside = 0;
      int nearest = 0;
      for (int i = 0; i < 3; i++) {
        q[i] = fabs(l[i]) - size[i], out[i] = fmax(q[i], 0), outside += out[i] * out[i];
        if (q[i] > q[nearest]) nearest = i;
      }
      if (outside > 0) {
        dist = sqrt(outside);
        for (int i = 0; i < 3; i++)
          n[i] = (l[i] < 0 ? -1 : 1) * out[i] / dist, h[4 * i] = out[i] > 0 ? 1 / dist : 0;
        add_square(h, -1 / dist, n[0], n[1], n[2]);
      } else {
        dist = q[nearest];
        for (int i = 0; i < 3; i++) n[i] = i == nearest ? (l[i] < 0 ? -1 : 1) : 0;
      }
      break;
    }
    case DP_ELLIPSOID: {
      double a[3] = {fabs(l[0]), fabs(l[1]), fabs(l[2])}, near[3], v[3], inside = -1;
      ellipsoid_nearest(size, a, near);
      for (int i = 0; i < 3; i++)
        v[i] = a[i] - near[i], inside += a[i] * a[i] / (size[i] * size[i]);
      double length = sqrt(dot3(v, v)), sum = 0;
      for (int i = 0; i < 3; i++)
        n[i] = (l[i] < 0 ? -1 : 1) * near[i] / (size[i] * size[i]), sum += n[i] * n[i];
      for (int i = 0; i < 3; i++) n[i] /= sqrt(sum);
      dist = inside < 0 ? -length : length;
      if (hessian) {
        for (int i = 0; i < 3; i++) near[i] = l[i] < 0 ? -near[i] : near[i];
        curved(size, near, n, dist, h);
      }
      break;
    }
    default:
      return INFINITY;
  }
  if (normal) mul_mv(g->mat, n, normal);
  if (hessian) { /* to the world: mat h mat^T */
    double half[9];
    for (int i = 0; i < 3; i++) mul_mv(g->mat, (double[3]){h[i], h[3 + i], h[6 + i]}, half + 3 * i);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        h[3 * i + j] = g->mat[3 * j] * half[i] + g->mat[3 * j + 1] * half[3 + i] +
                       g->mat[3 * j + 2] * half[6 + i];
  }
  return dist;
}

double dp_geom_distance(const dp_geom* g, const double p[3], double normal[3]) {
  return geom_gap(g, p, normal, NULL);
}
