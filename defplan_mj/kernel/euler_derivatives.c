/* Exact derivatives of the implicit Euler step's equations dE/dQ = 0.
 *
 * For a vector lambda over the increments (c, t, q) take the scalar L = lambda . dE/dQ, the
 * derivative of E along the motion w = lambda_c + lambda_t x y + R Phi dz lambda_q of the points,
 *
 *   L = sum_v m w.(p - 2 p_1 + p_0)/h^2 - sum_s w.(F(p, p_1, a_1) + F_contact + f_feet)
 *     + lambda_q . K [q + k_c (q - u) + b (q - q_1)/h],
 *
 * and differentiate it by what it has of the last two configurations: places, area vectors, q. */
#include "euler.h"

void euler_linearise(Work* w, const Pose* next) {
  work_prepare(w, 1);
  work_set(w, next);
  work_assemble(w);
}

/* T_ij,a = sum_v m w_i Phi_a,j / h^2 of the points' motion w along lambda, without lambda_c:
 * [lambda_t] R P(zeta) + R P(along) */
static void moments_along(Work* w, const double* lambda) {
  const Body* b = w->body;
  const double ih2 = 1 / (w->h * w->h);
  double turned[9];
  skew_mul(lambda + 3, w->now.R, turned);
  memset(w->along_T, 0, sizeof(double) * 9 * b->kp);
  moments_apply(b, 1, w->now.zeta, w->now_P);
  moments_turn(ih2, turned, w->now_P, b->kp, w->along_T);
  moments_apply(b, 1, w->along, w->along_P);
  moments_turn(ih2, w->now.R, w->along_P, b->kp, w->along_T);
}

/* L = factor sum m w.p_i / h^2 by configuration i: c, turn (vee of sum m w y_i^T), zeta */
static void inertia_mixed(const Work* w, const Config* cfg, double factor, const double* lambda,
                          double* out, double* gz) {
  const double m = w->body->mass / (w->h * w->h);
  double Tz[9], wy[9];
  for (int i = 0; i < 3; i++) out[i] = factor * m * lambda[i];
  moments_pair(w->along_T, cfg->zeta, w->body->kp, Tz);
  mul_mmt(Tz, cfg->R, wy);
  vee(wy, out + 3);
  for (int i = 0; i < 3; i++) out[3 + i] *= factor;
  moments_contract(factor, cfg->R, w->along_T, w->body->kp, gz);
}

/* L = -sum w.F by the last configuration: dL/dp_1 = -D w, D = -dF/dp, and by area vectors */
static void drag_mixed(Work* w, const double* lambda, double* out, double* gz) {
  const Body* b = w->body;
  const Config* one = &w->one;
  const int np = b->np;
  points_along(b, b->points, w->now.R, w->y, lambda, w->along, np, w->along_local, w->along_y);
  drag_apply(-1, w->D, w->along_y, np, w->gp);
  drag_area_gradient(b, w->par, 1, w->h, w->dc, w->y_one, w->y, w->area, w->along_y, w->ga);
  drag_pull(b, one->R, w->y_one, w->area, w->tangents, w->gp, w->ga, w->pull_local, out, gz);
}

void euler_pull(Work* w, const double* lambda, double* a1, double* a0, double* au) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp;
  double gz1[MAX_ZETA] = {0}, gz0[MAX_ZETA] = {0};
  modes_along(b, w->now.dz, lambda + 6, w->along);
  moments_along(w, lambda);
  inertia_mixed(w, &w->one, -2, lambda, a1, gz1);
  inertia_mixed(w, &w->two, 1, lambda, a0, gz0);
  if (has_drag(b, w->par)) drag_mixed(w, lambda, a1, gz1);
  forces_mixed(w, lambda, a1, gz1, au);
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c] * lambda[6 + c];
    a1[6 + c] = inner(w->one.dz + c * kp, gz1, kp) - K * w->par[DP_DAMPING] / w->h;
    a0[6 + c] = inner(w->two.dz + c * kp, gz0, kp);
    au[c] = -K * w->par[DP_CONTROL];
  }
}
