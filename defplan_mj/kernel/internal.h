/* What the kernel's files share: the body as a view of its blob, small 3-vector algebra, the
 * quantities of one configuration. Arrays over basis functions (index 0 is the rest shape) are
 * padded to kp, arrays over drag patches to np, modal arrays to rp: multiples of 8, so that the
 * compiler fills whole vectors without a remainder. */
#ifndef DEFPLAN_INTERNAL_H
#define DEFPLAN_INTERNAL_H
#include <math.h>
#include <string.h>

#include "kernel.h"

#define BLOB_MAGIC 20181018.0
#define BLOB_VERSION 2.0
enum { HEADER = 16, PAD = 8 };

typedef struct {
  int r, k, n_samples, n_patches, n_surface, n_contacts; /* true sizes */
  int rp, kp, nf, np, ns, nc; /* padded: modes, basis + 1, features, patches, surface, contacts */
  double mass, radius;                       /* kg; bound of |y| at rest, m */
  const double *stiffness;                   /* rp */
  const double *features;                    /* 9 x r x samples: q -> skew 3, strain 6 */
  const double *weights_t;                   /* nf (9 x samples) x kp: transposed weights, column 0 is zero */
  const double *weights;                     /* kp x nf */
  const double *moments;                     /* kp(b) x 9(i,j) x kp(a): S_ab */
  const double *trace;                       /* kp: tr S_0a */
  const double *points;                      /* kp x 3 x np: patch centres */
  const double *tangent1, *tangent2;         /* kp x 3 x np */
  const double *areas;                       /* np */
  const double *surface;                     /* kp x 3 x ns */
  const double *contacts;                    /* kp x 3 x nc: points that can touch the terrain */
} Body;

/* Whether a number of a header counts something: 0, 1, ... most. */
static inline int is_count(double x, double most) { return x >= 0 && x <= most && x == floor(x); }
static inline int is_finite(const double* a, size_t n) {
  int all = 1;
  for (size_t i = 0; i < n; i++) all &= isfinite(a[i]) != 0;
  return all;
}

/* View a blob of n doubles: 0, or a negative code if its header or its size is wrong. The numbers behind the
 * header are not looked at: dp_check_model does that once, where a model is loaded. */
int body_view(Body* b, const double* blob, size_t n);
/* The same, taking the size from the blob itself. */
int body_view_own(Body* b, const double* blob);

/* Points of the body that take given forces. */
typedef struct {
  int n, np;           /* true and padded number */
  const double* field; /* kp x 3 x np */
} Feet;

int feet_view(Feet* f, const Body* b, const double* feet, size_t n);

/* What the body can touch (terrain.c). */
typedef struct {
  double friction;  /* coefficient */
  double stiffness; /* N/m^2: normal force of a point at depth d below the rounding, stiffness d^2 */
  double thickness; /* m: contact begins at this distance */
  double slip;      /* m/s: rounds Coulomb's law at rest */
  double damping;   /* s/m: how the normal force grows with the speed of the approach */
  int n_geoms, rows, columns;
  double centre[3], half[2], top; /* heightfield: x y of its centre, z of height 0; extent; largest height */
  const double* geoms;        /* n_geoms x (type, size 3, pos 3, mat 9) = n_geoms x 16 */
  const double* coefficients; /* rows (y) x columns (x): cubic B-spline of the heights */
} Terrain;

enum { TERRAIN_GEOM = 16 }; /* numbers of a geom in it */
int terrain_view(Terrain* t, const double* terrain, size_t n);
/* One part of the terrain at p: a smooth gap, its gradient and Hessian (gradient, hessian may be NULL).
 * Parts are the geoms, then the heightfield, whose gap is vertical: divide by |gradient| for a distance. */
static inline int terrain_parts(const Terrain* t) { return t->n_geoms + (t->rows > 0); }
double terrain_gap(const Terrain* t, int part, const double p[3], double* gradient, double* hessian);
double geom_gap(const dp_geom* g, const double p[3], double* normal, double* hessian);

/* One configuration: c, orientation, q, and what follows from q. */
typedef struct {
  double c[3], quat[4], R[9];
  const double* q;
  double *zeta; /* kp: (1, z) */
  double *dz;   /* r x kp: dz/dq; right behind zeta */
} Config;

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
    out[j] = w[1] * z - w[2] * y, out[3 + j] = w[2] * x - w[0] * z, out[6 + j] = w[0] * y - w[1] * x;
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

/* --- out (m x n) = A B: A_ik = a[i row + k col], B (inner x n) and out with rows n apart, n a
 * multiple of 8. Sums are kept in registers (six rows of eight columns fill the sixteen that AVX2 and
 * most others have): this is where a step spends its time. */
enum { LANES = 4 };
typedef double Vec __attribute__((vector_size(8 * LANES), may_alias));
typedef double AnyVec __attribute__((vector_size(8 * LANES), may_alias, aligned(8))); /* anywhere in memory */

static inline __attribute__((always_inline)) void multiply_block(int rows, const double* a, int row, int col,
                                                                 const double* b, int inner, int n,
                                                                 double* out) {
  Vec sums[6][2];
  for (int i = 0; i < rows; i++) sums[i][0] = sums[i][1] = (Vec){0};
  for (int k = 0; k < inner; k++) {
    const Vec left = *(const AnyVec*)(b + (size_t)k * n), right = *(const AnyVec*)(b + (size_t)k * n + LANES);
    for (int i = 0; i < rows; i++) {
      const double factor = a[(size_t)i * row + (size_t)k * col];
      sums[i][0] += factor * left, sums[i][1] += factor * right;
    }
  }
  for (int i = 0; i < rows; i++) {
    *(AnyVec*)(out + (size_t)i * n) = sums[i][0], *(AnyVec*)(out + (size_t)i * n + LANES) = sums[i][1];
  }
}
/* One row: four blocks of columns at once, so that the sums do not wait for each other. */
static inline void multiply_row(const double* a, int col, const double* b, int inner, int n, double* out) {
  int j = 0;
  for (; j + 32 <= n; j += 32) {
    Vec sums[8];
    for (int v = 0; v < 8; v++) sums[v] = (Vec){0};
    for (int k = 0; k < inner; k++) {
      const double factor = a[(size_t)k * col];
      for (int v = 0; v < 8; v++) sums[v] += factor * *(const AnyVec*)(b + (size_t)k * n + j + LANES * v);
    }
    for (int v = 0; v < 8; v++) *(AnyVec*)(out + j + LANES * v) = sums[v];
  }
  for (; j < n; j += 8) multiply_block(1, a, 0, col, b + j, inner, n, out + j);
}
static inline void multiply(int m, const double* a, int row, int col, const double* b, int inner, int n,
                            double* out) {
  if (m == 1) {
    multiply_row(a, col, b, inner, n, out);
    return;
  }
  for (int j = 0; j < n; j += 8) /* columns outside: those of B stay near while the rows of A pass */
    for (int i = 0, rows; i < m; i += rows) {
      const double *A = a + (size_t)i * row, *B = b + j;
      double* o = out + (size_t)i * n + j;
      rows = m - i > 6 ? (m - i < 10 ? 5 : 6) : m - i;
      switch (rows) { /* constant arguments: the loops unroll */
#define BLOCK(R) case R: multiply_block(R, A, row, col, B, inner, n, o); break;
        BLOCK(1) BLOCK(2) BLOCK(3) BLOCK(4) BLOCK(5) BLOCK(6)
#undef BLOCK
      }
    }
}

/* out[i stride + j] += a_i . b_j for rows a_i (m) and b_j (n) of `length` numbers, a multiple of 8. */
static inline __attribute__((always_inline)) void products_block(int rows, const double* a, const double* b,
                                                                 int length, double* out, int stride) {
  Vec sums[2][4];
  for (int i = 0; i < rows; i++)
    for (int j = 0; j < 4; j++) sums[i][j] = (Vec){0};
  for (int k = 0; k < length; k += LANES)
    for (int i = 0; i < rows; i++) {
      const Vec left = *(const AnyVec*)(a + (size_t)i * length + k);
      for (int j = 0; j < 4; j++) sums[i][j] += left * *(const AnyVec*)(b + (size_t)j * length + k);
    }
  for (int i = 0; i < rows; i++)
    for (int j = 0; j < 4; j++)
      for (int lane = 0; lane < LANES; lane++) out[i * stride + j] += sums[i][j][lane];
}
static inline void products(const double* a, int m, const double* b, int n, int length, double* out, int stride) {
  int i = 0;
  for (; i < m; i += 2) {
    const int rows = m - i < 2 ? 1 : 2;
    const double* A = a + (size_t)i * length;
    double* o = out + i * stride;
    int j = 0;
    for (; j + 4 <= n; j += 4) {
      if (rows == 2) products_block(2, A, b + (size_t)j * length, length, o + j, stride);
      else products_block(1, A, b + (size_t)j * length, length, o + j, stride);
    }
    for (; j < n; j++)
      for (int row = 0; row < rows; row++) {
        const double *restrict x = A + (size_t)row * length, *restrict y = b + (size_t)j * length;
        double s = 0;
        for (int k = 0; k < length; k++) s += x[k] * y[k];
        o[row * stride + j] += s;
      }
  }
}

/* --- rotation-strain coordinates (kinematics.c) */
/* zeta(q), kp, and behind it dz/dq, r x kp, if `derivatives`. `scratch` holds
 * kinematics_scratch(b) doubles and is read again by kinematics_curvature. */
size_t kinematics_scratch(const Body* b);
void kinematics(const Body* b, const double* q, int derivatives, double* zeta, double* scratch);
/* hess (r x rp) += sum_a grad[a] d2 zeta_a / dq2, after kinematics with derivatives at the same q */
void kinematics_curvature(const Body* b, const double* grad, double* scratch, double* hess);
/* out (m x 9 x kp): P_a,ij = sum_b S_ab,ij zeta_b for m rows of zeta (m x kp) */
void moments_apply(const Body* b, int m, const double* zeta, double* out);
/* out (m x 3 x n): sum_a zeta_ma field[a][i][s], a <= k, for a field kp x 3 x n */
void field_apply(const Body* b, const double* field, int m, const double* zeta, int n, double* out);
/* out[a] += sum_i,s field[a][i][s] v[i][s], a <= k */
void field_transpose(const Body* b, const double* field, const double* v, int n, double* out);
#endif
