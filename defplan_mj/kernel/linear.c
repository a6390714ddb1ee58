/* Small dense linear algebra of the Newton iterations. */
#include "work.h"

/* L of A = L L^T (row-major, lower); 0 if A is not positive definite. */
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
