/* Views of what a model names, and whether all of it can be. */
#include "parts.h"

#define BLOB_MAGIC 20181018.0
#define BLOB_VERSION 2.0
enum { HEADER = 16 };
enum { FEET_HEADER = 8 }; /* size, number */

int body_view(Body* b, const double* blob, size_t n) {
  if (!blob || n < HEADER || blob[0] != BLOB_MAGIC) return -1;
  if (blob[1] != BLOB_VERSION) return -2;
  if (blob[2] != (double)n) return -3;
  static const int counts[] = {3, 4, 5, 6, 7, 10};
  for (int i = 0; i < 6; i++)
    if (!is_count(blob[counts[i]], 1e7)) return -4;
  if (!(blob[8] > 0 && blob[9] >= 0 && is_finite(blob, HEADER))) return -4;
  b->r = (int)blob[3], b->k = (int)blob[4], b->n_samples = (int)blob[5];
  b->n_patches = (int)blob[6], b->n_surface = (int)blob[7];
  b->mass = blob[8], b->radius = blob[9], b->n_contacts = (int)blob[10];
  if (b->r < 1 || b->r > DP_MAX_MODES || b->k < 1 || b->k > DP_MAX_BASIS) return -4;
  if (b->n_samples < 1 || b->n_samples > DP_MAX_SAMPLES) return -4;
  if (b->n_patches < 0 || b->n_patches > DP_MAX_POINTS || b->n_surface < 0) return -4;
  if (b->n_contacts < 0 || b->n_contacts > DP_MAX_CONTACTS) return -4;
  b->rp = padded(b->r), b->kp = padded(b->k + 1), b->nf = 9 * padded(b->n_samples);
  b->np = padded(b->n_patches), b->ns = padded(b->n_surface), b->nc = padded(b->n_contacts);
  const double* p = blob + HEADER;
  size_t kp = b->kp;
  b->stiffness = p, p += b->rp;
  b->features = p, p += (size_t)b->nf * b->r;
  b->weights_t = p, p += b->nf * kp;
  b->weights = p, p += kp * b->nf;
  b->moments = p, p += kp * 9 * kp;
  b->trace = p, p += kp;
  b->points = p, p += kp * 3 * b->np;
  b->tangent1 = p, p += kp * 3 * b->np;
  b->tangent2 = p, p += kp * 3 * b->np;
  b->areas = p, p += b->np;
  b->surface = p, p += kp * 3 * b->ns;
  b->contacts = p, p += kp * 3 * b->nc;
  return p == blob + n ? 0 : -3;
}

int body_view_own(Body* b, const double* blob) {
  if (!blob || !is_count(blob[2], 1e9)) return -3;
  return body_view(b, blob, (size_t)blob[2]);
}

int dp_check(const double* blob, size_t n) {
  Body b;
  return body_view(&b, blob, n);
}

int parts_view(Parts* p, const dp_model* m) {
  p->model = m;
  if (body_view_own(&p->body, m->body)) return NO_BODY;
  if (m->terrain && !is_count(m->terrain[0], 1e9)) return -3;
  if (terrain_view(&p->terrain, m->terrain, m->terrain ? (size_t)m->terrain[0] : 0)) return -3;
  if (m->feet && !is_count(m->feet[0], 1e9)) return -3;
  if (feet_view(&p->feet, &p->body, m->feet, m->feet ? (size_t)m->feet[0] : 0)) return -3;
  p->nu = p->body.r + 3 * p->feet.n, p->substeps = 1, p->euler = 0;
  const double* par = m->par;
  if (!par) return 0; /* geometry only */
  if (!is_finite(par, DP_N_PAR)) return -2;
  static const int positive[] = {DP_FLUID_DENSITY, DP_DRAG_NORMAL, DP_DRAG_TANGENT, DP_CONTROL,
                                 DP_DAMPING};
  for (int i = 0; i < 5; i++)
    if (par[positive[i]] < 0) return -2;
  if (!(par[DP_TIMESTEP] > 0 && par[DP_TIMESTEP] < 1e6 && par[DP_TOLERANCE] > 0 &&
        par[DP_MAX_NEWTON] >= 1))
    return -2;
  if (!is_count(par[DP_SUBSTEPS], DP_MAX_SUBSTEPS) || par[DP_SUBSTEPS] < 1) return -2;
  if (!is_count(par[DP_INTEGRATOR], DP_IMPLICIT_EULER)) return -2;
  p->substeps = (int)par[DP_SUBSTEPS], p->euler = par[DP_INTEGRATOR] == DP_IMPLICIT_EULER;
  return 0;
}

int dp_check_model(const dp_model* m) {
  Parts p;
  const int wrong = parts_view(&p, m);
  if (wrong) return wrong;
  if (!is_finite(m->body, (size_t)m->body[2])) return -5;
  if (m->terrain && !is_finite(m->terrain, (size_t)m->terrain[0])) return -5;
  return m->feet && !is_finite(m->feet, (size_t)m->feet[0]) ? -5 : 0;
}

void dp_sizes(const double* blob, int sizes[5]) {
  static const int at[5] = {3, 4, 6, 7, 10};
  for (int i = 0; i < 5; i++) sizes[i] = (int)blob[at[i]];
}

int feet_view(Feet* f, const Body* b, const double* feet, size_t n) {
  f->n = f->np = 0, f->field = NULL;
  if (!feet) return 0;
  if (n < FEET_HEADER || feet[0] != (double)n) return -3;
  if (!is_count(feet[1], DP_MAX_FEET) || feet[1] < 1) return -4;
  f->n = (int)feet[1], f->np = padded(f->n), f->field = feet + FEET_HEADER;
  return n == FEET_HEADER + (size_t)3 * b->kp * f->np ? 0 : -3;
}

int dp_check_feet(const double* blob, const double* feet, size_t n) {
  Body b;
  Feet f;
  return body_view_own(&b, blob) || feet_view(&f, &b, feet, n);
}

int dp_state_size(const double* blob) { return 13 + 3 * (int)blob[3]; }
