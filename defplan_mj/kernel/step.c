/* One implicit step of the reduced body as the minimum of an incremental energy E(c, R, q),
 *
 *   E = M |c - c^|^2 / 2h^2 + zeta^T tr(S) zeta / 2h^2 - <R, sum_a zeta_a W_a>          (inertia)
 *     + q^T K q / 2 + k_c (q - u)^T K (q - u) / 2 + b (q - q_i)^T K (q - q_i) / 2h      (elastic)
 *     + h sum_s [rho C_d |v.a|^3 / 6 |a|^2 + rho C_f |a| (|v|^2 + e)^{3/2} / 6],        (drag)
 *
 * with W_a = (2 R_i P_a(zeta_i)^T - R_{i-1} P_a(zeta_{i-1})^T) / h^2 and the area vectors a lagged,
 * so that the step stays a minimisation. The rotation is updated by R <- exp([t]) R from wherever
 * the iterate stands, so no attitude is special. The previous configuration is recomputed from the
 * velocities: a saved state replays to the bit. Derivatives by the implicit function theorem. */
#include "internal.h"

static const double SPEED2 = 1e-4; /* m^2/s^2: rounds the tangential drag at rest */
static const double STANDARD_GRAVITY = 9.81;
static const double MAX_TURN = .7; /* rad or units of q in one Newton step */

enum { MAX_N = 6 + DP_MAX_MODES };

typedef struct {
  double* next;
} Arena;

static double* take(Arena* arena, size_t n) {
  double* p = arena->next;
  arena->next += (n + PAD - 1) / PAD * PAD;
  return p;
}

/* What a step needs in memory; everything is taken from one array on the caller's stack. */
typedef struct {
  const Body* body;
  const double *par, *u;
  Config now, one, two; /* the iterate, the last configuration, the one before */
  double q_two[DP_MAX_MODES], q_now[DP_MAX_MODES];
  double guess[3];                  /* c^ */
  double *scratch, *scratch_lagged; /* kinematics */
  double *P, *W;                    /* 9 x kp */
  double *before, *area, *cn, *ct;  /* 3 np, 3 np, np, np: lagged drag quantities */
  double *body_points, *w, *f, *D;  /* (1 + r) x 3 np, 3 np, 3 np, 6 np */
  double *Jq, *DJ;                  /* r x 3 np */
  double *gzeta, *Wg;               /* kp, 9 x kp */
  double energy, g[MAX_N], H[MAX_N * MAX_N];
} Work;

static size_t work_size(const Body* b) {
  size_t kp = b->kp, np = b->np, r = b->r, k3 = kinematics_scratch(b);
  return PAD + 3 * (1 + r) * kp + 2 * (k3 + PAD) + 9 * kp * 2 + 3 * np * 2 + 2 * np + 3 * np * (3 + r) + 6 * np +
         2 * (r * 3 * np) + kp + 9 * kp;
}

static void work_init(Work* w, double* memory, const Body* b, const double* par, const double* u) {
  Arena arena = {(double*)(((size_t)memory + 63) / 64 * 64)};
  size_t kp = b->kp, np = b->np, r = b->r;
  w->body = b, w->par = par, w->u = u;
  Config* all[3] = {&w->now, &w->one, &w->two};
  for (int i = 0; i < 3; i++) all[i]->zeta = take(&arena, (1 + r) * kp), all[i]->dz = all[i]->zeta + kp;
  w->scratch = take(&arena, kinematics_scratch(b)), w->scratch_lagged = take(&arena, kinematics_scratch(b));
  w->P = take(&arena, 9 * kp), w->W = take(&arena, 9 * kp);
  w->before = take(&arena, 3 * np), w->area = take(&arena, 3 * np);
  w->cn = take(&arena, np), w->ct = take(&arena, np);
  w->body_points = take(&arena, (1 + r) * 3 * np), w->w = take(&arena, 3 * np), w->f = take(&arena, 3 * np);
  w->D = take(&arena, 6 * np);
  w->Jq = take(&arena, r * 3 * np), w->DJ = take(&arena, r * 3 * np);
  w->gzeta = take(&arena, kp), w->Wg = take(&arena, 9 * kp);
}
#define WORK(w, b, par, u)              \
  double memory_of_##w[work_size(b)];   \
  Work w;                               \
  work_init(&w, memory_of_##w, b, par, u)

/* out (3 x n) = R in, points or vectors as structure of arrays */
static void rotate(const double* R, const double* restrict in, int n, double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[3 * i], b = R[3 * i + 1], c = R[3 * i + 2];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static void rotate_back(const double* R, const double* restrict in, int n, double* restrict out) {
  for (int i = 0; i < 3; i++) {
    const double a = R[i], b = R[3 + i], c = R[6 + i];
    for (int s = 0; s < n; s++) out[i * n + s] = a * in[s] + b * in[n + s] + c * in[2 * n + s];
  }
}
static double sum(const double* restrict a, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i];
  return s;
}
static double inner(const double* restrict a, const double* restrict b, int n) {
  double s = 0;
  for (int i = 0; i < n; i++) s += a[i] * b[i];
  return s;
}
/* sum over points of a x b */
static void sum_cross(const double* restrict a, const double* restrict b, int n, double* out) {
  double x = 0, y = 0, z = 0;
  for (int s = 0; s < n; s++) {
    x += a[n + s] * b[2 * n + s] - a[2 * n + s] * b[n + s];
    y += a[2 * n + s] * b[s] - a[s] * b[2 * n + s];
    z += a[s] * b[n + s] - a[n + s] * b[s];
  }
  out[0] = x, out[1] = y, out[2] = z;
}

/* The configuration of state x, and the one before it from the velocities. */
static void unpack(Work* w, const double* x) {
  const int r = w->body->r;
  const double h = w->par[DP_TIMESTEP], *v = x + 7 + r, *omega = v + 3, *qdot = v + 6;
  Config *one = &w->one, *two = &w->two;
  memcpy(one->c, x, sizeof one->c), memcpy(one->quat, x + 3, sizeof one->quat);
  quat_normalize(one->quat);
  one->q = x + 7, two->q = w->q_two;
  double turn[3], back[4];
  for (int i = 0; i < 3; i++) two->c[i] = x[i] - h * v[i], turn[i] = -h * omega[i];
  quat_exp(turn, back);
  quat_mul(one->quat, back, two->quat);
  for (int c = 0; c < r; c++) w->q_two[c] = x[7 + c] - h * qdot[c];
  quat_matrix(one->quat, one->R), quat_matrix(two->quat, two->R);
}

/* Everything of a step that depends on the last two configurations only. With `derivatives`,
 * dz of both as well. */
static void prepare(Work* w, int derivatives) {
  const Body* b = w->body;
  const int kp = b->kp, np = b->np;
  const double h = w->par[DP_TIMESTEP], ih2 = 1 / (h * h);
  for (int i = 0; i < 9 * kp; i++) w->W[i] = 0;
  for (int t = 0; t < 2; t++) {
    Config* cfg = t ? &w->two : &w->one;
    const double factor = (t ? -1 : 2) * ih2;
    kinematics(b, cfg->q, derivatives, cfg->zeta, w->scratch_lagged);
    moments_apply(b, cfg->zeta, w->P);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        double* restrict Wij = w->W + (3 * i + j) * kp;
        for (int m = 0; m < 3; m++) {
          const double f = factor * cfg->R[3 * i + m], *restrict P = w->P + (3 * j + m) * kp;
          for (int a = 0; a < kp; a++) Wij[a] += f * P[a];
        }
      }
  }
  for (int i = 0; i < 3; i++) w->guess[i] = 2 * w->one.c[i] - w->two.c[i];
  w->guess[2] += h * h * w->par[DP_GRAVITY];
  w->W[8 * kp] += b->mass * STANDARD_GRAVITY * w->par[DP_RIGHTING]; /* potential -M g D R_zz */
  if (!np || w->par[DP_FLUID_DENSITY] == 0) return;

  /* patch centres and area vectors of the last configuration */
  double *t1 = w->Jq, *t2 = w->DJ; /* not yet in use */
  field_apply(b, b->points, 1, w->one.zeta, np, w->body_points);
  rotate(w->one.R, w->body_points, np, w->before);
  for (int i = 0; i < 3; i++)
    for (int s = 0; s < np; s++) w->before[i * np + s] += w->one.c[i];
  field_apply(b, b->tangent1, 1, w->one.zeta, np, t1);
  field_apply(b, b->tangent2, 1, w->one.zeta, np, t2);
  double *restrict n = w->f, *restrict area = w->area;
  for (int s = 0; s < np; s++) {
    n[s] = b->areas[s] * (t1[np + s] * t2[2 * np + s] - t1[2 * np + s] * t2[np + s]);
    n[np + s] = b->areas[s] * (t1[2 * np + s] * t2[s] - t1[s] * t2[2 * np + s]);
    n[2 * np + s] = b->areas[s] * (t1[s] * t2[np + s] - t1[np + s] * t2[s]);
  }
  rotate(w->one.R, n, np, area);
  const double rho = w->par[DP_FLUID_DENSITY];
  for (int s = 0; s < np; s++) {
    /* padding has no area, and must have no drag */
    double A2 = area[s] * area[s] + area[np + s] * area[np + s] + area[2 * np + s] * area[2 * np + s];
    w->cn[s] = .5 * rho * w->par[DP_DRAG_NORMAL] / (A2 + 1e-20);
    w->ct[s] = .5 * rho * w->par[DP_DRAG_TANGENT] * sqrt(A2);
  }
}

/* Drag forces f on the patches at the iterate; D = -df/dp (xx xy xz yy yz zz); returns the energy. */
static double drag(Work* w) {
  const int n = w->body->np;
  const double h = w->par[DP_TIMESTEP], ih = 1 / h, *c = w->now.c;
  const double *restrict p = w->w, *restrict p0 = w->before, *restrict a = w->area;
  const double *restrict cn = w->cn, *restrict ct = w->ct;
  double *restrict f = w->f, *restrict D = w->D, e = 0;
  for (int s = 0; s < n; s++) {
    double vx = (c[0] + p[s] - p0[s]) * ih, vy = (c[1] + p[n + s] - p0[n + s]) * ih;
    double vz = (c[2] + p[2 * n + s] - p0[2 * n + s]) * ih;
    double ax = a[s], ay = a[n + s], az = a[2 * n + s];
    double vn = vx * ax + vy * ay + vz * az, av = fabs(vn), v2 = vx * vx + vy * vy + vz * vz + SPEED2;
    double speed = sqrt(v2), fn = cn[s] * av * vn, ft = ct[s] * speed;
    f[s] = -fn * ax - ft * vx, f[n + s] = -fn * ay - ft * vy, f[2 * n + s] = -fn * az - ft * vz;
    double dn = 2 * cn[s] * av * ih, dt = ct[s] / speed * ih, d0 = ft * ih;
    D[s] = dn * ax * ax + dt * vx * vx + d0, D[n + s] = dn * ax * ay + dt * vx * vy;
    D[2 * n + s] = dn * ax * az + dt * vx * vz, D[3 * n + s] = dn * ay * ay + dt * vy * vy + d0;
    D[4 * n + s] = dn * ay * az + dt * vy * vz, D[5 * n + s] = dn * az * az + dt * vz * vz + d0;
    e += cn[s] * av * vn * vn + ct[s] * v2 * speed;
  }
  return h * e / 3;
}

/* out (3 x n) = D v for the symmetric D of drag */
static void apply_drag_matrix(const double* restrict D, const double* restrict v, int n, double* restrict out) {
  for (int s = 0; s < n; s++) {
    double x = v[s], y = v[n + s], z = v[2 * n + s];
    out[s] = D[s] * x + D[n + s] * y + D[2 * n + s] * z;
    out[n + s] = D[n + s] * x + D[3 * n + s] * y + D[4 * n + s] * z;
    out[2 * n + s] = D[2 * n + s] * x + D[4 * n + s] * y + D[5 * n + s] * z;
  }
}

/* Energy, gradient and Hessian at the iterate w->now, in (c, t, q) with R = exp([t]) R_now. */
static void assemble(Work* w) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, rp = b->rp, np = b->np, n = 6 + r;
  const double h = w->par[DP_TIMESTEP], ih2 = 1 / (h * h), *R = w->now.R;
  double *g = w->g, *H = w->H, *zeta = w->now.zeta, *dz = w->now.dz, e = 0;
  kinematics(b, w->now.q, 1, zeta, w->scratch);
  memset(H, 0, sizeof(double) * n * n);

  /* inertia; trace: 0, 1 x 1 block (1, z): S_00, S_0a, identity */
  for (int i = 0; i < 3; i++) {
    double d = w->now.c[i] - w->guess[i];
    e += .5 * ih2 * b->mass * d * d, g[i] = ih2 * b->mass * d, H[i * n + i] = ih2 * b->mass;
  }
  double* gz = w->gzeta; /* dE/dzeta, first the inertia's part */
  double Rw[3][9];
  for (int m = 0; m < 3; m++) {
    double axis[3] = {m == 0, m == 1, m == 2};
    skew_mul(axis, R, Rw[m]);
  }
  double* restrict turn[3] = {w->Wg, w->Wg + kp, w->Wg + 2 * kp}; /* d2 E / dt dzeta, inertia */
  for (int a = 0; a < kp; a++) {
    double s = 0, t0 = 0, t1 = 0, t2 = 0;
    for (int i = 0; i < 9; i++) {
      double W = w->W[i * kp + a];
      s += R[i] * W, t0 += Rw[0][i] * W, t1 += Rw[1][i] * W, t2 += Rw[2][i] * W;
    }
    gz[a] = ih2 * (b->trace[a] + zeta[a]) - s, turn[0][a] = -t0, turn[1][a] = -t1, turn[2][a] = -t2;
    e += .5 * ih2 * (2 * b->trace[a] + zeta[a]) * zeta[a] - s * zeta[a];
  }
  double N[9]; /* sum_a zeta_a W_a R^T, then the point forces' part */
  double Wz[9];
  for (int i = 0; i < 9; i++) Wz[i] = inner(w->W + i * kp, zeta, kp);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(Wz + 3 * i, R + 3 * j);
  vee(N, g + 3);
  for (int i = 0; i < 3; i++) g[3 + i] = -g[3 + i];

  /* modal: elasticity, control, damping, inertia through dz */
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c], q = w->now.q[c], du = q - w->u[c], dq = q - w->one.q[c];
    const double kc = w->par[DP_CONTROL], beta = w->par[DP_DAMPING] / h;
    e += .5 * K * (q * q + kc * du * du + beta * dq * dq);
    g[6 + c] = K * (q + kc * du + beta * dq) + inner(dz + c * kp, gz, kp);
    H[(6 + c) * n + 6 + c] = K * (1 + kc + beta);
    for (int d = c; d < r; d++) H[(6 + c) * n + 6 + d] += ih2 * inner(dz + c * kp, dz + d * kp, kp);
    for (int m = 0; m < 3; m++) H[(3 + m) * n + 6 + c] = inner(turn[m], dz + c * kp, kp);
  }

  if (np && w->par[DP_FLUID_DENSITY] != 0) {
    field_apply(b, b->points, 1 + r, zeta, np, w->body_points); /* points, then their modal derivatives */
    rotate(R, w->body_points, np, w->w);
    e += drag(w);
    const double *restrict D = w->D, *restrict p = w->w, *restrict f = w->f;
    double *back = w->DJ, torque[3]; /* R^T f, before DJ is in use */
    for (int i = 0; i < 3; i++) g[i] -= sum(f + i * np, np);
    sum_cross(p, f, np, torque);
    for (int i = 0; i < 3; i++) g[3 + i] -= torque[i];
    rotate_back(R, f, np, back);
    for (int s = 0; s < 3 * np; s++) back[s] = -back[s];
    field_transpose(b, b->points, back, np, gz);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) N[3 * i + j] += inner(f + i * np, p + j * np, np);
    /* columns: translation, rotation t x p, modes R B dz; H += J^T D J */
    static const int at[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
    for (int i = 0; i < 3; i++)
      for (int j = i; j < 3; j++) H[i * n + j] += sum(D + at[i][j] * np, np);
    double* restrict DJ = w->DJ;
    for (int m = 0; m < 3; m++) { /* column m of the rotation: e_m x p */
      double* restrict col = w->body_points; /* not needed any more */
      const int m1 = (m + 1) % 3, m2 = (m + 2) % 3;
      for (int s = 0; s < np; s++)
        col[m * np + s] = 0, col[m1 * np + s] = -p[m2 * np + s], col[m2 * np + s] = p[m1 * np + s];
      apply_drag_matrix(D, col, np, DJ);
      double torque_row[3];
      sum_cross(p, DJ, np, torque_row);
      for (int i = 0; i < 3; i++) H[i * n + 3 + m] += sum(DJ + i * np, np);
      for (int i = 0; i <= m; i++) H[(3 + i) * n + 3 + m] += torque_row[i];
    }
    for (int c = 0; c < r; c++) {
      double *Jc = w->Jq + c * 3 * np, *DJc = w->DJ + c * 3 * np;
      rotate(R, w->body_points + (1 + c) * 3 * np, np, Jc);
      apply_drag_matrix(D, Jc, np, DJc);
      double torque_row[3], bend[3];
      sum_cross(p, DJc, np, torque_row), sum_cross(Jc, f, np, bend);
      g[6 + c] -= inner(Jc, f, 3 * np);
      for (int i = 0; i < 3; i++) {
        H[i * n + 6 + c] += sum(DJc + i * np, np);
        H[(3 + i) * n + 6 + c] += torque_row[i] - bend[i];
      }
      for (int d = 0; d <= c; d++) H[(6 + d) * n + 6 + c] += inner(w->Jq + d * 3 * np, DJc, 3 * np);
    }
  }

  /* second derivatives of the rotation (exp at 0) and of zeta(q) */
  const double tr = N[0] + N[4] + N[8];
  for (int i = 0; i < 3; i++)
    for (int j = i; j < 3; j++)
      H[(3 + i) * n + 3 + j] -= .5 * (N[3 * i + j] + N[3 * j + i]) - (i == j ? tr : 0);
  double curvature[DP_MAX_MODES * DP_MAX_MODES] = {0};
  kinematics_curvature(b, gz, w->scratch, curvature);
  for (int c = 0; c < r; c++)
    for (int d = c; d < r; d++) H[(6 + c) * n + 6 + d] += curvature[c * rp + d];
  for (int i = 0; i < n; i++)
    for (int j = 0; j < i; j++) H[i * n + j] = H[j * n + i];
  w->energy = e;
}

/* L of A = L L^T (row-major, lower); 0 if A is not positive definite. */
static int cholesky(const double* A, int n, double* L) {
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
static void cholesky_solve(const double* L, int n, const double* rhs, double* x) {
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

static void move(Work* w, const Config* from, const double* q_from, const double* step, double alpha) {
  Config* now = &w->now;
  double turn[3], dq[4];
  for (int i = 0; i < 3; i++) now->c[i] = from->c[i] - alpha * step[i], turn[i] = -alpha * step[3 + i];
  quat_exp(turn, dq);
  quat_mul(dq, from->quat, now->quat);
  quat_normalize(now->quat);
  quat_matrix(now->quat, now->R);
  for (int c = 0; c < w->body->r; c++) w->q_now[c] = q_from[c] - alpha * step[6 + c];
}

/* Newton with an energy line search from w->now; returns 1 if it converged. */
static int minimise(Work* w, dp_info* info) {
  const int n = 6 + w->body->r, limit = (int)w->par[DP_MAX_NEWTON];
  const double tolerance = w->par[DP_TOLERANCE], scale = w->body->mass / (w->par[DP_TIMESTEP] * w->par[DP_TIMESTEP]);
  double step[MAX_N], L[MAX_N * MAX_N];
  assemble(w);
  for (info->iterations = 1; info->iterations <= limit; info->iterations++) {
    /* where E is not convex, raise the diagonal just far enough: a larger shift would only crawl */
    double diagonal[MAX_N], shift = 0;
    for (int i = 0; i < n; i++) diagonal[i] = fabs(w->H[i * n + i]) + 1e-6 * scale;
    while (!cholesky(w->H, n, L)) {
      const double next = shift ? 3 * shift : 1e-4;
      if (next > 1e12) return 0;
      for (int i = 0; i < n; i++) w->H[i * n + i] += (next - shift) * diagonal[i];
      shift = next;
    }
    cholesky_solve(L, n, w->g, step);
    double largest = 0, turn = 0, slope = inner(w->g, step, n);
    for (int i = 0; i < n; i++) {
      largest = fmax(largest, fabs(step[i]));
      if (i >= 3) turn = fmax(turn, fabs(step[i]));
    }
    info->residual = largest;
    if (!(largest < 1e100)) return 0;
    Config from = w->now;
    double q_from[DP_MAX_MODES], energy = w->energy;
    memcpy(q_from, w->q_now, sizeof(double) * w->body->r);
    if (largest < tolerance) { /* quadratic convergence: after this step nothing is left */
      move(w, &from, q_from, step, 1);
      return 1;
    }
    double alpha = turn > MAX_TURN ? MAX_TURN / turn : 1;
    for (int halvings = 0;; halvings++) {
      move(w, &from, q_from, step, alpha);
      assemble(w);
      if (w->energy <= energy - 1e-4 * alpha * slope + 1e-11 * fabs(energy) + 1e-10) break;
      if (halvings == 30) return 0;
      alpha *= .5;
    }
  }
  return 0;
}

static void pack(const Work* w, double* x_next) {
  const int r = w->body->r;
  const double ih = 1 / w->par[DP_TIMESTEP];
  const Config *now = &w->now, *one = &w->one;
  double back[4] = {one->quat[0], -one->quat[1], -one->quat[2], -one->quat[3]}, turn[4], omega[3];
  quat_mul(back, now->quat, turn);
  quat_log(turn, omega);
  double *v = x_next + 7 + r;
  for (int i = 0; i < 3; i++) {
    v[i] = (now->c[i] - one->c[i]) * ih, v[3 + i] = omega[i] * ih;
    x_next[i] = now->c[i];
  }
  memcpy(x_next + 3, now->quat, sizeof now->quat);
  for (int c = 0; c < r; c++) v[6 + c] = (w->q_now[c] - one->q[c]) * ih, x_next[7 + c] = w->q_now[c];
}

static int step(const Body* b, const double* par, const double* x, const double* u, double* x_next,
                dp_info* info) {
  WORK(w, b, par, u);
  unpack(&w, x);
  prepare(&w, 0);
  /* start from the free motion; the shape, which stiffness and control hold back, half way */
  const double h = par[DP_TIMESTEP], *v = x + 7 + b->r;
  double step0[MAX_N], turn[3];
  mul_mv(w.one.R, v + 3, turn);
  for (int i = 0; i < 3; i++) step0[i] = w.one.c[i] - w.guess[i], step0[3 + i] = -h * turn[i];
  for (int c = 0; c < b->r; c++) step0[6 + c] = -.5 * h * v[6 + c];
  w.now.q = w.q_now;
  move(&w, &w.one, w.one.q, step0, 1);
  dp_info local;
  if (!info) info = &local;
  info->failed = !minimise(&w, info);
  pack(&w, x_next);
  return info->failed;
}

int dp_step(const double* blob, const double* par, const double* x, const double* u, double* x_next,
            dp_info* info) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return 1;
  return step(&b, par, x, u, x_next, info);
}

int dp_rollout(const double* blob, const double* par, int N, const double* u, double* xs, long* iterations) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return N;
  const int nx = 13 + 2 * b.r;
  int failed = 0;
  long count = 0;
  for (int i = 0; i < N; i++) {
    dp_info info;
    failed += step(&b, par, xs + (size_t)i * nx, u + (size_t)i * b.r, xs + (size_t)(i + 1) * nx, &info);
    count += info.iterations;
  }
  if (iterations) *iterations = count;
  return failed;
}

/* --- derivatives ------------------------------------------------------------------------------ */

/* a1, a2 (6 + r), au (r): gradients of lambda . dE/dQ with respect to the last configuration, the
 * one before (both in world tangent coordinates) and u; after assemble at the solution. */
static void mixed(Work* w, const double* lambda, double* a1, double* a2, double* au) {
  const Body* b = w->body;
  const int r = b->r, kp = b->kp, np = b->np;
  const double h = w->par[DP_TIMESTEP], ih2 = 1 / (h * h);
  double* dz = w->gzeta; /* motion of zeta along lambda */
  for (int a = 0; a < kp; a++) dz[a] = 0;
  for (int c = 0; c < r; c++)
    for (int a = 0; a < kp; a++) dz[a] += lambda[6 + c] * w->now.dz[c * kp + a];
  double Rl[9];
  skew_mul(lambda + 3, w->now.R, Rl);
  /* T_b = sum_v m_v w_v Phi_b^T for the motion w of the vertices along lambda, over h^2 */
  double* T = w->Wg;
  for (int i = 0; i < 9 * kp; i++) T[i] = 0;
  for (int t = 0; t < 2; t++) {
    const double* A = t ? w->now.R : Rl;
    moments_apply(b, t ? dz : w->now.zeta, w->P);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        double* restrict Tij = T + (3 * i + j) * kp;
        for (int m = 0; m < 3; m++) {
          const double f = ih2 * A[3 * i + m], *restrict P = w->P + (3 * j + m) * kp;
          for (int a = 0; a < kp; a++) Tij[a] += f * P[a];
        }
      }
  }
  double gz[DP_MAX_BASIS + 1 + PAD], Tz[9], N[9];
  for (int t = 0; t < 2; t++) {
    const Config* cfg = t ? &w->two : &w->one;
    const double factor = t ? 1 : -2;
    double* out = t ? a2 : a1;
    for (int i = 0; i < 3; i++) out[i] = factor * ih2 * b->mass * lambda[i];
    for (int i = 0; i < 9; i++) Tz[i] = factor * inner(T + i * kp, cfg->zeta, kp);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(Tz + 3 * i, cfg->R + 3 * j);
    vee(N, out + 3);
    for (int a = 0; a < kp; a++) {
      double s = 0;
      for (int i = 0; i < 9; i++) s += cfg->R[i] * T[i * kp + a];
      gz[a] = factor * s;
    }
    if (t == 0 && np && w->par[DP_FLUID_DENSITY] != 0) {
      const double *a = w->area, *p = w->w, *p0 = w->before, ih = 1 / h, *R = cfg->R;
      double *restrict dp = w->body_points, *restrict gp = w->f, *restrict ga = w->DJ;
      double* yd = w->D; /* the Hessian is done with it */
      field_apply(b, b->points, 1, dz, np, yd);
      rotate(w->now.R, yd, np, dp);
      const double* l = lambda;
      for (int s = 0; s < np; s++) {
        double x = p[s], y = p[np + s], z = p[2 * np + s];
        dp[s] += l[0] + l[4] * z - l[5] * y;
        dp[np + s] += l[1] + l[5] * x - l[3] * z;
        dp[2 * np + s] += l[2] + l[3] * y - l[4] * x;
        double v[3], n[3], d[3];
        for (int i = 0; i < 3; i++) {
          v[i] = (w->now.c[i] + p[i * np + s] - p0[i * np + s]) * ih;
          n[i] = a[i * np + s], d[i] = dp[i * np + s];
        }
        double A2 = dot3(n, n) + 1e-20, A = sqrt(A2), vn = dot3(v, n), av = fabs(vn), tau = dot3(n, d);
        double vd = dot3(v, d), speed = sqrt(dot3(v, v) + SPEED2), cn = w->cn[s], ct = w->ct[s];
        for (int i = 0; i < 3; i++) {
          double gv = 2 * cn * av * tau * n[i] + ct * (v[i] * vd / speed + speed * d[i]);
          ga[i * np + s] = cn * (2 * av * v[i] * tau + vn * av * d[i] - 2 * vn * av * tau * n[i] / A2) +
                           ct / A * speed * vd * n[i] / A;
          gp[i * np + s] = -ih * gv;
        }
      }
      double turn[3];
      for (int i = 0; i < 3; i++) out[i] += sum(gp + i * np, np);
      double* arm = w->D; /* p0 - c0 */
      for (int i = 0; i < 3; i++)
        for (int s = 0; s < np; s++) arm[i * np + s] = p0[i * np + s] - cfg->c[i];
      sum_cross(arm, gp, np, turn);
      for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
      sum_cross(a, ga, np, turn);
      for (int i = 0; i < 3; i++) out[3 + i] += turn[i];
      double* local = w->D;
      rotate_back(R, gp, np, local);
      field_transpose(b, b->points, local, np, gz);
      /* area vector A0 R (t1 x t2): d/dt1 = A0 t2 x R^T g, d/dt2 = A0 R^T g x t1 */
      double *t1 = w->body_points, *t2 = w->f, *gt = w->DJ;
      rotate_back(R, ga, np, local);
      field_apply(b, b->tangent1, 1, cfg->zeta, np, t1);
      field_apply(b, b->tangent2, 1, cfg->zeta, np, t2);
      for (int s = 0; s < np; s++) {
        double A0 = b->areas[s], g[3], x1[3], x2[3], o1[3], o2[3];
        for (int i = 0; i < 3; i++) g[i] = A0 * local[i * np + s], x1[i] = t1[i * np + s], x2[i] = t2[i * np + s];
        cross3(x2, g, o1), cross3(g, x1, o2);
        for (int i = 0; i < 3; i++) gt[i * np + s] = o1[i], t1[i * np + s] = o2[i];
      }
      field_transpose(b, b->tangent1, gt, np, gz);
      field_transpose(b, b->tangent2, t1, np, gz);
    }
    for (int c = 0; c < r; c++) out[6 + c] = inner(cfg->dz + c * kp, gz, kp);
  }
  for (int c = 0; c < r; c++) {
    const double K = b->stiffness[c];
    a1[6 + c] -= K * w->par[DP_DAMPING] / h * lambda[6 + c];
    au[c] = -K * w->par[DP_CONTROL] * lambda[6 + c];
  }
}

/* A solved step, ready for its derivatives: the Hessian at x_next and its factor L. */
static int linearise(Work* w, const double* x, const double* x_next, double* L) {
  const int r = w->body->r, n = 6 + r;
  unpack(w, x);
  prepare(w, 1);
  memcpy(w->now.c, x_next, sizeof w->now.c), memcpy(w->now.quat, x_next + 3, sizeof w->now.quat);
  quat_normalize(w->now.quat);
  quat_matrix(w->now.quat, w->now.R);
  memcpy(w->q_now, x_next + 7, sizeof(double) * r);
  w->now.q = w->q_now;
  assemble(w);
  return cholesky(w->H, n, L);
}

/* Gradient g_next over x_next -> gradient over the new configuration (out, 6 + r) and what goes
 * straight to the last one (direct, 6 + r), both in tangent coordinates. */
static void pull_output(const Work* w, const double* x_next, const double* g_next, double* out, double* direct) {
  const int r = w->body->r;
  const double ih = 1 / w->par[DP_TIMESTEP], *gq = g_next + 3, *gv = g_next + 7 + r, *qn = w->now.quat;
  double J[9], turn[3], t[3], omega[3], cr[3];
  for (int i = 0; i < 3; i++) {
    out[i] = g_next[i] + gv[i] * ih, direct[i] = -gv[i] * ih;
    omega[i] = x_next[7 + r + 3 + i] / ih;
  }
  cross3(qn + 1, gq + 1, cr);
  so3_left_jacobian(omega, 1, J);
  mul_mtv(J, gv + 3, t);
  mul_mv(w->one.R, t, turn);
  for (int i = 0; i < 3; i++) {
    double g_turn = ih * turn[i];
    out[3 + i] = .5 * (-gq[0] * qn[1 + i] + qn[0] * gq[1 + i] + cr[i]) + g_turn, direct[3 + i] = -g_turn;
  }
  for (int c = 0; c < r; c++)
    out[6 + c] = g_next[7 + c] + gv[6 + c] * ih, direct[6 + c] = -gv[6 + c] * ih;
}

/* Gradients over the last two configurations (tangent) -> gradient over the state x. */
static void pull_input(const Work* w, const double* x, const double* g1, const double* g2, double* gx) {
  const int r = w->body->r;
  const double h = w->par[DP_TIMESTEP], *omega = x + 7 + r + 3;
  double* gv = gx + 7 + r;
  double back[3] = {-h * omega[0], -h * omega[1], -h * omega[2]}, J[9], local[3], g[3], t[3];
  for (int i = 0; i < 3; i++) gx[i] = g1[i] + g2[i], gv[i] = -h * g2[i], g[i] = g1[3 + i] + g2[3 + i];
  so3_left_jacobian(back, 0, J);
  mul_mtv(w->one.R, g2 + 3, local);
  mul_mtv(J, local, t);
  for (int i = 0; i < 3; i++) gv[3 + i] = -h * t[i];
  const double* q = x + 3; /* as given, not normalised */
  double norm2 = q[0] * q[0] + dot3(q + 1, q + 1), cr[3];
  cross3(q + 1, g, cr);
  gx[3] = -2 * dot3(g, q + 1) / norm2;
  for (int i = 0; i < 3; i++) gx[4 + i] = 2 * (q[0] * g[i] - cr[i]) / norm2;
  for (int c = 0; c < r; c++) gx[7 + c] = g1[6 + c] + g2[6 + c], gv[6 + c] = -h * g2[6 + c];
}

static int adjoint(const Body* b, const double* par, const double* x, const double* u, const double* x_next,
                   const double* g_next, double* gx, double* gu) {
  const int n = 6 + b->r;
  double L[MAX_N * MAX_N], out[MAX_N], direct[MAX_N], lambda[MAX_N], a1[MAX_N], a2[MAX_N];
  WORK(w, b, par, u);
  if (!linearise(&w, x, x_next, L)) {
    memset(gx, 0, sizeof(double) * (13 + 2 * b->r)), memset(gu, 0, sizeof(double) * b->r);
    return 1;
  }
  pull_output(&w, x_next, g_next, out, direct);
  cholesky_solve(L, n, out, lambda);
  mixed(&w, lambda, a1, a2, gu);
  for (int i = 0; i < n; i++) a1[i] = direct[i] - a1[i], a2[i] = -a2[i];
  for (int c = 0; c < b->r; c++) gu[c] = -gu[c];
  pull_input(&w, x, a1, a2, gx);
  return 0;
}

int dp_step_adj(const double* blob, const double* par, const double* x, const double* u, const double* x_next,
                const double* g_next, double* gx, double* gu) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return 1;
  return adjoint(&b, par, x, u, x_next, g_next, gx, gu);
}

int dp_step_jac(const double* blob, const double* par, const double* x, const double* u, const double* x_next,
                double* A, double* B) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return 1;
  const int r = b.r, n = 6 + r, nx = 13 + 2 * r;
  double L[MAX_N * MAX_N], M1[MAX_N * MAX_N], M2[MAX_N * MAX_N], Mu[MAX_N * DP_MAX_MODES];
  WORK(w, &b, par, u);
  if (!linearise(&w, x, x_next, L)) return 1;
  for (int i = 0; i < n; i++) { /* rows: lambda = e_i */
    double unit[MAX_N] = {0};
    unit[i] = 1;
    mixed(&w, unit, M1 + i * n, M2 + i * n, Mu + i * r);
  }
  for (int o = 0; o < nx; o++) {
    double seed[13 + 2 * DP_MAX_MODES] = {0}, out[MAX_N], direct[MAX_N], lambda[MAX_N], g1[MAX_N], g2[MAX_N];
    seed[o] = 1;
    pull_output(&w, x_next, seed, out, direct);
    cholesky_solve(L, n, out, lambda);
    for (int j = 0; j < n; j++) {
      g1[j] = direct[j], g2[j] = 0;
      for (int i = 0; i < n; i++) g1[j] -= lambda[i] * M1[i * n + j], g2[j] -= lambda[i] * M2[i * n + j];
    }
    for (int c = 0; c < r; c++) {
      double s = 0;
      for (int i = 0; i < n; i++) s -= lambda[i] * Mu[i * r + c];
      B[o * r + c] = s;
    }
    pull_input(&w, x, g1, g2, A + (size_t)o * nx);
  }
  return 0;
}

int dp_rollout_adj(const double* blob, const double* par, int N, const double* u, const double* xs, double* gxs,
                   double* gu) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return N;
  const int r = b.r, nx = 13 + 2 * r;
  int failed = 0;
  double gx[13 + 2 * DP_MAX_MODES];
  for (int i = N - 1; i >= 0; i--) {
    failed += adjoint(&b, par, xs + (size_t)i * nx, u + (size_t)i * r, xs + (size_t)(i + 1) * nx,
                      gxs + (size_t)(i + 1) * nx, gx, gu + (size_t)i * r);
    for (int j = 0; j < nx; j++) gxs[(size_t)i * nx + j] += gx[j];
  }
  return failed;
}

/* --- measures of a state ----------------------------------------------------------------------- */

void dp_energy(const double* blob, const double* par, const double* x, double out[9]) {
  Body b;
  memset(out, 0, 9 * sizeof(double));
  if (body_view(&b, blob, (size_t)blob[2])) return;
  WORK(w, &b, par, x);
  unpack(&w, x);
  const int kp = b.kp;
  const double h = par[DP_TIMESTEP], ih = 1 / h, *v = x + 7 + b.r;
  kinematics(&b, w.one.q, 0, w.one.zeta, w.scratch);
  kinematics(&b, w.two.q, 0, w.two.zeta, w.scratch);
  /* N = sum_v m_v (R_1 y_1) (R_2 y_2)^T */
  double N[9], Q[9], RQ[9];
  moments_apply(&b, w.two.zeta, w.P); /* P_a,ij = sum_v m Phi_a,i y_2,j */
  for (int i = 0; i < 9; i++) Q[i] = inner(w.P + i * kp, w.one.zeta, kp);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      RQ[3 * i + j] = w.one.R[3 * i] * Q[j] + w.one.R[3 * i + 1] * Q[3 + j] + w.one.R[3 * i + 2] * Q[6 + j];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) N[3 * i + j] = dot3(RQ + 3 * i, w.two.R + 3 * j);
  double spread = -2 * (N[0] + N[4] + N[8]);
  for (int t = 0; t < 2; t++) {
    const double* z = t ? w.two.zeta : w.one.zeta;
    for (int a = 0; a < kp; a++) spread += (2 * b.trace[a] + z[a]) * z[a];
  }
  out[0] = .5 * b.mass * dot3(v, v) + .5 * ih * ih * spread;
  for (int c = 0; c < b.r; c++) out[1] += .5 * b.stiffness[c] * x[7 + c] * x[7 + c];
  out[2] = -b.mass * par[DP_GRAVITY] * x[2] + b.mass * STANDARD_GRAVITY * par[DP_RIGHTING] * (1 - w.one.R[8]);
  double spin[3], orbit[3], momentum[3];
  for (int i = 0; i < 3; i++) out[3 + i] = momentum[i] = b.mass * v[i];
  cross3(x, momentum, orbit);
  spin[0] = N[7] - N[5], spin[1] = N[2] - N[6], spin[2] = N[3] - N[1]; /* -(y1 x y2) summed */
  for (int i = 0; i < 3; i++) out[6 + i] = orbit[i] + spin[i] * ih;
}

void dp_surface(const double* blob, const double* qpos, double* points) {
  Body b;
  if (body_view(&b, blob, (size_t)blob[2])) return;
  WORK(w, &b, NULL, NULL);
  double quat[4], R[9];
  memcpy(quat, qpos + 3, sizeof quat);
  quat_normalize(quat), quat_matrix(quat, R);
  kinematics(&b, qpos + 7, 0, w.one.zeta, w.scratch);
  const int n = b.ns;
  for (int from = 0; from < n; from += 64) { /* blocks bound the memory on the stack */
    const int count = n - from < 64 ? n - from : 64;
    double y[3 * 64] = {0};
    for (int a = 0; a <= b.k; a++)
      for (int i = 0; i < 3; i++) {
        const double z = w.one.zeta[a], *restrict row = b.surface + ((size_t)3 * a + i) * n + from;
        for (int s = 0; s < count; s++) y[i * 64 + s] += z * row[s];
      }
    for (int s = 0; s < count && from + s < b.n_surface; s++)
      for (int i = 0; i < 3; i++)
        points[3 * (from + s) + i] =
            qpos[i] + R[3 * i] * y[s] + R[3 * i + 1] * y[64 + s] + R[3 * i + 2] * y[128 + s];
  }
}
