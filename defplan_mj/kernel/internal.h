/* What all of the kernel's files share: sizes, checks of numbers, 3-vectors and rotations. */
#ifndef DEFPLAN_INTERNAL_H
#define DEFPLAN_INTERNAL_H
#include <math.h>
#include <string.h>

#include "kernel.h"

enum { PAD = 8 }; /* arrays are padded to multiples of it, see vectors.h */
enum { MAX_N = 6 + DP_MAX_MODES, ROW = 24 }; /* unknowns of a substep; a padded row of them */
enum { MAX_STATE = 13 + 3 * DP_MAX_MODES };
enum { MAX_ZETA = DP_MAX_BASIS + 2 * PAD }; /* room for one zeta, padded */

static const double STANDARD_GRAVITY = 9.81; /* m/s^2, of the righting torque */
static const double MAX_TURN = .7;           /* rad or units of q in one Newton step */

static inline int padded(int n) { return (n + PAD - 1) / PAD * PAD; }

/* Whether a number of a header counts something: 0, 1, ... most. */
static inline int is_count(double x, double most) { return x >= 0 && x <= most && x == floor(x); }
static inline int is_finite(const double* a, size_t n) {
  int all = 1;
  for (size_t i = 0; i < n; i++) all &= isfinite(a[i]) != 0;
  return all;
}

/* --- 3-vectors and rotations, matrices row-major */
static inline double dot3(const double* a, const double* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
static inline void cross3(const double* a, const double* b, double* out) {
  double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0], out[0] = x, out[1] = y;
}
static inline void mul_mv(const double* A, const double* v, double* out) {
  double x = dot3(A, v), y = dot3(A + 3, v), z = dot3(A + 6, v);
  out[0] = x, out[1] = y, out[2] = z;
}
static inline void mul_mtv(const double* A, const double* v, double* out) {
  double x = A[0] * v[0] + A[3] * v[1] + A[6] * v[2], y = A[1] * v[0] + A[4] * v[1] + A[7] * v[2];
  double z = A[2] * v[0] + A[5] * v[1] + A[8] * v[2];
  out[0] = x, out[1] = y, out[2] = z;
}
static inline void skew_mul(const double* w, const double* A, double* out) { /* [w] A */
  for (int j = 0; j < 3; j++) {
    double x = A[j], y = A[3 + j], z = A[6 + j];
    out[j] = w[1] * z - w[2] * y, out[3 + j] = w[2] * x - w[0] * z;
    out[6 + j] = w[0] * y - w[1] * x;
  }
}
/* d with <[d], A> = sum_ij [d]_ij A_ij for all [d] */
static inline void vee(const double* A, double* out) {
  out[0] = A[7] - A[5], out[1] = A[2] - A[6], out[2] = A[3] - A[1];
}
static inline void quat_mul(const double* a, const double* b, double* out) {
  double w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  double x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
  double y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
  double z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
  out[0] = w, out[1] = x, out[2] = y, out[3] = z;
}
static inline void quat_between(const double* from, const double* to, double* q) { /* q from = to */
  const double back[4] = {from[0], -from[1], -from[2], -from[3]};
  quat_mul(to, back, q);
}
static inline void quat_normalize(double* q) {
  double s = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int i = 0; i < 4; i++) q[i] *= s;
}
static inline void quat_exp(const double* w, double* q) { /* rotation vector -> quaternion */
  double t2 = dot3(w, w), t = sqrt(t2), s = t2 < 1e-8 ? .5 - t2 / 48 : sin(.5 * t) / t;
  q[0] = t2 < 1e-8 ? 1 - t2 / 8 : cos(.5 * t);
  for (int i = 0; i < 3; i++) q[i + 1] = s * w[i];
}
static inline void quat_log(const double* q, double* w) { /* shortest rotation vector */
  double sign = q[0] < 0 ? -1 : 1, v2 = dot3(q + 1, q + 1), v = sqrt(v2), c = sign * q[0];
  double s = v2 < 1e-8 ? 2 / c * (1 - v2 / (3 * c * c)) : 2 * atan2(v, c) / v;
  for (int i = 0; i < 3; i++) w[i] = sign * s * q[i + 1];
}
static inline void quat_matrix(const double* q, double* R) {
  double w = q[0], x = q[1], y = q[2], z = q[3];
  R[0] = 1 - 2 * (y * y + z * z), R[1] = 2 * (x * y - w * z), R[2] = 2 * (x * z + w * y);
  R[3] = 2 * (x * y + w * z), R[4] = 1 - 2 * (x * x + z * z), R[5] = 2 * (y * z - w * x);
  R[6] = 2 * (x * z - w * y), R[7] = 2 * (y * z + w * x), R[8] = 1 - 2 * (x * x + y * y);
}
/* Left Jacobian of SO(3) at w, d exp(w + dw) = [J dw] exp(w); or its inverse. */
static inline void so3_left_jacobian(const double* w, int inverse, double* J) {
  double t2 = dot3(w, w), t = sqrt(t2), a, b;
  if (inverse) {
    a = -.5;
    b = t2 < 1e-4 ? 1. / 12 + t2 / 720 : (1 - .5 * t * cos(.5 * t) / sin(.5 * t)) / t2;
  } else {
    a = t2 < 1e-4 ? .5 - t2 / 24 : (1 - cos(t)) / t2;
    b = t2 < 1e-4 ? 1. / 6 - t2 / 120 : (t - sin(t)) / (t2 * t);
  }
  double W[9] = {0, -w[2], w[1], w[2], 0, -w[0], -w[1], w[0], 0};
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      J[3 * i + j] = (i == j ? 1 - b * t2 : 0) + a * W[3 * i + j] + b * w[i] * w[j];
}
/* C = A^T B */
static inline void mul_mtm(const double* A, const double* B, double* C) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      C[3 * i + j] = A[i] * B[j] + A[3 + i] * B[3 + j] + A[6 + i] * B[6 + j];
}
/* C = A B^T */
static inline void mul_mmt(const double* A, const double* B, double* C) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) C[3 * i + j] = dot3(A + 3 * i, B + 3 * j);
}
#endif
