/* From modal coordinates to the body's shape (kinematics.c): zeta(q) = (1, z(q)), and the linear
 * maps over the basis that make places and moments of it. A point is at y = sum_a zeta_a Phi_a from
 * the centre of mass, body axes. */
#ifndef DEFPLAN_KINEMATICS_H
#define DEFPLAN_KINEMATICS_H
#include "parts.h"
#include "vectors.h"

/* zeta(q), kp, and behind it dz/dq, r x kp, if `derivatives`. `scratch` holds
 * kinematics_scratch(b) doubles and is read again by kinematics_curvature. */
size_t kinematics_scratch(const Body* b);
void kinematics(const Body* b, const double* q, int derivatives, double* zeta, double* scratch);
/* hess (r x rp) += sum_a grad[a] d2 zeta_a / dq2, after kinematics with derivatives at q */
void kinematics_curvature(const Body* b, const double* grad, double* scratch, double* hess);

/* out (m x 9 x kp): P_ij,a = sum_v m Phi_a,i y_j = sum_b S_ab,ij zeta_b, for m rows of zeta */
void moments_apply(const Body* b, int m, const double* zeta, double* out);
/* N_ij = P_ij . zeta = sum_v m y'_i y_j for the moments P of one shape and another's zeta */
static inline void moments_pair(const double* P, const double* zeta, int kp, double* N) {
  memset(N, 0, 9 * sizeof(double));
  products(zeta, 1, P, 9, kp, N, 9);
}
/* out = A N B^T: such an N to the world, A and B the attitudes of the two */
void to_world(const double* A, const double* N, const double* B, double* out);
/* T_ij,a += factor sum_m A_im P_jm,a = factor sum_v m (A y)_i Phi_a,j: y to the world by A */
void moments_turn(double factor, const double* A, const double* P, int kp, double* T);
/* out[a] += factor sum_ij A_ij T_ij,a */
void moments_contract(double factor, const double* A, const double* T, int kp, double* out);

/* out (m x 3 x n): sum_a zeta_ma field[a][i][s], a <= k, for a field kp x 3 x n */
void field_apply(const Body* b, const double* field, int m, const double* zeta, int n, double* out);
/* out[a] += sum_i,s field[a][i][s] v[i][s], a <= k */
void field_transpose(const Body* b, const double* field, const double* v, int n, double* out);
/* Gradient g (3 x n, world) by the places c + y of points of a field, y = R Phi zeta -> add to
 * those by c and turn (out, 6) and by zeta (gz). `local` 3 n is overwritten. */
void places_pull(const Body* b, const double* field, const double* R, const double* y,
                 const double* g, int n, double* local, double* out, double* gz);

/* out[a] = sum_c lambda[c] dz[c][a]: the motion of zeta along modal coordinates */
void modes_along(const Body* b, const double* dz, const double* lambda, double* out);
/* out (3 x n) = l_c + l_t x y + R Phi along: the motion of points of a field along lambda,
 * whose first parts are l_c and l_t; `along` is that of zeta. `local` 3 n is overwritten. */
void points_along(const Body* b, const double* field, const double* R, const double* y,
                  const double* lambda, const double* along, int n, double* local, double* out);

/* J (3 x ROW) = (1, -[y], Jq) of a point at y from the centre; columns of both `stride` apart. */
void point_jacobian(const double* y, const double* Jq, int r, int stride, double J[3][ROW]);
/* sums (n x ROW) += J1^T D J2 */
void point_product(double J1[3][ROW], const double* D, double J2[3][ROW], int n, double* sums);
#endif
