/* States and the configurations, a substep apart, that they stand for (state.c). */
#ifndef DEFPLAN_STATE_H
#define DEFPLAN_STATE_H
#include "internal.h"

/* A configuration. */
typedef struct {
  double c[3], quat[4], q[DP_MAX_MODES];
} Pose;

/* The last configuration of state x of a body with r modes, and the one before it, h earlier; their
 * places are told from x's own. */
void state_nodes(int r, const double* x, double h, Pose* last, Pose* before);
/* The state of nodes whose places are told from `origin`, after a step to the target u. */
void state_pack(int r, const double* origin, const Pose* last, const Pose* before, const double* u,
                double h, double* x);
/* Gradient g_next over the state of state_pack -> over both nodes (6 + r each, tangent), over u. */
void state_pack_pull(int r, const Pose* last, const Pose* before, double h, const double* g_next,
                     double* g_last, double* g_before, double* gu);
/* Gradients over both nodes of state_nodes -> over x; its target's part is left. */
void state_nodes_pull(int r, const double* x, const Pose* last, double h, const double* g_last,
                      const double* g_before, double* gx);
/* Gradient g over a turn (world) of a quaternion -> over its 4 numbers, of any length. */
void quaternion_pull(const double* quat, const double* g, double* out);
#endif
