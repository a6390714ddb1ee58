/* What a body can touch: gaps to its parts (terrain.c, distance.c), and the force at a gap
 * (contact_law.c). */
#ifndef DEFPLAN_TERRAIN_H
#define DEFPLAN_TERRAIN_H
#include "internal.h"

typedef struct {
  double friction;  /* coefficient */
  double stiffness; /* N/m^2: normal force of a point at depth d is stiffness d^2 */
  double thickness; /* m: contact begins at this distance */
  double slip;      /* m/s: rounds Coulomb's law at rest */
  double damping;   /* s/m: how the normal force grows with the speed of the approach */
  int n_geoms, rows, columns;
  double centre[3], half[2], top; /* heightfield: its centre at height 0; extent; largest height */
  const double* geoms;        /* n_geoms x (type, size 3, pos 3, mat 9) = n_geoms x 16 */
  const double* coefficients; /* rows (y) x columns (x): cubic B-spline of the heights */
} Terrain;

enum { TERRAIN_GEOM = 16 }; /* numbers of a geom in it */
int terrain_view(Terrain* t, const double* terrain, size_t n);
/* One part of the terrain at p: a smooth gap, its gradient and Hessian (gradient, hessian may be
 * NULL). Parts are the geoms, then the heightfield, whose gap is vertical: over |gradient| it is a
 * distance. */
static inline int terrain_parts(const Terrain* t) { return t->n_geoms + (t->rows > 0); }
double terrain_gap(const Terrain* t, int part, const double p[3], double* gradient,
                   double* hessian);
double geom_gap(const dp_geom* g, const double p[3], double* normal, double* hessian);


/* Add the force f (3) of a part of the terrain on a point at p with velocity v, and D = -df/dp,
 * F = -df/dv (3 x 3 each); 0 if it does not touch. mu: coefficient of friction. */
int contact_law(const Terrain* t, double mu, int part, const double* p, const double* v, double* f,
                double* D, double* F);
#endif
