/* The reduced step of a soft body: a step of (c, R, q) under a target shape, in substeps, with its
 * exact derivatives, rollouts, and distance queries. Plain C11; no allocation, no global state:
 * every call reads arrays of doubles that kernel/pack.py lays out (the body's `blob` and what else
 * a dp_model names) and is thread-safe. SI units; world z is up.
 *
 * State x, 13 + 3r doubles, in MuJoCo's order:
 *   qpos: c (3, world), unit quaternion w x y z (4), q (r)
 *   qvel: v (3, world), angular velocity (3, body frame), dq/dt (r): those of the last substep
 *   act: the last target shape (r), from which the next one is reached by a ramp
 * Input u, r + 3 n_feet doubles: target shape (r), then a world force (N) on each foot.
 * Options `par`, DP_N_PAR doubles: see the DP_* indices. */
#ifndef DEFPLAN_KERNEL_H
#define DEFPLAN_KERNEL_H
#include <stddef.h>

#if defined(_WIN32)
#define DP_API __declspec(dllexport)
#else
#define DP_API __attribute__((visibility("default")))
#endif

enum {               /* indices of par */
  DP_TIMESTEP,       /* s */
  DP_FLUID_DENSITY,  /* kg/m^3 */
  DP_DRAG_NORMAL,    /* coefficient */
  DP_DRAG_TANGENT,   /* coefficient */
  DP_CONTROL,        /* control stiffness, in units of the elastic one */
  DP_DAMPING,        /* stiffness-proportional, s */
  DP_GRAVITY,        /* along z, m/s^2 */
  DP_RIGHTING,       /* metacentric height, m */
  DP_TOLERANCE,      /* largest last Newton step: m, rad, units of q */
  DP_MAX_NEWTON,     /* iterations */
  DP_SUBSTEPS,       /* of a step */
  DP_INTEGRATOR,     /* DP_VARIATIONAL or DP_IMPLICIT_EULER */
  DP_N_PAR
};

enum { DP_VARIATIONAL, DP_IMPLICIT_EULER };
enum { DP_MAX_SUBSTEPS = 64 }; /* of a step */
enum { DP_MAX_DIVISION = 64 }; /* parts that a substep is divided into, if need be */
/* Multiplications, about, that a step is given before it fails: so that any input, however absurd,
 * is answered within 100 ms of processor time, and that the answer does not depend on the
 * machine. */
enum { DP_MAX_WORK = 150000000 };
enum { DP_MAX_MODES = 16, DP_MAX_BASIS = 64, DP_MAX_SAMPLES = 40, DP_MAX_POINTS = 512 };
enum { DP_MAX_CONTACTS = 192, DP_MAX_FEET = 16, DP_MAX_INPUT = DP_MAX_MODES + 3 * DP_MAX_FEET };

/* What a step is made of. The arrays stay the caller's. */
typedef struct {
  const double* body;    /* the blob */
  const double* par;     /* options */
  const double* terrain; /* or NULL: no contact */
  const double* feet;    /* or NULL: points on the body that take given forces */
} dp_model;

/* Geometry of an obstacle for distance queries; types numbered as in MuJoCo's mjtGeom. */
enum { DP_PLANE = 0, DP_SPHERE = 2, DP_CAPSULE = 3, DP_ELLIPSOID = 4, DP_CYLINDER = 5, DP_BOX = 6 };
typedef struct {
  int type;
  double size[3], pos[3], mat[9]; /* mat row-major, columns are the geom's axes */
} dp_geom;

typedef struct {
  int iterations; /* Newton iterations, all attempts of all substeps */
  int attempts;   /* the most of a substep; 1: the first one found the solution */
  int failed;     /* 1: a solve did not reach the tolerance */
  int division;   /* into how many parts the substeps had to be divided; 1: none */
  double residual; /* size of the last Newton step */
} dp_info;

/* "" or the first instruction set that the library was compiled to use and this machine lacks: to
 * be asked before anything else is called. */
DP_API const char* dp_missing_instructions(void);

/* The target it was compiled for, a hash of sources and options, the compiler. */
DP_API const char* dp_build(void);

/* 0 if blob holds a body of this version in n doubles, else a negative code. */
DP_API int dp_check(const double* blob, size_t n);
/* 0 if all that the model names belongs together and every number of it can be; else a negative
 * code. To be asked once, where a model is loaded: the calls below look at headers, options, geoms
 * and what they are given themselves, and fail where another number that is not finite takes
 * part. */
DP_API int dp_check_model(const dp_model* m);
/* 0 if terrain (not NULL) holds one in n doubles; feet for this body likewise. */
DP_API int dp_check_terrain(const double* terrain, size_t n);
DP_API int dp_check_feet(const double* blob, const double* feet, size_t n);
/* r, k, number of drag patches, number of surface points, number of contact points */
DP_API void dp_sizes(const double* blob, int sizes[5]);

/* Size of a state of a body with r modes. */
DP_API int dp_state_size(const double* blob);
/* One step. Returns 0, or 1 if the solve failed, or something given is not finite: x_next is then x
 * with what is not finite taken out, and nothing if the model has no body. A substep without a
 * solution is divided, until the step has done as much work as DP_MAX_WORK allows: then it has
 * failed. */
DP_API int dp_step(const dp_model* m, const double* x, const double* u,
                   double* x_next, dp_info* info);
/* The same from a state (nx) near the solution, of which the configuration counts: fewer
 * iterations. If they do not converge, as dp_step; if it is not a state, the step fails. */
DP_API int dp_step_near(const dp_model* m, const double* x, const double* u, const double* near,
                        double* x_next, dp_info* info);
/* N steps: u (N x nu), xs ((N+1) x nx) with xs[0] = x0 given. Returns the number of failed solves;
 * the states after x0 are finite. */
DP_API int dp_rollout(const dp_model* m, int N, const double* u, double* xs,
                      long* iterations);
/* A step of each of n robots: x and x_next (n x nx), u (n x nu), failed (n) as dp_step returns.
 * Returns how many failed. */
DP_API int dp_step_many(const dp_model* m, int n, const double* x, const double* u, double* x_next,
                        int nu, int* failed);
/* Jacobians of x_next, row-major: A (nx x nx), B (nx x nu), at a solved step. Returns 0, or 1
 * (singular, not a solved step, or not finite): A and B are of no use. Adjoints likewise. */
DP_API int dp_step_jac(const dp_model* m, const double* x, const double* u,
                       const double* x_next, double* A, double* B);
/* Adjoint: gx = A^T g_next, gu = B^T g_next (overwritten). */
DP_API int dp_step_adj(const dp_model* m, const double* x, const double* u,
                       const double* x_next, const double* g_next, double* gx, double* gu);
/* Adjoint of a rollout: on entry gxs ((N+1) x nx) = dJ/dxs, on return gxs[i] is the total
 * derivative with respect to xs[i] (gxs[0]: with respect to x0); gu (N x nu) overwritten. */
DP_API int dp_rollout_adj(const dp_model* m, int N, const double* u,
                          const double* xs, double* gxs, double* gu);

/* Energies and momenta of a state: out[0] kinetic, [1] elastic, [2] potential (gravity, righting),
 * [3..5] linear momentum, [6..8] angular momentum about the world origin; uses the discrete
 * velocity of the step that led to x, as if that had not been divided (dp_info.division). */
DP_API void dp_energy(const dp_model* m, const double* x, double out[9]);

/* Contact forces in state x, which a step has reached, not divided: positions, forces on the body
 * (normal and friction), both (n_c x 3), and gaps (n_c): least distance to the terrain. Returns how
 * many touch. */
DP_API int dp_contacts(const dp_model* m, const double* x, double* points, double* forces,
                       double* gaps);
/* Distance of a point to the terrain, near it (the least of its parts), and the outward normal. */
DP_API double dp_terrain_gap(const double* terrain, const double p[3], double normal[3]);
/* World positions of the model's feet (n_feet x 3), and if not NULL their Jacobian
 * (3 n_feet x (7 + r), row-major) over qpos. */
DP_API void dp_feet(const dp_model* m, const double* qpos, double* points, double* jacobian);

/* World positions of the surface points, (n_s x 3) row-major. */
DP_API void dp_surface(const double* blob, const double* qpos, double* points);
/* Smallest signed distance between the surface points and the geoms (positive outside), at most
 * `cutoff`; *geom and *point (may be NULL) say where, -1 if none is nearer than the cutoff. NaN if
 * qpos is not finite. */
DP_API double dp_clearance(const double* blob, const double* qpos, int n_geom, const dp_geom* geoms,
                           double cutoff, int* geom, int* point);
/* Signed distance of one point to one geom, and its outward gradient (normal, may be NULL). */
DP_API double dp_geom_distance(const dp_geom* g, const double p[3], double normal[3]);

/* Planning with rigid motions of whole gait cycles, in d = 2 or 3 dimensions.
 *
 * Least squared distance `out` (n x n_ways, on entry the largest that counts) of each robot's
 * points to the ways of its tree. Points offsets[i] .. offsets[i + 1] - 1 are robot i's: places
 * and drifts in a cycle (both x d). Trees: start and end (trees x d x n_ways), begun (n_ways): the
 * cycles before. */
DP_API void dp_ways(int d, int n, const int* offsets, const float* points, const float* drift,
                    const int* tree, int n_ways, const float* start, const float* end,
                    const float* begun, float* out);
/* A search for a way to a target, in the robot's frame. A decision plays a gait for 1 / `decisions`
 * of a cycle; its motion depends on the past: defplan_mj/planning/past.py has the tables. */
typedef struct {
  int d, n_gaits, before, n_balls, n_axes; /* before: the past at the start */
  int nodes;                /* that are made at most */
  int cycles, enough;       /* decisions: of a way at most; ahead, if there is none */
  int decisions, single;    /* of a cycle; how many of the first ones are made one by one */
  double goal_radius, margin, weight, cell, heading, advance, per_radian, horizon;
  const double *rotations, *translations; /* (past x gait x d x d), (past x gait x d) */
  const double *target, *balls; /* (d); (n_balls x (2d + 1)): centre, radius, drift in a decision */
  const double* axes;      /* (decisions x n_axes x d) along which gaits advance, at each phase */
  const int *then, *phase; /* (past x gait) the past after it; (past) the phase that comes next */
} dp_search_problem;
/* Bytes of memory that a search among so many nodes needs. */
DP_API size_t dp_search_size(int nodes);
/* The gaits of a way (plan, `cycles` long at most); returns how many, or if there is no way found
 * minus those of what comes nearest. */
DP_API int dp_search(const dp_search_problem* problem, void* memory, int* plan);

/* A search for a way to a target among points, in the robot's frame (astar.c). Of each gait before,
 * and last of rest, there is a set of manoeuvres, and of the cycles that these are made of. */
typedef struct {
  int d, n_sets, before, n_points, n_axes, nodes; /* before: the first set; nodes: at most */
  double goal_radius, clearance, least, weight, cell, heading, advance, per_radian, horizon;
  const int *ways_at, *steps_at; /* (n_sets + 1) where the cycles and manoeuvres of a set begin */
  const double* reach;           /* (n_sets) how far a set's cycles get */
  const double *starts, *ends;   /* (cycles x d) */
  const int *parents, *in_place; /* (cycles): the one before in its set or -1; if in place */
  const double *rotations, *translations, *cycles; /* of manoeuvres: (x d x d), (x d), how many */
  const int *ends_with, *firsts, *finals; /* of manoeuvres: last cycle, of its set; the end gaits */
  const double *points, *target, *axes;   /* (n_points x d), (d), (n_axes x d): gaits advance so */
} dp_astar_problem;
/* Bytes of memory that it needs. */
DP_API size_t dp_astar_size(const dp_astar_problem* problem);
/* The first gait of the way, or of what comes nearest; -1: there is none. */
DP_API int dp_astar(const dp_astar_problem* problem, void* memory);

/* CasADi (casadi.c) can pass numbers only: a slot holds a copy of a model for its functions
 * defplan_step_<ss> (steps = 1), defplan_rollout_<ss> and, with feet, defplan_feet_<ss>, ss being
 * the slot in two digits. `key` (at most 64 characters) names the model; with `share` a slot of the
 * same key and steps is taken once more. Returns the slot, -1 if all are taken, -2 if the model or
 * steps is wrong, -3 if there is no memory. Close it once the functions are made: it lives as long
 * as they do. */
DP_API int dp_slot_open(const dp_model* m, int steps, const char* key, int share);
DP_API void dp_slot_close(int slot);
/* The second of a function's config_args (the first is the key): what its sizes are. */
enum { DP_SLOT_SIZES = 64 };
DP_API void dp_slot_sizes(int slot, char sizes[DP_SLOT_SIZES]);
/* Why the last evaluation on the slot that failed did, 0 if none did since it was asked last. */
enum { DP_SLOT_NOT_FINITE = 1, DP_SLOT_QUATERNION, DP_SLOT_UNSOLVED, DP_SLOT_SINGULAR };
DP_API int dp_slot_failure(int slot);
#endif
