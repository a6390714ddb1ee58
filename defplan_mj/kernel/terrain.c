/* The terrain: geoms and a heightfield, as smooth gaps with two derivatives. */
#include "terrain.h"

enum { TERRAIN_HEADER = 16, PER_GEOM = TERRAIN_GEOM };
static const int SIZES[] = {0, 0, 1, 2, 3, 2, 3}; /* numbers in the size of a geom, by its type */

int terrain_view(Terrain* t, const double* terrain, size_t n) {
  memset(t, 0, sizeof *t);
  if (!terrain) return 0;
  if (n < TERRAIN_HEADER || terrain[0] != (double)n) return -3;
  if (!is_finite(terrain, TERRAIN_HEADER)) return -4;
  for (int i = 5; i < 8; i++)
    if (!is_count(terrain[i], 1e7)) return -4;
  t->friction = terrain[1], t->stiffness = terrain[2];
  t->thickness = terrain[3], t->slip = terrain[4];
  t->n_geoms = (int)terrain[5], t->rows = (int)terrain[6], t->columns = (int)terrain[7];
  memcpy(t->centre, terrain + 8, sizeof t->centre), memcpy(t->half, terrain + 11, sizeof t->half);
  t->top = terrain[13], t->damping = terrain[14];
  if (!(t->friction >= 0 && t->stiffness > 0 && t->thickness > 0 && t->slip > 0 && t->damping >= 0))
    return -4;
  if (t->rows > 0 && (t->rows < 2 || t->columns < 2 || !(t->half[0] > 0 && t->half[1] > 0)))
    return -4;
  t->geoms = terrain + TERRAIN_HEADER;
  t->coefficients = t->geoms + (size_t)PER_GEOM * t->n_geoms;
  const size_t size = TERRAIN_HEADER + (size_t)PER_GEOM * t->n_geoms + (size_t)t->rows * t->columns;
  if (n != size) return -3;
  for (int i = 0; i < t->n_geoms; i++) {
    const double* row = t->geoms + (size_t)PER_GEOM * i;
    const int type = is_count(row[0], DP_BOX) ? (int)row[0] : -1;
    if (type < 0 || type == 1 || !is_finite(row, PER_GEOM)) return -4;
    for (int k = 0; k < SIZES[type]; k++)
      if (!(row[1 + k] > 0)) return -4;
  }
  return 0;
}

int dp_check_terrain(const double* terrain, size_t n) {
  Terrain t;
  return terrain ? terrain_view(&t, terrain, n) : -1;
}

/* Weights of the four coefficients around s in [0, n - 1], their first and second derivatives; the
 * field is mirrored at its rim and level beyond it, so that its slope is continuous there, too. */
static void spline(double s, int n, int index[4], double weight[3][4]) {
  const int beyond = s < 0 || s > n - 1;
  s = fmin(fmax(s, 0), n - 1);
  int cell = (int)s;
  if (cell > n - 2) cell = n - 2;
  const double t = s - cell, u = 1 - t;
  for (int i = 0; i < 4; i++) {
    int k = cell - 1 + i;
    index[i] = k < 0 ? -k : k > n - 1 ? 2 * (n - 1) - k : k;
  }
  const double w[3][4] = {
      {u * u * u / 6, 2. / 3 - t * t * (2 - t) / 2, 2. / 3 - u * u * (2 - u) / 2, t * t * t / 6},
      {-u * u / 2, -2 * t + 1.5 * t * t, 2 * u - 1.5 * u * u, t * t / 2},
      {u, 3 * t - 2, 3 * u - 2, t}};
  for (int i = 0; i < 12; i++) weight[i / 4][i % 4] = beyond && i > 3 ? 0 : w[i / 4][i % 4];
}

static double height(const Terrain* t, const double p[3], double* gradient, double* hessian) {
  int ix[4], iy[4];
  double wx[3][4], wy[3][4], value[6] = {0}; /* h, x, y, xx, xy, yy */
  const double sx = .5 * (t->columns - 1) / t->half[0], sy = .5 * (t->rows - 1) / t->half[1];
  spline((p[0] - t->centre[0] + t->half[0]) * sx, t->columns, ix, wx);
  spline((p[1] - t->centre[1] + t->half[1]) * sy, t->rows, iy, wy);
  for (int j = 0; j < 4; j++) {
    double line[3] = {0};
    for (int i = 0; i < 4; i++)
      for (int d = 0; d < 3; d++)
        line[d] += wx[d][i] * t->coefficients[(size_t)iy[j] * t->columns + ix[i]];
    value[0] += wy[0][j] * line[0], value[1] += wy[0][j] * line[1], value[2] += wy[1][j] * line[0];
    value[3] += wy[0][j] * line[2], value[4] += wy[1][j] * line[1], value[5] += wy[2][j] * line[0];
  }
  if (gradient) gradient[0] = -sx * value[1], gradient[1] = -sy * value[2], gradient[2] = 1;
  if (hessian) {
    memset(hessian, 0, 9 * sizeof(double));
    hessian[0] = -sx * sx * value[3], hessian[4] = -sy * sy * value[5];
    hessian[1] = hessian[3] = -sx * sy * value[4];
  }
  return p[2] - t->centre[2] - value[0];
}

double terrain_gap(const Terrain* t, int part, const double p[3], double* gradient,
                   double* hessian) {
  if (part == t->n_geoms) return height(t, p, gradient, hessian);
  const double* row = t->geoms + (size_t)PER_GEOM * part;
  dp_geom g;
  g.type = (int)row[0];
  memcpy(g.size, row + 1, sizeof g.size), memcpy(g.pos, row + 4, sizeof g.pos);
  memcpy(g.mat, row + 7, sizeof g.mat);
  return geom_gap(&g, p, gradient, hessian);
}

double dp_terrain_gap(const double* terrain, const double p[3], double normal[3]) {
  Terrain t;
  double best = INFINITY;
  if (normal) normal[0] = normal[1] = 0, normal[2] = 1;
  if (!terrain || !is_count(terrain[0], 1e9) || terrain_view(&t, terrain, (size_t)terrain[0]))
    return best;
  for (int i = 0; i < terrain_parts(&t); i++) {
    double n[3], gap = terrain_gap(&t, i, p, n, NULL), length = sqrt(dot3(n, n));
    gap /= length;
    if (!(gap < best)) continue;
    best = gap;
    for (int k = 0; normal && k < 3; k++) normal[k] = n[k] / length;
  }
  return best;
}
