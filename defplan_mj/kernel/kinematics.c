/* Rotation-strain kinematics: zeta(q) = (1, z(q)) with its first and second derivatives, and the
 * linear maps over the basis. F_e = exp([w]) (I + E), w and E linear in q (Pan et al. [22]). */
#include "internal.h"

static int padded(int n) { return (n + PAD - 1) / PAD * PAD; }

int body_view(Body* b, const double* blob, size_t n) {
  if (!blob || n < HEADER || blob[0] != BLOB_MAGIC) return -1;
  if (blob[1] != BLOB_VERSION) return -2;
  if (blob[2] != (double)n) return -3;
  b->r = (int)blob[3], b->k = (int)blob[4], b->n_samples = (int)blob[5];
  b->n_patches = (int)blob[6], b->n_surface = (int)blob[7];
  b->mass = blob[8], b->radius = blob[9];
  if (b->r < 1 || b->r > DP_MAX_MODES || b->k < 1 || b->k > DP_MAX_BASIS) return -4;
  if (b->n_samples < 1 || b->n_samples > DP_MAX_SAMPLES) return -4;
  if (b->n_patches < 0 || b->n_patches > DP_MAX_POINTS || b->n_surface < 0) return -4;
  b->rp = padded(b->r), b->kp = padded(b->k + 1), b->nf = padded(9 * b->n_samples);
  b->np = padded(b->n_patches), b->ns = padded(b->n_surface);
  const double* p = blob + HEADER;
  size_t kp = b->kp;
  b->stiffness = p, p += b->rp;
  b->features = p, p += (size_t)9 * b->n_samples * b->rp;
  b->weights_t = p, p += b->nf * kp;
  b->weights = p, p += kp * b->nf;
  b->moments = p, p += kp * 9 * kp;
  b->trace = p, p += kp;
  b->points = p, p += kp * 3 * b->np;
  b->tangent1 = p, p += kp * 3 * b->np;
  b->tangent2 = p, p += kp * 3 * b->np;
  b->areas = p, p += b->np;
  b->surface = p, p += kp * 3 * b->ns;
  return p == blob + n ? 0 : -3;
}

int dp_check(const double* blob, size_t n) {
  Body b;
  return body_view(&b, blob, n);
}

void dp_sizes(const double* blob, int sizes[4]) {
  for (int i = 0; i < 4; i++) sizes[i] = (int)blob[i < 2 ? 3 + i : 4 + i];
}

/* Coefficients of exp([w]) = I + a [w] + b [w]^2 as functions of T = |w|^2; a1 = 2 da/dT and
 * a2 = 2 da1/dT, likewise b, so that da/dw = a1 w. */
typedef struct {
  double a, b, a1, b1, a2, b2;
} ExpCoef;

static const double EXP_SERIES[6][7] = {
    {1., -1. / 6., 1. / 120., -1. / 5040., 1. / 362880., -1. / 39916800., 1. / 6227020800.}, /* a */
    {1. / 2., -1. / 24., 1. / 720., -1. / 40320., 1. / 3628800., -1. / 479001600., 1. / 87178291200.}, /* b */
    {-1. / 3., 1. / 30., -1. / 840., 1. / 45360., -1. / 3991680., 1. / 518918400., -1. / 93405312000.}, /* a1 */
    {-1. / 12., 1. / 180., -1. / 6720., 1. / 453600., -1. / 47900160., 1. / 7264857600., -1. / 1494484992000.}, /* b1 */
    {1. / 15., -1. / 210., 1. / 7560., -1. / 498960., 1. / 51891840., -1. / 7783776000., 1. / 1587890304000.}, /* a2 */
    {1. / 90., -1. / 1680., 1. / 75600., -1. / 5987520., 1. / 726485760., -1. / 124540416000., 1. / 28582025472000.}, /* b2 */
};

static ExpCoef exp_coef(double t2) {
  ExpCoef c;
  if (t2 < .25) { /* series: the closed forms lose digits near zero */
    double s[6] = {0};
    for (int i = 6; i >= 0; i--)
      for (int j = 0; j < 6; j++) s[j] = s[j] * t2 + EXP_SERIES[j][i];
    c = (ExpCoef){s[0], s[1], s[2], s[3], s[4], s[5]};
  } else {
    double t = sqrt(t2), cs = cos(t);
    c.a = sin(t) / t, c.b = (1 - cs) / t2;
    c.a1 = (cs - c.a) / t2, c.b1 = (c.a - 2 * c.b) / t2;
    c.a2 = -(c.a + 3 * c.a1) / t2, c.b2 = (c.a1 - 4 * c.b1) / t2;
  }
  return c;
}

/* Layout of the scratch: x (9 a sample), D = dexp/dw (27), E = exp (9), coefficients (6),
 * features f (nf), their derivatives (nf x rp), and for the curvature A (nf). */
enum { PER_SAMPLE = 9 + 27 + 9 + 6 };
size_t kinematics_scratch(const Body* b) {
  return (size_t)padded(PER_SAMPLE * b->n_samples) + b->nf * (size_t)(2 + b->rp);
}

static void sample_strain(const double* x, double* Y) { /* I + strain, from x = (w, e11 e12 e13 e22 e23 e33) */
  Y[0] = 1 + x[3], Y[1] = Y[3] = x[4], Y[2] = Y[6] = x[5];
  Y[4] = 1 + x[6], Y[5] = Y[7] = x[7], Y[8] = 1 + x[8];
}

void kinematics(const Body* b, const double* q, double* restrict zeta, double* restrict dz,
                double* restrict scratch) {
  const int rp = b->rp, kp = b->kp, r = b->r, nf = b->nf, m = b->n_samples;
  double* restrict f = scratch + padded(PER_SAMPLE * m);
  double* restrict df = f + nf;
  for (int e = 0; e < m; e++) {
    const double* restrict L = b->features + (size_t)9 * e * rp;
    double* restrict x = scratch + PER_SAMPLE * e;
    double* restrict D = x + 9;
    double* restrict E = D + 27;
    for (int i = 0; i < 9; i++) {
      double s = 0;
      for (int c = 0; c < r; c++) s += L[i * rp + c] * q[c];
      x[i] = s;
    }
    double t2 = dot3(x, x), Y[9];
    ExpCoef k = exp_coef(t2);
    memcpy(E + 9, &k, sizeof k);
    sample_strain(x, Y);
    double W[9] = {0, -x[2], x[1], x[2], 0, -x[0], -x[1], x[0], 0};
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        E[3 * i + j] = k.a * W[3 * i + j] + k.b * x[i] * x[j] + (i == j ? 1 - k.b * t2 : 0);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        f[9 * e + 3 * i + j] = E[3 * i] * Y[j] + E[3 * i + 1] * Y[3 + j] + E[3 * i + 2] * Y[6 + j] - (i == j);
    if (!dz) continue;
    for (int n = 0; n < 3; n++) { /* D_n = dE/dw_n */
      double* restrict Dn = D + 9 * n;
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
          Dn[3 * i + j] = x[n] * (k.a1 * W[3 * i + j] + k.b1 * x[i] * x[j]) +
                          (i == j ? -k.b1 * x[n] * t2 - 2 * k.b * x[n] : 0);
      for (int j = 0; j < 3; j++) Dn[3 * n + j] += k.b * x[j], Dn[3 * j + n] += k.b * x[j];
      int i = (n + 1) % 3, j = (n + 2) % 3;
      Dn[3 * j + i] += k.a, Dn[3 * i + j] -= k.a;
    }
    double G[81]; /* dF_ij / dx_t */
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        double* g = G + 9 * (3 * i + j);
        for (int n = 0; n < 3; n++)
          g[n] = D[9 * n + 3 * i] * Y[j] + D[9 * n + 3 * i + 1] * Y[3 + j] + D[9 * n + 3 * i + 2] * Y[6 + j];
        for (int t = 3; t < 9; t++) g[t] = 0;
        static const int strain_index[9] = {3, 4, 5, 4, 6, 7, 5, 7, 8}; /* of Y_lj */
        for (int l = 0; l < 3; l++) g[strain_index[3 * l + j]] += E[3 * i + l];
      }
    for (int o = 0; o < 9; o++) {
      double* restrict row = df + (size_t)(9 * e + o) * rp;
      for (int c = 0; c < rp; c++) row[c] = 0;
      for (int t = 0; t < 9; t++)
        for (int c = 0; c < rp; c++) row[c] += G[9 * o + t] * L[t * rp + c];
    }
  }
  for (int a = 0; a < kp; a++) zeta[a] = 0;
  for (int o = 0; o < 9 * m; o++)
    for (int a = 0; a < kp; a++) zeta[a] += f[o] * b->weights_t[(size_t)o * kp + a];
  zeta[0] = 1;
  if (!dz) return;
  for (int c = 0; c < r; c++) {
    double* restrict row = dz + (size_t)c * kp;
    for (int a = 0; a < kp; a++) row[a] = 0;
    for (int o = 0; o < 9 * m; o++)
      for (int a = 0; a < kp; a++) row[a] += df[(size_t)o * rp + c] * b->weights_t[(size_t)o * kp + a];
  }
}

void kinematics_curvature(const Body* b, const double* grad, double* restrict scratch,
                          double* restrict hess) {
  const int rp = b->rp, kp = b->kp, r = b->r, nf = b->nf, m = b->n_samples;
  double* restrict As = scratch + padded(PER_SAMPLE * m) + nf + (size_t)nf * rp;
  for (int o = 0; o < nf; o++) As[o] = 0;
  for (int a = 1; a < kp; a++)
    for (int o = 0; o < nf; o++) As[o] += grad[a] * b->weights[(size_t)a * nf + o];
  for (int e = 0; e < m; e++) {
    const double* restrict L = b->features + (size_t)9 * e * rp;
    const double* x = scratch + PER_SAMPLE * e;
    const double *D = x + 9, *A = As + 9 * e;
    ExpCoef k;
    memcpy(&k, x + 45, sizeof k);
    double Y[9], AY[9], H[81] = {0};
    sample_strain(x, Y);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        AY[3 * i + j] = A[3 * i] * Y[3 * j] + A[3 * i + 1] * Y[3 * j + 1] + A[3 * i + 2] * Y[3 * j + 2];
    /* Hessian of <AY, exp[w]> in w */
    double tr = AY[0] + AY[4] + AY[8], al[3], Bw[3];
    vee(AY, al);
    for (int i = 0; i < 3; i++) {
      Bw[i] = -2 * tr * x[i];
      for (int j = 0; j < 3; j++) Bw[i] += (AY[3 * i + j] + AY[3 * j + i]) * x[j];
    }
    double aw = dot3(al, x), qf = .5 * dot3(Bw, x);
    for (int i = 0; i < 3; i++) {
      for (int j = 0; j < 3; j++)
        H[9 * i + j] = (k.a2 * aw + k.b2 * qf) * x[i] * x[j] + k.a1 * (x[i] * al[j] + al[i] * x[j]) +
                       k.b1 * (x[i] * Bw[j] + Bw[i] * x[j]) + k.b * (AY[3 * i + j] + AY[3 * j + i]);
      H[9 * i + i] += k.a1 * aw + k.b1 * qf - 2 * k.b * tr;
    }
    for (int n = 0; n < 3; n++) { /* mixed: <A, D_n dY> */
      double N[9];
      for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
          N[3 * i + j] = D[9 * n + i] * A[j] + D[9 * n + 3 + i] * A[3 + j] + D[9 * n + 6 + i] * A[6 + j];
      double v[6] = {N[0], N[1] + N[3], N[2] + N[6], N[4], N[5] + N[7], N[8]};
      for (int t = 0; t < 6; t++) H[9 * n + 3 + t] = H[9 * (3 + t) + n] = v[t];
    }
    double T[9 * DP_MAX_MODES];
    for (int i = 0; i < 9; i++) {
      double* restrict row = T + i * rp;
      for (int c = 0; c < rp; c++) row[c] = 0;
      for (int j = 0; j < (i < 3 ? 9 : 3); j++)
        for (int c = 0; c < rp; c++) row[c] += H[9 * i + j] * L[j * rp + c];
    }
    for (int c = 0; c < r; c++)
      for (int i = 0; i < 9; i++)
        for (int d = 0; d < rp; d++) hess[c * rp + d] += L[i * rp + c] * T[i * rp + d];
  }
}

void moments_apply(const Body* b, const double* zeta, double* restrict out) {
  const int n = 9 * b->kp;
  for (int i = 0; i < n; i++) out[i] = 0;
  for (int a = 0; a <= b->k; a++) {
    const double z = zeta[a];
    const double* restrict row = b->moments + (size_t)a * n;
    for (int i = 0; i < n; i++) out[i] += z * row[i];
  }
}

void field_apply(const double* field, const double* zeta, int count, int n, double* restrict out) {
  for (int i = 0; i < 3 * n; i++) out[i] = 0;
  for (int a = 0; a < count; a++) {
    const double z = zeta[a];
    const double* restrict row = field + (size_t)a * 3 * n;
    for (int i = 0; i < 3 * n; i++) out[i] += z * row[i];
  }
}

void field_transpose(const double* field, const double* restrict v, int count, int n,
                     double* restrict out) {
  for (int a = 0; a < count; a++) {
    const double* restrict row = field + (size_t)a * 3 * n;
    double s = 0;
    for (int i = 0; i < 3 * n; i++) s += row[i] * v[i];
    out[a] += s;
  }
}
