/* One implicit step of the reduced body as the minimum of an incremental energy E(c, R, q),
 *
 *   E = M |c - c^|^2 / 2h^2 + zeta^T tr(S) zeta / 2h^2 - <R, sum_a zeta_a W_a>          (inertia)
 *     + q^T K q / 2 + k_c (q - u)^T K (q - u) / 2 + b (q - q_1)^T K (q - q_1) / 2h      (elastic)
 *     + h sum_s [rho C_d |v.a|^3 / 6 |a|^2 + rho C_f |a| (|v|^2 + e)^{3/2} / 6],        (drag)
 *
 * with W_a = (2 R_1 P_a(zeta_1)^T - R_0 P_a(zeta_0)^T) / h^2 and the area vectors a lagged, so that
 * the step stays a minimisation. The rotation is updated by R <- exp([t]) R from wherever the
 * iterate stands, so no attitude is special. docs/kernel.md derives the blocks of the Hessian. */
#include "euler.h"

size_t work_lay(Work* w, const Parts* parts, double* memory) {
  const Body* b = &parts->body;
  const size_t r = b->r, kp = b->kp, np = b->np, nf = parts->feet.np, nc = contacts_of(parts);
  Arena arena = {memory, 0}, *a = &arena;
  w->body = b, w->par = parts->model->par, w->feet = parts->feet, w->terrain = parts->terrain;
  w->m = -1, w->reference = NULL, w->friction = parts->terrain.friction;
  Config* all[3] = {&w->now, &w->one, &w->two};
  for (int i = 0; i < 3; i++) {
    all[i]->zeta = take(a, (1 + r) * kp), all[i]->dz = memory ? all[i]->zeta + kp : NULL;
  }
  w->scratch = take(a, kinematics_scratch(b)), w->scratch_lagged = take(a, kinematics_scratch(b));
  w->P = take(a, 9 * kp), w->W = take(a, 9 * kp), w->W_turn = take(a, 3 * kp), w->gz = take(a, kp);
  w->tangents.tangent1 = take(a, 3 * np), w->tangents.tangent2 = take(a, 3 * np);
  w->area_local = take(a, 3 * np), w->area = take(a, 3 * np);
  w->local_one = take(a, 3 * np), w->y_one = take(a, 3 * np);
  w->local = take(a, (1 + r) * 3 * np), w->y = take(a, 3 * np), w->Jq = take(a, r * 3 * np);
  w->f = take(a, 3 * np), w->back = take(a, 3 * np), w->D = take(a, 6 * np);
  w->turned = take(a, 3 * np), w->D_turned = take(a, 3 * np), w->DJ = take(a, r * 3 * np);
  w->feet_y = take(a, 3 * nf), w->feet_f = take(a, 3 * nf), w->feet_Jq = take(a, r * 3 * nf);
  w->touch_before = take(a, 3 * nc), w->touch_lagged = take(a, 3 * nc);
  w->touch_now = take(a, 3 * nc), w->touch_local = take(a, 3 * nc);
  w->touch_field = take(a, kp * 3 * nc), w->touch_y = take(a, 3 * nc);
  w->touch_f = take(a, 3 * nc), w->touch_Jq = take(a, r * 3 * nc);
  w->touch_D = take(a, 9 * nc), w->touch_F = take(a, 9 * nc);
  w->along = take(a, kp), w->along_T = take(a, 9 * kp);
  w->now_P = take(a, 9 * kp), w->along_P = take(a, 9 * kp);
  w->along_local = take(a, 3 * np), w->along_y = take(a, 3 * np);
  w->gp = take(a, 3 * np), w->ga = take(a, 3 * np), w->pull_local = take(a, 9 * np);
  return arena.used;
}

static void set_config(Config* cfg, const Pose* pose) {
  memcpy(cfg->c, pose->c, sizeof cfg->c), memcpy(cfg->quat, pose->quat, sizeof cfg->quat);
  memcpy(cfg->q, pose->q, sizeof cfg->q);
  quat_matrix(cfg->quat, cfg->R);
}

void work_begin(Work* w, const double* origin, const Pose* before, const Pose* last,
                const double* u, double h) {
  w->u = u, w->h = h, w->origin = origin, w->m = -1, w->reference = NULL;
  set_config(&w->one, last), set_config(&w->two, before);
}

void work_set(Work* w, const Pose* now) { set_config(&w->now, now); }

/* --- what depends on the last two configurations only */

/* c^ = 2 c_1 - c_0 + h^2 gravity; W, to which the potential -M g d R_zz of righting is added */
static void prepare_inertia(Work* w, int derivatives) {
  const Body* b = w->body;
  const int kp = b->kp;
  const double h = w->h, ih2 = 1 / (h * h);
  memset(w->W, 0, sizeof(double) * 9 * kp);
  for (int t = 0; t < 2; t++) {
    Config* cfg = t ? &w->two : &w->one;
    kinematics(b, cfg->q, derivatives, cfg->zeta, w->scratch_lagged);
    moments_apply(b, 1, cfg->zeta, w->P);
    moments_turn((t ? -1 : 2) * ih2, cfg->R, w->P, kp, w->W);
  }
  for (int i = 0; i < 3; i++) w->guess[i] = 2 * w->one.c[i] - w->two.c[i];
  w->guess[2] += h * h * w->par[DP_GRAVITY];
  w->W[8 * kp] += b->mass * STANDARD_GRAVITY * w->par[DP_RIGHTING];
}

/* Places and area vectors of the drag points at the last configuration. */
static void prepare_drag(Work* w) {
  const Body* b = w->body;
  const Config* one = &w->one;
  field_apply(b, b->points, 1, one->zeta, b->np, w->local_one);
  rotate(one->R, w->local_one, b->np, w->y_one);
  drag_areas(b, one->R, one->zeta, w->tangents, w->area_local, w->area);
}

void work_prepare(Work* w, int derivatives) {
  prepare_inertia(w, derivatives);
  if (terrain_parts(&w->terrain)) contact_prepare(w);
  if (has_drag(w->body, w->par)) prepare_drag(w);
}

/* --- energy, gradient and Hessian, term by term; H's upper triangle until it is mirrored */

/* E = M |c - c^|^2 / 2h^2: g_c = M (c - c^)/h^2, H_cc = M/h^2 */
static double add_translation(Work* w) {
  const double m = w->body->mass / (w->h * w->h);
  const int n = 6 + w->body->r;
  double e = 0;
  for (int i = 0; i < 3; i++) {
    const double d = w->now.c[i] - w->guess[i];
    e += .5 * m * d * d, w->g[i] = m * d, w->H[i * n + i] = m;
  }
  return e;
}

/* E = zeta^T tr(S) zeta / 2h^2 - <R, sum_a zeta_a W_a>, tr S = 1 (for a > 0) with row tr S_0a:
 * gz_a = (tr S_0a + zeta_a)/h^2 - <R, W_a>; W_turn; N = sum_a zeta_a W_a R^T; g_t = -vee(N) */
static double add_rotation(Work* w) {
  const Body* b = w->body;
  const int kp = b->kp;
  const double ih2 = 1 / (w->h * w->h), *R = w->now.R, *zeta = w->now.zeta;
  double e = 0, Rt[3][9], Wz[9], turn[3];
  for (int m = 0; m < 3; m++) skew_mul((double[3]){m == 0, m == 1, m == 2}, R, Rt[m]);
  double *restrict t0 = w->W_turn, *restrict t1 = t0 + kp, *restrict t2 = t1 + kp, *gz = w->gz;
  for (int a = 0; a < kp; a++) {
    double s = 0, s0 = 0, s1 = 0, s2 = 0;
    for (int i = 0; i < 9; i++) {
      const double W = w->W[i * kp + a];
      s += R[i] * W, s0 += Rt[0][i] * W, s1 += Rt[1][i] * W, s2 += Rt[2][i] * W;
    }
    gz[a] = ih2 * (b->trace[a] + zeta[a]) - s, t0[a] = -s0, t1[a] = -s1, t2[a] = -s2;
    e += .5 * ih2 * (2 * b->trace[a] + zeta[a]) * zeta[a] - s * zeta[a];
  }
  moments_pair(w->W, zeta, kp, Wz);
  mul_mmt(Wz, R, w->N);
  vee(w->N, turn);
  for (int i = 0; i < 3; i++) w->g[3 + i] = -turn[i];
  return e;
}

/* Elasticity, control, damping: g_q = K (q + k_c (q - u) + b (q - q_1)/h),
 * H_qq = K (1 + k_c + b/h);
 * inertia through dz: g_q += dz^T gz, H_qq += dz^T dz / h^2, H_tq = W_turn dz */
static double add_modes(Work* w) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, n = 6 + r;
  const double ih2 = 1 / (w->h * w->h), kc = w->par[DP_CONTROL], beta = w->par[DP_DAMPING] / w->h;
  const double* dz = w->now.dz;
  double e = 0, *H = w->H;
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c], q = w->now.q[c], du = q - w->u[c], dq = q - w->one.q[c];
    e += .5 * K * (q * q + kc * du * du + beta * dq * dq);
    w->g[6 + c] = K * (q + kc * du + beta * dq) + inner(dz + c * kp, w->gz, kp);
    H[(6 + c) * n + 6 + c] = K * (1 + kc + beta);
    for (int d = c; d < r; d++)
      H[(6 + c) * n + 6 + d] += ih2 * inner(dz + c * kp, dz + d * kp, kp);
    for (int m = 0; m < 3; m++)
      H[(3 + m) * n + 6 + c] = inner(w->W_turn + m * kp, dz + c * kp, kp);
  }
  return e;
}

/* H += J^T D J over the drag points, J = (1, -[y], Jq): the columns of D J, then J^T of each */
static void drag_hessian(Work* w) {
  static const int at[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  const int r = w->body->r, np = w->body->np, n = 6 + r;
  const double *D = w->D, *y = w->y;
  double turn[3], *H = w->H;
  for (int i = 0; i < 3; i++)
    for (int j = i; j < 3; j++) H[i * n + j] += sum(D + at[i][j] * np, np);
  for (int m = 0; m < 3; m++) {
    turn_column(m, y, np, w->turned);
    drag_apply(1, D, w->turned, np, w->D_turned);
    sum_cross(y, w->D_turned, np, turn);
    for (int i = 0; i < 3; i++) H[i * n + 3 + m] += sum(w->D_turned + i * np, np);
    for (int i = 0; i <= m; i++) H[(3 + i) * n + 3 + m] += turn[i];
  }
  for (int c = 0; c < r; c++) {
    double* DJ = w->DJ + c * 3 * np;
    drag_apply(1, D, w->Jq + c * 3 * np, np, DJ);
    sum_cross(y, DJ, np, turn);
    for (int i = 0; i < 3; i++)
      H[i * n + 6 + c] += sum(DJ + i * np, np), H[(3 + i) * n + 6 + c] += turn[i];
    for (int d = 0; d <= c; d++)
      H[(6 + d) * n + 6 + c] += inner(w->Jq + d * 3 * np, DJ, 3 * np);
  }
}

/* Drag: a force on points that also depends on where they are. */
static double add_drag(Work* w) {
  const Body* b = w->body;
  const int r = b->r, np = b->np;
  field_apply(b, b->points, 1 + r, w->now.zeta, np, w->local); /* places, then by q */
  rotate(w->now.R, w->local, np, w->y);
  for (int c = 0; c < r; c++)
    rotate(w->now.R, w->local + (1 + c) * 3 * np, np, w->Jq + c * 3 * np);
  for (int i = 0; i < 3; i++) w->dc[i] = w->now.c[i] - w->one.c[i];
  const double e = drag_forces(b, w->par, w->h, w->dc, w->y_one, w->y, w->area, w->f, w->D);
  point_forces(w, b->points, np, w->y, w->Jq, w->f, w->back);
  drag_hessian(w);
  return e;
}

/* Second derivatives of the rotation and of zeta(q), all of whose factors are in N and gz by now:
 * H_tt += tr N - (N + N^T)/2, H_qq += sum_a gz_a d2 zeta_a / dq2 */
static void add_curvature(Work* w) {
  const int r = w->body->r, rp = w->body->rp, n = 6 + r;
  const double *N = w->N, trace = N[0] + N[4] + N[8];
  double curvature[DP_MAX_MODES * DP_MAX_MODES] = {0}, *H = w->H;
  for (int i = 0; i < 3; i++)
    for (int j = i; j < 3; j++)
      H[(3 + i) * n + 3 + j] -= .5 * (N[3 * i + j] + N[3 * j + i]) - (i == j ? trace : 0);
  kinematics_curvature(w->body, w->gz, w->scratch, curvature);
  for (int c = 0; c < r; c++)
    for (int d = c; d < r; d++) H[(6 + c) * n + 6 + d] += curvature[c * rp + d];
}

void work_assemble(Work* w) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, n = 6 + r;
  const int forces = w->feet.n || terrain_parts(&w->terrain);
  *w->spent += kp * ((1 + r) * (b->nf + 3. * b->np) + 9 * kp + 3 * b->nc * (1 + r));
  kinematics(b, w->now.q, 1, w->now.zeta, w->scratch);
  memset(w->H, 0, sizeof(double) * n * n);
  w->energy = add_translation(w);
  w->energy += add_rotation(w);
  w->energy += add_modes(w);
  if (has_drag(b, w->par)) w->energy += add_drag(w);
  if (forces) w->energy += forces_evaluate(w);
  add_curvature(w);
  for (int i = 0; i < n; i++)
    for (int j = 0; j < i; j++) w->H[i * n + j] = w->H[j * n + i];
  if (forces) forces_hessian(w);
}
