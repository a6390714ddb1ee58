/* Rotation-strain kinematics: zeta(q) = (1, z(q)) with its first and second derivatives, and the
 * linear maps over the basis. F_e = exp([w]) (I + E), w and E linear in q (Pan et al. [22]). */
#include "kinematics.h"

/* Coefficients of exp([w]) = I + a [w] + b [w]^2 as functions of T = |w|^2, and a1 = 2 da/dT, a2 =
 * 2 da1/dT, likewise b, so that da/dw = a1 w. Their series: exact to the last digit up to T = 4;
 * the closed forms lose digits near zero. */
enum { TERMS = 12 };
static const double SERIES_END = 4;
static const double EXP_SERIES[6][TERMS] = {
    {1., -1. / 6., 1. / 120., -1. / 5040., 1. / 362880., -1. / 39916800., 1. / 6227020800.,
     -1. / 1307674368000., 1. / 355687428096000., -1. / 121645100408832000.,
     1. / 51090942171709440000., -1. / 25852016738884976640000.}, /* a */
    {1. / 2., -1. / 24., 1. / 720., -1. / 40320., 1. / 3628800., -1. / 479001600.,
     1. / 87178291200., -1. / 20922789888000., 1. / 6402373705728000., -1. / 2432902008176640000.,
     1. / 1124000727777607680000., -1. / 620448401733239439360000.}, /* b */
    {-1. / 3., 1. / 30., -1. / 840., 1. / 45360., -1. / 3991680., 1. / 518918400.,
     -1. / 93405312000., 1. / 22230464256000., -1. / 6758061133824000., 1. / 2554547108585472000.,
     -1. / 1175091669949317120000., 1. / 646300418472124416000000.}, /* a1 */
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

/* The same by closed forms: out[0], out[LANES], ...: a, b, a1, b1, a2, b2, in a lane each */
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
    Vec sums[9] = {{0}}; /* of all nine at once: none waits for its own last sum */
    for (int c = 0; c < r; c++)
      for (int i = 0; i < 9; i++) sums[i] += load(L + (i * r + c) * lanes) * q[c];
    for (int i = 0; i < 9; i++) x[i] = sums[i];
    const Vec t2 = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
    if (derivatives) exp_coef(t2, 6, coef);
    else exp_coef(t2, 2, coef);
    const Vec a = coef[0], bb = coef[1], zero = {0};
    strain_matrix(x, Y);
    W[0] = W[4] = W[8] = zero, W[1] = -x[2], W[2] = x[1], W[3] = x[2], W[5] = -x[0], W[6] = -x[1],
    W[7] = x[0];
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
          g[n] = D[9 * n + 3 * i] * Y[j] + D[9 * n + 3 * i + 1] * Y[3 + j] +
                 D[9 * n + 3 * i + 2] * Y[6 + j];
        for (int c = 0; c < r; c++) {
          Vec s = zero;
          for (int n = 0; n < 3; n++) s += g[n] * load(L + (n * r + c) * lanes);
          for (int l = 0; l < 3; l++)
            s += E[3 * i + l] * load(L + (strain_index[3 * l + j] * r + c) * lanes);
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
    Vec A[9], Y[9], AY[9], al[3], Bw[3];
    Vec Hw[9], Hm[18]; /* second derivatives: w w (3 x 3), w strain (3 x 6) */
    for (int i = 0; i < 9; i++) A[i] = load(As + i * lanes + LANES * e);
    strain_matrix(x, Y);
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++)
        AY[3 * i + j] =
            A[3 * i] * Y[3 * j] + A[3 * i + 1] * Y[3 * j + 1] + A[3 * i + 2] * Y[3 * j + 2];
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
          N[3 * i + j] =
              D[9 * n + i] * A[j] + D[9 * n + 3 + i] * A[3 + j] + D[9 * n + 6 + i] * A[6 + j];
      h[0] = N[0], h[1] = N[1] + N[3], h[2] = N[2] + N[6], h[3] = N[4], h[4] = N[5] + N[7],
      h[5] = N[8];
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

void to_world(const double* A, const double* N, const double* B, double* out) {
  double T[9];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      T[3 * i + j] = A[3 * i] * N[j] + A[3 * i + 1] * N[3 + j] + A[3 * i + 2] * N[6 + j];
  mul_mmt(T, B, out);
}

void moments_turn(double factor, const double* A, const double* P, int kp, double* T) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      double* restrict Tij = T + (3 * i + j) * kp;
      for (int m = 0; m < 3; m++) {
        const double f = factor * A[3 * i + m], *restrict Pjm = P + (3 * j + m) * kp;
        for (int a = 0; a < kp; a++) Tij[a] += f * Pjm[a];
      }
    }
}

void moments_contract(double factor, const double* A, const double* restrict T, int kp,
                      double* restrict out) {
  for (int a = 0; a < kp; a++) {
    double s = 0;
    for (int i = 0; i < 9; i++) s += A[i] * T[i * kp + a];
    out[a] += factor * s;
  }
}

void field_apply(const Body* b, const double* field, int m, const double* zeta, int n,
                 double* restrict out) {
  multiply(m, zeta, b->kp, 1, field, b->k + 1, 3 * n, out);
}

void field_transpose(const Body* b, const double* field, const double* v, int n, double* out) {
  products(v, 1, field, b->k + 1, 3 * n, out, 1);
}

void places_pull(const Body* b, const double* field, const double* R, const double* y,
                 const double* g, int n, double* local, double* out, double* gz) {
  double turn[3];
  sum_cross(y, g, n, turn);
  for (int i = 0; i < 3; i++) out[i] += sum(g + i * n, n), out[3 + i] += turn[i];
  rotate_back(R, g, n, local);
  field_transpose(b, field, local, n, gz);
}

void modes_along(const Body* b, const double* dz, const double* lambda, double* restrict out) {
  for (int a = 0; a < b->kp; a++) out[a] = 0;
  for (int c = 0; c < b->r; c++)
    for (int a = 0; a < b->kp; a++) out[a] += lambda[c] * dz[c * b->kp + a];
}

void points_along(const Body* b, const double* field, const double* R, const double* restrict y,
                  const double* l, const double* along, int n, double* local,
                  double* restrict out) {
  field_apply(b, field, 1, along, n, local); /* along of the rest shape is 0 */
  rotate(R, local, n, out);
  for (int s = 0; s < n; s++) {
    const double px = y[s], py = y[n + s], pz = y[2 * n + s];
    out[s] += l[0] + l[4] * pz - l[5] * py;
    out[n + s] += l[1] + l[5] * px - l[3] * pz;
    out[2 * n + s] += l[2] + l[3] * py - l[4] * px;
  }
}

void point_jacobian(const double* y, const double* Jq, int r, int stride, double J[3][ROW]) {
  memset(J, 0, 3 * ROW * sizeof(double));
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    J[i][i] = 1, J[i][3 + j] = y[k * stride], J[i][3 + k] = -y[j * stride]; /* t x y */
    for (int c = 0; c < r; c++) J[i][6 + c] = Jq[(3 * c + i) * stride];
  }
}

void point_product(double J1[3][ROW], const double* D, double J2[3][ROW], int n, double* sums) {
  double DJ[3][ROW];
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < ROW; j++)
      DJ[i][j] = D[3 * i] * J2[0][j] + D[3 * i + 1] * J2[1][j] + D[3 * i + 2] * J2[2][j];
  for (int a = 0; a < n; a++) {
    const double x = J1[0][a], y = J1[1][a], z = J1[2][a];
    double* restrict row = sums + a * ROW;
    for (int j = 0; j < ROW; j++) row[j] += x * DJ[0][j] + y * DJ[1][j] + z * DJ[2][j];
  }
}
