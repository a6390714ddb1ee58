/* Many robots of one model, a step each: what a vector environment needs of the kernel. */
#include "kernel.h"

int dp_step_many(const dp_model* m, int n, const double* x, const double* u, double* x_next, int nu,
                 int* failed) {
  const int nx = dp_state_size(m->body);
  int count = 0;
  for (int i = 0; i < n; i++) {
    const long at = (long)i * nx;
    failed[i] = dp_step(m, x + at, u + (long)i * nu, x_next + at, 0);
    count += failed[i];
  }
  return count;
}
