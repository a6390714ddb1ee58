/* MuJoCo engine plugin `defplan.reduced_fem`: drives a body's free joint and modal slide joints by
 * the reduced step of the kernel, and senses how far the surface is from the scene's geoms.
 *
 * Build (setup.py does; by hand, with S = the site-packages folder that holds mujoco):
 *   gcc -O3 -march=x86-64-v3 -std=c11 -fPIC -shared -I$S/mujoco/include -Idefplan_mj/kernel \
 *       defplan_mj/host/plugin.c -o defplan_mj/host/libdefplan_plugin.so \
 *       -Ldefplan_mj/kernel -ldefplan_kernel -Wl,-rpath,'$ORIGIN/../kernel' \
 *       -L$S/mujoco -l:libmujoco.so.3.17.0
 * libmujoco needs no rpath: the mujoco package has it loaded before this library.
 *
 * What an instance reads from the model (so copies, pickles and batches of a model just work):
 *   custom numerics, named by the config attributes `body` (the kernel's blob), `options` (the
 *   kernel's par; its time step is overwritten by opt.timestep), `scale` (target shape at ctrl = 1)
 *   and `terrain` (what the body stands on; without it there is no contact);
 *   a model that was attached with a prefix or suffix has them around the names of its numerics and
 *   of the instance, `reduced_fem`, from which they are read;
 *   its actuators, in order: their joints are the modal coordinates, slides on children of the body
 *   that carries the free joint, and their activations the last target shape;
 *   body_user (if 3 numbers) is the velocity of a mocap obstacle.
 * What it keeps is in plugin_state, laid out by the ST_* indices. It allocates nothing. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <mujoco/mujoco.h>

#include "kernel.h"

enum { MAX_STATE = 13 + 3*DP_MAX_MODES };

enum {             /* indices of plugin_state */
  ST_READY,        /* 1 between compute and advance: ST_X holds the start of the step */
  ST_ITERATIONS,   /* Newton iterations of the last step */
  ST_RESIDUAL,     /* size of its last Newton step */
  ST_FAILED,       /* failed solves since the reset */
  ST_DIVISION,     /* into how many parts the substeps of the last step had to be divided */
  ST_X,            /* state at the start of the step */
  ST_SIZE = ST_X + MAX_STATE
};

static const double CUTOFF = 1.0; /* m; the clearance sensor saturates here */

static const char INSTANCE[] = "reduced_fem"; /* what build_spec calls an instance */

enum { MAX_NAME = 256 };

static const char* const ATTRIBUTES[] = {"body", "options", "scale", "terrain"};
static const char* const DEFAULTS[] = {"defplan_body", "defplan_options", "defplan_scale",
                                       "defplan_terrain"};

/* Where an instance finds its things in a model. */
typedef struct {
  int r, root;                        /* modes; body of the free joint */
  int qpos_root, dof_root;            /* addresses of the free joint */
  int ctrl[DP_MAX_MODES], act[DP_MAX_MODES], qpos[DP_MAX_MODES], dof[DP_MAX_MODES];
  const mjtNum *blob, *options, *scale, *terrain; /* terrain may be NULL */
} layout;

/* What `mjs_attach` has put around the name of an instance: the lengths of prefix and suffix, the
 * whole name; nothing where the instance has another name. */
typedef struct {
  const char* name;
  int prefix, suffix;
} affixes;

static affixes find_affixes(const mjModel* m, int instance) {
  const char* name = mj_id2name(m, mjOBJ_PLUGIN, instance);
  const char* found = name ? strstr(name, INSTANCE) : NULL;
  if (!found) return (affixes) {"", 0, 0};
  int prefix = (int)(found - name);
  return (affixes) {name, prefix, (int)strlen(name) - prefix - (int)strlen(INSTANCE)};
}

/* Return the number of the numeric that attribute i names, with the affixes around it, or -1. */
static int find_numeric_id(const mjModel* m, int instance, int i, affixes around) {
  const char* name = mj_getPluginConfig(m, instance, ATTRIBUTES[i]);
  char whole[MAX_NAME];
  if (!name || !name[0]) name = DEFAULTS[i];
  int length = snprintf(whole, sizeof(whole), "%.*s%s%s", around.prefix, around.name, name,
                        around.name + strlen(around.name) - around.suffix);
  return length < MAX_NAME ? mj_name2id(m, mjOBJ_NUMERIC, whole) : -1;
}

/* Return the data of the numeric that attribute i names, or NULL; its size in *size. */
static const mjtNum* find_numeric(const mjModel* m, int instance, int i, int* size) {
  /* an attached model's numerics have its affixes, but what the config says has none; one that
   * was given to an instance by hand may stand without. All are looked for where the body is. */
  affixes around = find_affixes(m, instance);
  if (find_numeric_id(m, instance, 0, around) < 0) around = (affixes) {"", 0, 0};
  int id = find_numeric_id(m, instance, i, around);
  if (id < 0) return NULL;
  *size = m->numeric_size[id];
  return m->numeric_data + m->numeric_adr[id];
}

/* Fill `at`; return NULL, or what is wrong with the model. The numbers behind the headers are not
 * looked at: plugin_init does that once. */
static const char* find_layout(const mjModel* m, int instance, layout* at) {
  int size = 0, sizes[5];
  at->blob = find_numeric(m, instance, 0, &size);
  if (!at->blob || dp_check(at->blob, size)) return "no valid body numeric";
  dp_sizes(at->blob, sizes);
  at->options = find_numeric(m, instance, 1, &size);
  if (!at->options || size != DP_N_PAR) return "no valid options numeric";
  at->scale = find_numeric(m, instance, 2, &size);
  if (!at->scale || size != sizes[0]) return "no scale numeric with one number a mode";

  at->terrain = find_numeric(m, instance, 3, &size);
  if (at->terrain && at->terrain[0] != size) return "no valid terrain numeric";

  /* actuators of this instance -> modal joints */
  at->r = 0;
  int joint = -1;
  for (int i = 0; i < m->nactuator; i++) {
    if (m->actuator_plugin[i] != instance) continue;
    joint = m->actuator_trnid[2*i];
    if (m->actuator_trntype[i] != mjTRN_JOINT || m->jnt_type[joint] != mjJNT_SLIDE) {
      return "its actuators must drive slide joints";
    }
    if (at->r == sizes[0]) return "more actuators than modes";
    if (m->actuator_actnum[i] != 1)
      return "its actuators must have one activation each: the last target";
    at->ctrl[at->r] = m->actuator_ctrladr[i];
    at->act[at->r] = m->actuator_actadr[i];
    at->qpos[at->r] = m->jnt_qposadr[joint];
    at->dof[at->r++] = m->jnt_dofadr[joint];
  }
  if (at->r != sizes[0]) return "fewer actuators than modes";

  /* free joint of the body that carries the modes */
  at->root = m->body_rootid[m->jnt_bodyid[joint]];
  int root = m->body_jntadr[at->root];
  if (root < 0 || m->jnt_type[root] != mjJNT_FREE) return "its root body must have a free joint";
  at->qpos_root = m->jnt_qposadr[root];
  at->dof_root = m->jnt_dofadr[root];
  return NULL;
}

static void get_state(const mjData* d, const layout* at, double* x) {
  memcpy(x, d->qpos + at->qpos_root, 7*sizeof(double));
  memcpy(x + 7 + at->r, d->qvel + at->dof_root, 6*sizeof(double));
  for (int i = 0; i < at->r; i++) {
    x[7 + i] = d->qpos[at->qpos[i]];
    x[13 + at->r + i] = d->qvel[at->dof[i]];
    x[13 + 2*at->r + i] = d->act[at->act[i]];
  }
}

static void set_state(mjData* d, const layout* at, const double* x) {
  memcpy(d->qpos + at->qpos_root, x, 7*sizeof(double));
  memcpy(d->qvel + at->dof_root, x + 7 + at->r, 6*sizeof(double));
  for (int i = 0; i < at->r; i++) {
    d->qpos[at->qpos[i]] = x[7 + i];
    d->qvel[at->dof[i]] = x[13 + at->r + i];
    d->act[at->act[i]] = x[13 + 2*at->r + i];
  }
}

/* Target shape of the controls: scale * ctrl, controls clipped to the actuator's range. */
static void get_target(const mjModel* m, const mjData* d, const layout* at, int instance,
                       double* u) {
  int k = 0;
  for (int i = 0; i < m->nactuator && k < at->r; i++) {
    if (m->actuator_plugin[i] != instance) continue;
    int adr = at->ctrl[k];
    double c = d->ctrl[adr];
    if (!isfinite(c)) c = 0; /* MuJoCo has already warned */
    if (m->actuator_ctrllimited[adr]) {
      c = fmin(fmax(c, m->actuator_ctrlrange[2*adr]), m->actuator_ctrlrange[2*adr + 1]);
    }
    u[k] = at->scale[k]*c;
    k++;
  }
}

/* Place of a mocap body at the present time: where the model has it, moved by its velocity. */
static int moving_place(const mjModel* m, const mjData* d, int body, double place[3]) {
  if (m->nuser_body != 3 || m->body_mocapid[body] < 0) return 0;
  const mjtNum* velocity = m->body_user + 3*body;
  if (!velocity[0] && !velocity[1] && !velocity[2]) return 0;
  for (int k = 0; k < 3; k++) place[k] = m->body_pos[3*body + k] + velocity[k]*d->time;
  return 1;
}

/* Signed distance of the surface to the nearest collidable primitive geom, at most CUTOFF. */
static double clearance(const mjModel* m, mjData* d, const layout* at) {
  double x[MAX_STATE], place[3];
  get_state(d, at, x);
  mj_markStack(d);
  dp_geom* geoms = mj_stackAllocByte(d, (m->ngeom + 1)*sizeof(dp_geom), _Alignof(dp_geom));
  int n = 0;
  for (int i = 0; i < m->ngeom; i++) {
    int type = m->geom_type[i], body = m->geom_bodyid[i];
    if (!(m->geom_contype[i] | m->geom_conaffinity[i])) continue;
    if (m->body_rootid[body] == at->root || type == mjGEOM_HFIELD || type > mjGEOM_BOX) continue;
    dp_geom* g = geoms + n++;
    g->type = type;
    memcpy(g->size, m->geom_size + 3*i, sizeof(g->size));
    memcpy(g->pos, d->geom_xpos + 3*i, sizeof(g->pos));
    memcpy(g->mat, d->geom_xmat + 9*i, sizeof(g->mat));
    if (moving_place(m, d, body, place)) { /* mocap_pos may be of another time, e.g. in a rollout */
      for (int k = 0; k < 3; k++) g->pos[k] += place[k] - d->xpos[3*body + k];
    }
  }
  double distance = n ? dp_clearance(at->blob, x, n, geoms, CUTOFF, NULL, NULL) : CUTOFF;
  mj_freeStack(d);
  return distance;
}

static int plugin_nstate(const mjModel* m, int instance) {
  (void)m; (void)instance; /* called before the model has its numerics */
  return ST_SIZE;
}

static int plugin_nsensordata(const mjModel* m, int instance, int sensor) {
  (void)m; (void)instance; (void)sensor;
  return 1;
}

static int plugin_init(const mjModel* m, mjData* d, int instance) {
  (void)d;
  layout at;
  const char* wrong = find_layout(m, instance, &at);
  if (!wrong) {
    double par[DP_N_PAR];
    memcpy(par, at.options, sizeof(par));
    par[DP_TIMESTEP] = m->opt.timestep;
    const dp_model model = {at.blob, par, at.terrain, NULL};
    if (dp_check_model(&model)) wrong = "its body, options or terrain hold a number that cannot be";
    for (int i = 0; i < at.r; i++) {
      if (!isfinite(at.scale[i])) wrong = "its scale numeric is not finite";
    }
  }
  if (wrong) mju_warning("defplan.reduced_fem: %s", wrong);
  return wrong ? -1 : 0;
}

static void plugin_reset(const mjModel* m, mjtNum* state, void* data, int instance) {
  (void)m; (void)data; (void)instance;
  memset(state, 0, ST_SIZE*sizeof(mjtNum));
}

static void plugin_compute(const mjModel* m, mjData* d, int instance, int capability) {
  layout at;
  if (find_layout(m, instance, &at)) return;
  if (capability == mjPLUGIN_ACTUATOR) {
    if (m->opt.integrator == mjINT_RK4) { /* it computes several times a step */
      mju_error("defplan.reduced_fem: integrator RK4 is not supported, use Euler");
    }
    mjtNum* state = d->plugin_state + m->plugin_stateadr[instance];
    get_state(d, &at, state + ST_X);
    state[ST_READY] = 1;
  } else if (capability == mjPLUGIN_SENSOR) {
    for (int i = 0; i < m->nsensor; i++) {
      if (m->sensor_plugin[i] == instance) d->sensordata[m->sensor_adr[i]] = clearance(m, d, &at);
    }
  }
}

static void plugin_advance(const mjModel* m, mjData* d, int instance) {
  layout at;
  if (find_layout(m, instance, &at)) return;

  /* obstacles: mj_advance has already moved the time on */
  for (int i = 0; i < m->nbody; i++) {
    double place[3];
    if (moving_place(m, d, i, place)) {
      memcpy(d->mocap_pos + 3*m->body_mocapid[i], place, sizeof(place));
    }
  }

  /* with actuation disabled compute is not called: the joints coast under MuJoCo's own step */
  mjtNum* state = d->plugin_state + m->plugin_stateadr[instance];
  if (!state[ST_READY]) return;

  double par[DP_N_PAR], u[DP_MAX_MODES], x[MAX_STATE];
  dp_info info = {0, 0, 0, 0, 0};
  memcpy(par, at.options, sizeof(par));
  par[DP_TIMESTEP] = m->opt.timestep;
  get_target(m, d, &at, instance, u);
  const dp_model model = {at.blob, par, at.terrain, NULL};
  dp_step(&model, state + ST_X, u, x, &info);
  set_state(d, &at, x);
  state[ST_READY] = 0;
  state[ST_ITERATIONS] = info.iterations;
  state[ST_RESIDUAL] = info.residual;
  state[ST_FAILED] += info.failed;
  state[ST_DIVISION] = info.division;
}

/* Write the deformed surface into the vertices of the skin whose only bone is the body. */
static void plugin_visualize(const mjModel* m, mjData* d, const mjvOption* opt, mjvScene* scn,
                             int instance) {
  (void)opt; (void)scn;
  layout at;
  int sizes[5];
  if (find_layout(m, instance, &at)) return;
  dp_sizes(at.blob, sizes);
  for (int i = 0; i < m->nskin; i++) {
    int n = m->skin_vertnum[i];
    if (m->skin_bonenum[i] != 1 || m->skin_bonebodyid[m->skin_boneadr[i]] != at.root) continue;
    if (n != sizes[3]) continue;

    /* surface in the body frame: that of the body at the origin */
    double qpos[7 + DP_MAX_MODES] = {0, 0, 0, 1, 0, 0, 0};
    for (int k = 0; k < at.r; k++) qpos[7 + k] = d->qpos[at.qpos[k]];
    mj_markStack(d);
    double* points = mj_stackAllocByte(d, 3*n*sizeof(double), _Alignof(double));
    dp_surface(at.blob, qpos, points);
    float* vertex = m->skin_vert + 3*m->skin_vertadr[i];
    for (int k = 0; k < 3*n; k++) vertex[k] = (float)points[k];
    mj_freeStack(d);
  }
}

mjPLUGIN_LIB_INIT(defplan_plugin) {
  mjpPlugin plugin;
  mjp_defaultPlugin(&plugin);
  plugin.name = "defplan.reduced_fem";
  plugin.nattribute = 4;
  plugin.attributes = ATTRIBUTES;
  plugin.capabilityflags = mjPLUGIN_ACTUATOR | mjPLUGIN_SENSOR;
  plugin.needstage = mjSTAGE_POS;
  plugin.nstate = plugin_nstate;
  plugin.nsensordata = plugin_nsensordata;
  plugin.init = plugin_init;
  plugin.reset = plugin_reset;
  plugin.compute = plugin_compute;
  plugin.advance = plugin_advance;
  plugin.visualize = plugin_visualize;
  mjp_registerPlugin(&plugin);
}
