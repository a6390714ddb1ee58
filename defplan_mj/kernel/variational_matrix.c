/* The matrix of the variational step's equations by node 2. They depend on it through the places p2
 * alone, so that it is J_1^T (...) J_2, without second derivatives, and not symmetric. */
#include "path.h"

/* Inertia, J_1^T M J_b / h^2: H_cc = M/h^2, H_tt = (tr(Y) 1 - Y)/h^2 with Y = sum m y_b y_1^T */
static void inertia_of_turns(const Path* p, const Node* nb, double* H) {
  const Node* n1 = p->n1;
  const int n = 6 + p->body->r;
  const double ih2 = 1 / (p->h * p->h);
  double N[9], Y[9];
  moments_pair(n1->P, nb->zeta, p->body->kp, N);
  to_world(nb->R, N, n1->R, Y);
  const double trace = Y[0] + Y[4] + Y[8];
  for (int i = 0; i < 3; i++) {
    H[i * n + i] += ih2 * p->body->mass;
    for (int j = 0; j < 3; j++)
      H[(3 + i) * n + 3 + j] += ih2 * ((i == j ? trace : 0) - Y[3 * i + j]);
  }
}

/* Column and row of mode c: H_tq = sum m y_1 x (R_b B dz_b), H_qt = sum m y_b x (R_1 B dz_1),
 * H_qq = sum m (R_1 B dz_1).(R_b B dz_b), over h^2; C = R_1^T R_b / h^2 */
static void inertia_of_mode(const Path* p, const Node* nb, const double* C, int c, double* H) {
  const Body* b = p->body;
  const Node* n1 = p->n1;
  const int r = b->r, kp = b->kp, n = 6 + r;
  const double ih2 = 1 / (p->h * p->h);
  const double* Q = n1->Q + (size_t)9 * kp * c; /* ji: sum m Phi_a,j (B dz_1)_i */
  double N[9], M[9], turn[3], row[MAX_ZETA];
  moments_pair(n1->P, nb->dz + c * kp, kp, N);
  to_world(nb->R, N, n1->R, M), vee(M, turn);
  for (int i = 0; i < 3; i++) H[(3 + i) * n + 6 + c] += ih2 * turn[i];
  moments_pair(Q, nb->zeta, kp, M);
  for (int i = 0; i < 9; i++) N[i] = M[i % 3 * 3 + i / 3];
  to_world(n1->R, N, nb->R, M), vee(M, turn);
  for (int i = 0; i < 3; i++) H[(6 + c) * n + 3 + i] += ih2 * turn[i];
  for (int a = 0; a < kp; a++) row[a] = 0;
  for (int i = 0; i < 9; i++) {
    const double factor = C[i % 3 * 3 + i / 3], *restrict Qi = Q + i * kp;
    for (int a = 0; a < kp; a++) row[a] += factor * Qi[a];
  }
  products(row, 1, nb->dz, r, kp, H + (6 + c) * n + 6, n);
}

void inertia_matrix(const Path* p, const Node* nb, double* H) {
  const int r = p->body->r, n = 6 + r;
  const double ih2 = 1 / (p->h * p->h), *par = p->par;
  const double elastic = .25 * (1 + par[DP_CONTROL]) + par[DP_DAMPING] / (2 * p->h);
  double C[9];
  mul_mtm(p->n1->R, nb->R, C);
  for (int i = 0; i < 9; i++) C[i] *= ih2;
  inertia_of_turns(p, nb, H);
  for (int c = 0; c < r; c++) {
    inertia_of_mode(p, nb, C, c, H);
    H[(6 + c) * n + 6 + c] += p->body->stiffness[c] * elastic;
  }
}

/* Column j of J at y, Jq -> of D J / 2: a displacement, e_m x y, a mode's */
static void drag_column(Path* p, int j, const double* y, const double* Jq, double* out) {
  const int np = p->body->np;
  if (j < 3) {
    for (int i = 0; i < 3; i++)
      for (int s = 0; s < np; s++) p->turned[i * np + s] = i == j;
  } else if (j < 6) {
    turn_column(j - 3, y, np, p->turned);
  }
  const double* column = j < 6 ? p->turned : Jq + (size_t)(j - 6) * 3 * np;
  drag_apply(.5, p->D12, column, np, out);
}

void drag_matrix(Path* p, const double* y, const double* Jq, double* H) {
  const int r = p->body->r, np = p->body->np, n = 6 + r;
  const Node* n1 = p->n1;
  *p->spent += n * np * (20. + 3 * r);
  for (int j = 0; j < n; j++) { /* J_1^T of it: sum, sum of y_1 x it, products with Jq_1 */
    double *out = p->columns + (size_t)j * 3 * np, turn[3];
    drag_column(p, j, y, Jq, out);
    sum_cross(n1->y, out, np, turn);
    for (int i = 0; i < 3; i++)
      H[i * n + j] += sum(out + i * np, np), H[(3 + i) * n + j] += turn[i];
  }
  products(n1->Jq, r, p->columns, n, 3 * np, H + 6 * n, n);
}

void drag_matrix_of_1(Path* p, double* H) {
  const int r = p->body->r, np = p->body->np, n = 6 + r, size = 3 * np;
  const Node* n1 = p->n1;
  double S[MAX_N * MAX_N] = {0}; /* its upper half */
  *p->spent += n * np * (20. + 2 * r);
  for (int j = 0; j < n; j++) {
    double *out = p->columns + (size_t)j * size, turn[3];
    drag_column(p, j, n1->y, n1->Jq, out);
    for (int i = 0; i < 3 && i <= j; i++) S[i * n + j] = sum(out + i * np, np);
    if (j < 3) continue;
    sum_cross(n1->y, out, np, turn);
    for (int i = 0; i < 3 && 3 + i <= j; i++) S[(3 + i) * n + j] = turn[i];
  }
  for (int c = 0; c < r; c += 2) {
    const size_t at = (size_t)c * size;
    products(n1->Jq + at, r - c < 2 ? 1 : 2, p->columns + 6 * (size_t)size + at, r - c, size,
             S + (6 + c) * n + 6 + c, n);
  }
  for (int i = 0; i < n; i++)
    for (int j = i; j < n; j++) {
      H[i * n + j] += S[i * n + j];
      if (j > i) H[j * n + i] += S[i * n + j];
    }
}

void variational_matrix(Path* p) {
  const int n = 6 + p->body->r;
  memset(p->H, 0, sizeof(double) * n * n);
  inertia_matrix(p, p->n2, p->H);
  if (has_drag(p->body, p->par)) {
    interval_drag(p, p->n1, p->n2, p->area12, p->f12, p->D12);
    drag_matrix(p, p->n2->y, p->n2->Jq, p->H);
  }
  if (p->m) touch_matrix(p, 1, p->H);
}
