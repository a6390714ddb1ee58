/* Rotation-strain kinematics: zeta(q) = (1, z(q)) with its first and second derivatives, and the
 * linear maps over the basis. F_e = exp([w]) (I + E), w and E linear in q (Pan et al. [22]). */
#include "work.h"

enum { FEET_HEADER = 8 }; /* size, number */

static int padded(int n) { return (n + PAD - 1) / PAD * PAD; }

int body_view(Body* b, const double* blob, size_t n) {
  if (!blob || n < HEADER || blob[0] != BLOB_MAGIC) return -1;
  if (blob[1] != BLOB_VERSION) return -2;
  if (blob[2] != (double)n) return -3;
  static const int counts[] = {3, 4, 5, 6, 7, 10};
  for (int i = 0; i < 6; i++)
    if (!is_count(blob[counts[i]], 1e7)) return -4;
  if (!(blob[8] > 0 && blob[9] >= 0 && is_finite(blob, HEADER))) return -4;
  b->r = (int)blob[3], b->k = (int)blob[4], b->n_samples = (int)blob[5];
  b->n_patches = (int)blob[6], b->n_surface = (int)blob[7];
  b->mass = blob[8], b->radius = blob[9], b->n_contacts = (int)blob[10];
  if (b->r < 1 || b->r > DP_MAX_MODES || b->k < 1 || b->k > DP_MAX_BASIS) return -4;
  if (b->n_samples < 1 || b->n_samples > DP_MAX_SAMPLES) return -4;
  if (b->n_patches < 0 || b->n_patches > DP_MAX_POINTS || b->n_surface < 0) return -4;
  if (b->n_contacts < 0 || b->n_contacts > DP_MAX_CONTACTS) return -4;
  b->rp = padded(b->r), b->kp = padded(b->k + 1), b->nf = 9 * padded(b->n_samples);
  b->np = padded(b->n_patches), b->ns = padded(b->n_surface), b->nc = padded(b->n_contacts);
  const double* p = blob + HEADER;
  size_t kp = b->kp;
  b->stiffness = p, p += b->rp;
  b->features = p, p += (size_t)b->nf * b->r;
  b->weights_t = p, p += b->nf * kp;
  b->weights = p, p += kp * b->nf;
  b->moments = p, p += kp * 9 * kp;
  b->trace = p, p += kp;
  b->points = p, p += kp * 3 * b->np;
  b->tangent1 = p, p += kp * 3 * b->np;
  b->tangent2 = p, p += kp * 3 * b->np;
  b->areas = p, p += b->np;
  b->surface = p, p += kp * 3 * b->ns;
  b->contacts = p, p += kp * 3 * b->nc;
  return p == blob + n ? 0 : -3;
}

int body_view_own(Body* b, const double* blob) {
  if (!blob || !is_count(blob[2], 1e9)) return -3;
  return body_view(b, blob, (size_t)blob[2]);
}

int dp_check(const double* blob, size_t n) {
  Body b;
  return body_view(&b, blob, n);
}

int parts_view(Parts* p, const dp_model* m) {
  p->model = m;
  if (body_view_own(&p->body, m->body)) return NO_BODY;
  if (m->terrain && !is_count(m->terrain[0], 1e9)) return -3;
  if (terrain_view(&p->terrain, m->terrain, m->terrain ? (size_t)m->terrain[0] : 0)) return -3;
  if (m->feet && !is_count(m->feet[0], 1e9)) return -3;
  if (feet_view(&p->feet, &p->body, m->feet, m->feet ? (size_t)m->feet[0] : 0)) return -3;
  p->nu = p->body.r + 3 * p->feet.n, p->substeps = 1, p->euler = 0;
  const double* par = m->par;
  if (!par) return 0; /* geometry only */
  if (!is_finite(par, DP_N_PAR)) return -2;
  static const int positive[] = {DP_FLUID_DENSITY, DP_DRAG_NORMAL, DP_DRAG_TANGENT, DP_CONTROL, DP_DAMPING};
  for (int i = 0; i < 5; i++)
    if (par[positive[i]] < 0) return -2;
  if (!(par[DP_TIMESTEP] > 0 && par[DP_TIMESTEP] < 1e6 && par[DP_TOLERANCE] > 0 && par[DP_MAX_NEWTON] >= 1)) return -2;
  if (!is_count(par[DP_SUBSTEPS], DP_MAX_SUBSTEPS) || par[DP_SUBSTEPS] < 1) return -2;
  if (!is_count(par[DP_INTEGRATOR], DP_IMPLICIT_EULER)) return -2;
  p->substeps = (int)par[DP_SUBSTEPS], p->euler = par[DP_INTEGRATOR] == DP_IMPLICIT_EULER;
  return 0;
}

int dp_check_model(const dp_model* m) {
  Parts p;
  const int wrong = parts_view(&p, m);
  if (wrong) return wrong;
  if (!is_finite(m->body, (size_t)m->body[2])) return -5;
  if (m->terrain && !is_finite(m->terrain, (size_t)m->terrain[0])) return -5;
  return m->feet && !is_finite(m->feet, (size_t)m->feet[0]) ? -5 : 0;
}

void dp_sizes(const double* blob, int sizes[5]) {
  static const int at[5] = {3, 4, 6, 7, 10};
  for (int i = 0; i < 5; i++) sizes[i] = (int)blob[at[i]];
}

int feet_view(Feet* f, const Body* b, const double* feet, size_t n) {
  f->n = f->np = 0, f->field = NULL;
  if (!feet) return 0;
  if (n < FEET_HEADER || feet[0] != (double)n) return -3;
  if (!is_count(feet[1], DP_MAX_FEET) || feet[1] < 1) return -4;
  f->n = (int)feet[1], f->np = padded(f->n), f->field = feet + FEET_HEADER;
  return n == FEET_HEADER + (size_t)3 * b->kp * f->np ? 0 : -3;
}

int dp_check_feet(const double* blob, const double* feet, size_t n) {
  Body b;
  Feet f;
  return body_view_own(&b, blob) || feet_view(&f, &b, feet, n);
}

/* Coefficients of exp([w]) = I + a [w] + b [w]^2 as functions of T = |w|^2, and a1 = 2 da/dT,
 * a2 = 2 da1/dT, likewise b, so that da/dw = a1 w. Their series: exact to the last digit up to T = 4;
 * the closed forms lose digits near zero. */
enum { TERMS = 12 };
static const double SERIES_END = 4;
static const double EXP_SERIES[6][TERMS] = {
    {1., -1. / 6., 1. / 120., -1. / 5040., 1. / 362880., -1. / 39916800., 1. / 6227020800.,
     -1. / 1307674368000., 1. / 355687428096000., -1. / 121645100408832000.,
     1. / 51090942171709440000., -1. / 25852016738884976640000.}, /* a */
    {1. / 2., -1. / 24., 1. / 720., -1. / 40320., 1. / 3628800., -1. / 479001600.,
     1. / 87178291200., -1. / 20922789888000., 1. / 6402373705728000.,
     -1. / 2432902008176640000., 1. / 1124000727777607680000., -1. / 620448401733239439360000.}, /* b */
    {-1. / 3., 1. / 30., -1. / 840., 1. / 45360., -1. / 3991680., 1. / 518918400.,
     -1. / 93405312000., 1. / 22230464256000., -1. / 6758061133824000.,
     1. / 2554547108585472000., -1. / 1175091669949317120000., 1. / 646300418472124416000000.}, /* a1 */
    {-1. / 12., 1. / 180., -1. / 6720., 1. / 453600., -1. / 47900160., 1. / 7264857600.,
     -1. / 1494484992000., 1. / 400148356608000., -1. / 135161222676480000.,
     1. / 56200036388880384000., -1. / 28202200078783610880000.,
     1. / 16803810880275234816000000.}, /* b1 */
    {1. / 15., -1. / 210., 1. / 7560., -1. / 498960., 1. / 51891840., -1. / 7783776000.,
     1. / 1587890304000., -1. / 422378820864000., 1. / 141919283810304000.,
     -1. / 58754583497465856000., 1. / 29377291748732928000000.,
     -1. / 17450111298747359232000000.}, /* a2 */
    {1. / 90., -1. / 1680., 1. / 75600., -1. / 5987520., 1. / 726485760., -1. / 124540416000.,
     1. / 28582025472000., -1. / 8447576417280000., 1. / 3122224243826688000.,
     -1. / 1410110003939180544000., 1. / 763809585467056128000000.,
     -1. / 488603116364926058496000000.}, /* b2 */
};

/* The same by closed forms: out[0], out[LANES], ...: a, b, a1, b1, a2, b2, each in a lane of its vector */
static void exp_closed(double t2, double* out) {
  const double t = sqrt(t2), c = cos(t);
  double s[6] = {sin(t) / t, (1 - c) / t2};
  s[2] = (c - s[0]) / t2, s[3] = (s[0] - 2 * s[1]) / t2;
  s[4] = -(s[0] + 3 * s[2]) / t2, s[5] = (s[2] - 4 * s[3]) / t2;
  for (int j = 0; j < 6; j++) out[LANES * j] = s[j];
}

/* The first n of the coefficients for a block of samples */
static inline __attribute__((always_inline)) void exp_coef(Vec t2, const int n, Vec* out) {
  for (int j = 0; j < n; j++) out[j] = (Vec){0} + EXP_SERIES[j][TERMS - 1];
  for (int i = TERMS - 2; i >= 0; i--)
    for (int j = 0; j < n; j++) out[j] = out[j] * t2 + EXP_SERIES[j][i];
  for (int lane = 0; lane < LANES; lane++) {
    double all[6 * LANES];
    if (t2[lane] <= SERIES_END) continue;
    exp_closed(t2[lane], all + lane);
    for (int j = 0; j < n; j++) out[j][lane] = all[LANES * j + lane];
  }
}

/* Samples are worked on four at a time: every quantity below is a vector over a block of four.
 * The scratch keeps, a block: x (9), D = dexp/dw (27), E = exp (9), coefficients (6); then the
 * features f (nf), their derivatives (r x nf), and for the curvature A (nf). */
enum { PER_BLOCK = 9 + 27 + 9 + 6 };

static int n_blocks(const Body* b) { return padded(b->n_samples) / LANES; }

size_t kinematics_scratch(const Body* b) {
  return (size_t)PER_BLOCK * LANES * n_blocks(b) + (size_t)b->nf * (2 + b->r);
}

static void strain_matrix(const Vec* x, Vec* Y) { /* I + strain, x = (w, e11 e12 e13 e22 e23 e33) */
  Y[0] = 1 + x[3], Y[1] = Y[3] = x[4], Y[2] = Y[6] = x[5];
  Y[4] = 1 + x[6], Y[5] = Y[7] = x[7], Y[8] = 1 + x[8];
}
static Vec load(const double* p) { return *(const AnyVec*)p; }

void kinematics(const Body* b, const double* q, int derivatives, double* restrict zeta,
                double* restrict scratch) {
  const int r = b->r, nf = b->nf, blocks = n_blocks(b), lanes = LANES * blocks;
  double* restrict f = scratch + PER_BLOCK * lanes;
  double* restrict df = f + nf;
  for (int e = 0; e < blocks; e++) {
    const double* L = b->features + LANES * e; /* 9 x r x lanes */
    Vec *x = (Vec*)scratch + PER_BLOCK * e, *D = x + 9, *E = D + 27, *coef = E + 9, Y[9], W[9];
    for (int i = 0; i < 9; i++) {
      x[i] = (Vec){0};
      for (int c = 0; c < r; c++) x[i] += load(L + (i * r + c) * lanes) * q[c];
    }
    const Vec t2 = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
    if (derivatives) exp_coef(t2, 6, coef);
    else exp_coef(t2, 2, coef);
    const Vec a = coef[0], bb = coef[1], zero = {0};
    strain_matrix(x, Y);
    W[0] = W[4] = W[8] = zero, W[1] = -x[2], W[2] = x[1], W[3] = x[2], W[5] = -x[0], W[6] = -x[1], W[7] = x[0];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) E[3 * i + j] = a * W[3 * i + j] + bb * x[i] * x[j];
    for (int i = 0; i < 3; i++) E[4 * i] += 1 - bb * t2;
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        *(Vec*)(f + (3 * i + j) * lanes + LANES * e) =
            E[3 * i] * Y[j] + E[3 * i + 1] * Y[3 + j] + E[3 * i + 2] * Y[6 + j] - (double)(i == j);
    if (!derivatives) continue;
    const Vec a1 = coef[2], b1 = coef[3];
    for (int n = 0; n < 3; n++) { /* D_n = dE/dw_n */
      Vec* Dn = D + 9 * n;
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
          Dn[3 * i + j] = x[n] * (a1 * W[3 * i + j] + b1 * x[i] * x[j]);
      for (int i = 0; i < 3; i++) Dn[4 * i] -= x[n] * (b1 * t2 + 2 * bb);
      for (int j = 0; j < 3; j++) Dn[3 * n + j] += bb * x[j], Dn[3 * j + n] += bb * x[j];
      const int i = (n + 1) % 3, j = (n + 2) % 3;
      Dn[3 * j + i] += a, Dn[3 * i + j] -= a;
    }
    for (int j = 0; j < 3; j++) /* dF_ij / dq_c */
      for (int i = 0; i < 3; i++) {
        static const int strain_index[9] = {3, 4, 5, 4, 6, 7, 5, 7, 8}; /* of Y_lj in x */
        Vec g[3];
        for (int n = 0; n < 3; n++)
          g[n] = D[9 * n + 3 * i] * Y[j] + D[9 * n + 3 * i + 1] * Y[3 + j] + D[9 * n + 3 * i + 2] * Y[6 + j];
        for (int c = 0; c < r; c++) {
          Vec s = zero;
          for (int n = 0; n < 3; n++) s += g[n] * load(L + (n * r + c) * lanes);
          for (int l = 0; l < 3; l++) s += E[3 * i + l] * load(L + (strain_index[3 * l + j] * r + c) * lanes);
          *(Vec*)(df + (size_t)c * nf + (3 * i + j) * lanes + LANES * e) = s;
        }
      }
  }
  multiply(derivatives ? 1 + r : 1, f, nf, 1, b->weights_t, nf, b->kp, zeta);
  zeta[0] = 1;
}

void kinematics_curvature(const Body* b, const double* grad, double* restrict scratch,
                          double* restrict hess) {
  const int rp = b->rp, r = b->r, nf = b->nf, blocks = n_blocks(b), lanes = LANES * blocks;
  double* restrict As = scratch + PER_BLOCK * lanes + (size_t)nf * (1 + r);
  multiply(1, grad, 0, 1, b->weights, b->k + 1, nf, As);
  for (int e = 0; e < blocks; e++) {
    const double* L = b->features + LANES * e;
    const Vec *x = (const Vec*)scratch + PER_BLOCK * e, *D = x + 9, *coef = x + 45;
    const Vec bb = coef[1], a1 = coef[2], b1 = coef[3], a2 = coef[4], b2 = coef[5], zero = {0};
    Vec A[9], Y[9], AY[9], al[3], Bw[3], Hw[9], Hm[18]; /* second derivatives: w w (3 x 3), w strain (3 x 6) */
    for (int i = 0; i < 9; i++) A[i] = load(As + i * lanes + LANES * e);
    strain_matrix(x, Y);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        AY[3 * i + j] = A[3 * i] * Y[3 * j] + A[3 * i + 1] * Y[3 * j + 1] + A[3 * i + 2] * Y[3 * j + 2];
    const Vec tr = AY[0] + AY[4] + AY[8];
    al[0] = AY[7] - AY[5], al[1] = AY[2] - AY[6], al[2] = AY[3] - AY[1];
    for (int i = 0; i < 3; i++) {
      Bw[i] = -2 * tr * x[i];
      for (int j = 0; j < 3; j++) Bw[i] += (AY[3 * i + j] + AY[3 * j + i]) * x[j];
    }
    const Vec aw = al[0] * x[0] + al[1] * x[1] + al[2] * x[2];
    const Vec qf = .5 * (Bw[0] * x[0] + Bw[1] * x[1] + Bw[2] * x[2]);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        Hw[3 * i + j] = (a2 * aw + b2 * qf) * x[i] * x[j] + a1 * (x[i] * al[j] + al[i] * x[j]) +
                        b1 * (x[i] * Bw[j] + Bw[i] * x[j]) + bb * (AY[3 * i + j] + AY[3 * j + i]);
    for (int i = 0; i < 3; i++) Hw[4 * i] += a1 * aw + b1 * qf - 2 * bb * tr;
    for (int n = 0; n < 3; n++) { /* mixed: <A, D_n dY> */
      Vec N[9], *h = Hm + 6 * n;
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
          N[3 * i + j] = D[9 * n + i] * A[j] + D[9 * n + 3 + i] * A[3 + j] + D[9 * n + 6 + i] * A[6 + j];
      h[0] = N[0], h[1] = N[1] + N[3], h[2] = N[2] + N[6], h[3] = N[4], h[4] = N[5] + N[7], h[5] = N[8];
    }
    for (int c = 0; c < r; c++) {
      Vec T[9]; /* second derivatives times column c */
      for (int i = 0; i < 9; i++) T[i] = zero;
      for (int n = 0; n < 3; n++) {
        const Vec Ln = load(L + (n * r + c) * lanes);
        for (int i = 0; i < 3; i++) T[i] += Hw[3 * i + n] * Ln;
        for (int t = 0; t < 6; t++) {
          T[n] += Hm[6 * n + t] * load(L + ((3 + t) * r + c) * lanes);
          T[3 + t] += Hm[6 * n + t] * Ln;
        }
      }
      for (int d = c; d < r; d++) {
        Vec s = zero;
        for (int i = 0; i < 9; i++) s += T[i] * load(L + (i * r + d) * lanes);
        double total = 0;
        for (int lane = 0; lane < LANES; lane++) total += s[lane];
        hess[c * rp + d] += total;
      }
    }
  }
}

void moments_apply(const Body* b, int m, const double* zeta, double* restrict out) {
  multiply(m, zeta, b->kp, 1, b->moments, b->k + 1, 9 * b->kp, out);
}

void field_apply(const Body* b, const double* field, int m, const double* zeta, int n, double* restrict out) {
  multiply(m, zeta, b->kp, 1, field, b->k + 1, 3 * n, out);
}

void field_transpose(const Body* b, const double* field, const double* restrict v, int n,
                     double* restrict out) {
  for (int a = 0; a <= b->k; a++) {
    const double* restrict row = field + (size_t)a * 3 * n;
    double s = 0;
    for (int i = 0; i < 3 * n; i++) s += row[i] * v[i];
    out[a] += s;
  }
}
