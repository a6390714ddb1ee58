/* How many cycles the way to a target takes if nothing is in it (solvers/search/outlook.py). */
#ifndef DEFPLAN_OUTLOOK_H
#define DEFPLAN_OUTLOOK_H
#include <math.h>

enum { MAX_D = 3 };

static inline double dot(const double* a, const double* b, int d) {
  double sum = 0;
  for (int i = 0; i < d; i++) sum += a[i] * b[i];
  return sum;
}

/* From a position and frame, by gaits that advance along axes (n x d); 0 at the target. */
static inline double cycles_left(int d, const double* position, const double* frame,
                                 const double* target, double goal_radius, double advance,
                                 double per_radian, int n, const double* axes) {
  double offset[MAX_D], local[MAX_D] = {0}, ahead = -1;
  for (int i = 0; i < d; i++) offset[i] = target[i] - position[i];
  const double distance = sqrt(dot(offset, offset, d));
  if (distance <= goal_radius) return 0;
  for (int i = 0; i < d; i++)
    for (int j = 0; j < d; j++) local[j] += offset[i] * frame[i * d + j];
  for (int a = 0; a < n; a++) {
    const double along = dot(local, axes + a * d, d) / distance;
    if (along > ahead) ahead = along;
  }
  return (distance - goal_radius) / advance + per_radian * acos(ahead > 1 ? 1 : ahead);
}
#endif
