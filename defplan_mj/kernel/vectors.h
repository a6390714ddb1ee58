/* Loops over whole vectors of numbers, which fill a machine's vector registers, and where such
 * vectors lie in memory. Points and forces are structures of arrays: x of all, then y, then z. */
#ifndef DEFPLAN_VECTORS_H
#define DEFPLAN_VECTORS_H
#include "internal.h"

/* Memory that vectors are taken from, one after the other, each on a boundary of PAD doubles.
 * Without memory (NULL) nothing is given out and only counted: the same lines lay out and
 * measure. */
typedef struct {
  double* memory;
  size_t used;
} Arena;
static inline double* take(Arena* arena, size_t n) {
  double* here = arena->memory ? arena->memory + arena->used : NULL;
  arena->used += (n + PAD - 1) / PAD * PAD;
  return here;
}
/* The first address of 64 bytes in memory that has PAD doubles to spare. */
static inline double* aligned(double* memory) { return (double*)(((size_t)memory + 63) / 64 * 64); }

/* --- out (m x n) = A B: A_ik = a[i row + k col], B (inner x n) and out with rows n apart, n a
 * multiple of 8. Sums are kept in registers (six rows of eight columns fill the sixteen that AVX2
 * and most others have): this is where a step spends its time. */
enum { LANES = 4 };
typedef double Vec __attribute__((vector_size(8 * LANES), may_alias));
typedef double AnyVec
    __attribute__((vector_size(8 * LANES), may_alias, aligned(8))); /* anywhere in memory */

static inline __attribute__((always_inline)) void multiply_block(int rows, const double* a, int row,
                                                                 int col, const double* b,
                                                                 int inner, int n, double* out) {
  Vec sums[6][2];
  for (int i = 0; i < rows; i++) sums[i][0] = sums[i][1] = (Vec){0};
  for (int k = 0; k < inner; k++) {
    const Vec left = *(const AnyVec*)(b + (size_t)k * n),
              right = *(const AnyVec*)(b + (size_t)k * n + LANES);
    for (int i = 0; i < rows; i++) {
      const double factor = a[(size_t)i * row + (size_t)k * col];
      sums[i][0] += factor * left, sums[i][1] += factor * right;
    }
  }
  for (int i = 0; i < rows; i++) {
    *(AnyVec*)(out + (size_t)i * n) = sums[i][0],
                                 *(AnyVec*)(out + (size_t)i * n + LANES) = sums[i][1];
  }
}
/* One row: up to eight vectors of columns at once, so that the sums do not wait for each other. */
static inline __attribute__((always_inline)) void multiply_row_block(const int vectors,
                                                                     const double* a, int col,
                                                                     const double* b, int inner,
                                                                     int n, double* out) {
  Vec sums[8];
  for (int v = 0; v < vectors; v++) sums[v] = (Vec){0};
  for (int k = 0; k < inner; k++) {
    const double factor = a[(size_t)k * col];
    for (int v = 0; v < vectors; v++)
      sums[v] += factor * *(const AnyVec*)(b + (size_t)k * n + LANES * v);
  }
  for (int v = 0; v < vectors; v++) *(AnyVec*)(out + LANES * v) = sums[v];
}
static inline void multiply_row(const double* a, int col, const double* b, int inner, int n,
                                double* out) {
  int j = 0;
  for (; j + 32 <= n; j += 32) multiply_row_block(8, a, col, b + j, inner, n, out + j);
  switch (n - j) {
    case 8: multiply_row_block(2, a, col, b + j, inner, n, out + j); break;
    case 16: multiply_row_block(4, a, col, b + j, inner, n, out + j); break;
    case 24: multiply_row_block(6, a, col, b + j, inner, n, out + j); break;
  }
}
static inline void multiply(int m, const double* a, int row, int col, const double* b, int inner,
                            int n, double* out) {
  if (m == 1) {
    multiply_row(a, col, b, inner, n, out);
    return;
  }
  for (int j = 0; j < n;
       j += 8) /* columns outside: those of B stay near while the rows of A pass */
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

/* out[i stride + j] += a_i . b_j for rows a_i (m) and b_j (n) of `length` numbers, a multiple of
 * 8. */
static inline __attribute__((always_inline)) void products_block(int rows, const double* a,
                                                                 const double* b, int length,
                                                                 double* out, int stride) {
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
static inline void products(const double* a, int m, const double* b, int n, int length, double* out,
                            int stride) {
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

/* out (3 x n) = R in, points or vectors as structure of arrays */
static inline void rotate(const double* R, const double* restrict in, int n, double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[3 * i], b = R[3 * i + 1], c = R[3 * i + 2];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static inline void rotate_back(const double* R, const double* restrict in, int n,
                               double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[i], b = R[3 + i], c = R[6 + i];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static inline double sum(const double* restrict a, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i];
  return s;
}
static inline double inner(const double* restrict a, const double* restrict b, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i] * b[i];
  return s;
}
/* The largest size of a number; infinity if one is not finite. */
static inline double largest_of(const double* a, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s = fabs(a[i]) <= s ? s : isfinite(a[i]) ? fabs(a[i]) : INFINITY;
  return s;
}
/* sum over points of a x b */
static inline void sum_cross(const double* restrict a, const double* restrict b, int n,
                             double* out) {
  double x = 0, y = 0, z = 0;
  for (int s = 0; s < n; s++) {
    x += a[n + s] * b[2 * n + s] - a[2 * n + s] * b[n + s];
    y += a[2 * n + s] * b[s] - a[s] * b[2 * n + s];
    z += a[s] * b[n + s] - a[n + s] * b[s];
  }
  out[0] = x, out[1] = y, out[2] = z;
}
#endif
