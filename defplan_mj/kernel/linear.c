/* Small dense linear algebra of the Newton iterations. */
#include "linear.h"

int cholesky(const double* A, int n, double* L) {
  for (int j = 0; j < n; j++) {
    double s = A[j * n + j];
    for (int t = 0; t < j; t++) s -= L[j * n + t] * L[j * n + t];
    if (!(s > 1e-12 * fabs(A[j * n + j]))) return 0;
    const double d = sqrt(s), id = 1 / d;
    L[j * n + j] = d;
    for (int i = j + 1; i < n; i++) {
      double q = A[i * n + j];
      for (int t = 0; t < j; t++) q -= L[i * n + t] * L[j * n + t];
      L[i * n + j] = q * id;
    }
  }
  return 1;
}
void cholesky_solve(const double* L, int n, const double* rhs, double* x) {
  for (int i = 0; i < n; i++) {
    double q = rhs[i];
    for (int t = 0; t < i; t++) q -= L[i * n + t] * x[t];
    x[i] = q / L[i * n + i];
  }
  for (int i = n - 1; i >= 0; i--) {
    double q = x[i];
    for (int t = i + 1; t < n; t++) q -= L[t * n + i] * x[t];
    x[i] = q / L[i * n + i];
  }
}

int lu(double* A, int n, int* pivot, int* sign) {
  *sign = 1;
  for (int c = 0; c < n; c++) {
    int best = c;
    for (int i = c + 1; i < n; i++)
      if (fabs(A[i * n + c]) > fabs(A[best * n + c])) best = i;
    pivot[c] = best;
    if (!(fabs(A[best * n + c]) > 1e-300)) return 0;
    if (best != c) {
      for (int j = 0; j < n; j++) {
        const double t = A[c * n + j];
        A[c * n + j] = A[best * n + j], A[best * n + j] = t;
      }
      *sign = -*sign;
    }
    if (A[c * n + c] < 0) *sign = -*sign;
    const double inverse = 1 / A[c * n + c], *restrict top = A + c * n;
    for (int i = c + 1; i < n; i++) {
      double* restrict row = A + i * n;
      const double l = row[c] *= inverse;
      for (int j = c + 1; j < n; j++) row[j] -= l * top[j];
    }
  }
  return 1;
}
void lu_solve(const double* LU, const int* pivot, int n, const double* rhs, double* x) {
  memcpy(x, rhs, sizeof(double) * n);
  for (int i = 0; i < n; i++) {
    const double t = x[pivot[i]];
    x[pivot[i]] = x[i], x[i] = t;
  }
  for (int i = 1; i < n; i++)
    for (int j = 0; j < i; j++) x[i] -= LU[i * n + j] * x[j];
  for (int i = n - 1; i >= 0; i--) {
    for (int j = i + 1; j < n; j++) x[i] -= LU[i * n + j] * x[j];
    x[i] /= LU[i * n + i];
  }
}
void lu_solve_transposed(const double* LU, const int* pivot, int n, const double* rhs, double* x) {
  memcpy(x, rhs, sizeof(double) * n);
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < i; j++) x[i] -= LU[j * n + i] * x[j];
    x[i] /= LU[i * n + i];
  }
  for (int i = n - 1; i >= 0; i--)
    for (int j = i + 1; j < n; j++) x[i] -= LU[j * n + i] * x[j];
  for (int i = n - 1; i >= 0; i--) {
    const double t = x[pivot[i]];
    x[pivot[i]] = x[i], x[i] = t;
  }
}

int factorise(Factors* f, const double* A, int n, int symmetric) {
  f->n = n, f->symmetric = symmetric, f->sign = 1;
  if (symmetric) return cholesky(A, n, f->A);
  int sign;
  memcpy(f->A, A, sizeof(double) * n * n);
  const int done = lu(f->A, n, f->pivot, &sign);
  f->sign = sign;
  return done;
}
void solve(const Factors* f, const double* rhs, double* x) {
  if (f->symmetric) cholesky_solve(f->A, f->n, rhs, x);
  else lu_solve(f->A, f->pivot, f->n, rhs, x);
}
void solve_transposed(const Factors* f, const double* rhs, double* x) {
  if (f->symmetric) cholesky_solve(f->A, f->n, rhs, x);
  else lu_solve_transposed(f->A, f->pivot, f->n, rhs, x);
}
