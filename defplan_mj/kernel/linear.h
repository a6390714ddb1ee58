/* Small dense systems of the Newton iterations (linear.c). */
#ifndef DEFPLAN_LINEAR_H
#define DEFPLAN_LINEAR_H
#include "internal.h"

/* LU of A with row pivots, in place; 0 if it is singular; the sign of its determinant in *sign. */
int lu(double* A, int n, int* pivot, int* sign);
void lu_solve(const double* LU, const int* pivot, int n, const double* rhs, double* x);
void lu_solve_transposed(const double* LU, const int* pivot, int n, const double* rhs, double* x);
/* L of A = L L^T (row-major, lower); 0 if A is not positive definite. */
int cholesky(const double* A, int n, double* L);
void cholesky_solve(const double* L, int n, const double* rhs, double* x);
/* Factors of a matrix: symmetric and definite, or any; factorise returns 0 if it is singular. */
typedef struct {
  double A[MAX_N * MAX_N];
  int n, symmetric, pivot[MAX_N];
  int sign; /* of the determinant */
} Factors;
int factorise(Factors* f, const double* A, int n, int symmetric);
void solve(const Factors* f, const double* rhs, double* x);
void solve_transposed(const Factors* f, const double* rhs, double* x);
#endif
