/* How close the cycles of motion trees pass to points that may move: for many robots at once. */
#include "kernel.h"

#define WAYS(D)                                                                                    \
  static void ways_##D(int n, const int* offsets, const float* points, const float* drift,         \
                       const int* tree, int n_ways, const float* start, const float* end,          \
                       const float* begun, float* restrict out) {                                  \
    for (int robot = 0; robot < n; robot++, out += n_ways) {                                       \
      const float *from = start + (long)tree[robot] * D * n_ways, *to = end + (from - start);      \
      for (int p = offsets[robot]; p < offsets[robot + 1]; p++)                                    \
        for (int w = 0; w < n_ways; w++) {                                                         \
          float length2 = 1e-12f, along = 0, from2 = 0;                                            \
          for (int i = 0; i < D; i++) { /* seen from the point */                                  \
            const float u = drift[p * D + i];                                                      \
            const float offset = points[p * D + i] + u * begun[w] - from[i * n_ways + w];          \
            const float edge = to[i * n_ways + w] - from[i * n_ways + w] - u;                      \
            length2 += edge * edge;                                                                \
            along += offset * edge;                                                                \
            from2 += offset * offset;                                                              \
          }                                                                                        \
          float share = along / length2;                                                           \
          share = share < 0 ? 0 : share > 1 ? 1 : share;                                           \
          const float way2 = from2 + share * (share * length2 - 2 * along);                        \
          out[w] = way2 < out[w] ? way2 : out[w];                                                  \
        }                                                                                          \
    }                                                                                              \
  }
WAYS(2)
WAYS(3)

void dp_ways(int d, int n, const int* offsets, const float* points, const float* drift,
             const int* tree, int n_ways, const float* start, const float* end, const float* begun,
             float* out) {
  (d == 2 ? ways_2 : ways_3)(n, offsets, points, drift, tree, n_ways, start, end, begun, out);
}
