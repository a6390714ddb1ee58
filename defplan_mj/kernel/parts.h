/* What a dp_model names, as views of its arrays: the body, what it touches, where given forces act
 * (parts.c, which checks them). Arrays over basis functions (index 0 is the rest shape) are padded
 * to kp, arrays over drag points to np, modal arrays to rp: multiples of PAD, so that the compiler
 * fills whole vectors without a remainder. */
#ifndef DEFPLAN_PARTS_H
#define DEFPLAN_PARTS_H
#include "terrain.h"

typedef struct {
  int r, k, n_samples, n_patches, n_surface, n_contacts; /* true sizes */
  int rp, kp, nf, np, ns, nc; /* padded: modes, basis + 1, features, patches, surface, contacts */
  double mass, radius;        /* kg; bound of |y| at rest, m */
  const double* stiffness;    /* rp */
  const double* features;     /* 9 x r x samples: q -> skew 3, strain 6 */
  const double* weights_t;    /* nf (9 x samples) x kp: transposed weights, column 0 is zero */
  const double* weights;      /* kp x nf */
  const double* moments;      /* kp(b) x 9(i,j) x kp(a): S_ab */
  const double* trace;        /* kp: tr S_0a */
  const double* points;       /* kp x 3 x np: patch centres */
  const double *tangent1, *tangent2; /* kp x 3 x np */
  const double* areas;               /* np */
  const double* surface;             /* kp x 3 x ns */
  const double* contacts;            /* kp x 3 x nc: points that can touch the terrain */
} Body;

/* View a blob of n doubles: 0, or a negative code if its header or its size is wrong. The numbers
 * behind the header are not looked at: dp_check_model does that once, where a model is loaded. */
int body_view(Body* b, const double* blob, size_t n);
/* The same, taking the size from the blob itself. */
int body_view_own(Body* b, const double* blob);

/* Points of the body that take given forces. */
typedef struct {
  int n, np;           /* true and padded number */
  const double* field; /* kp x 3 x np */
} Feet;

int feet_view(Feet* f, const Body* b, const double* feet, size_t n);

/* All of a model, checked and counted. */
typedef struct {
  const dp_model* model;
  Body body;
  Terrain terrain;
  Feet feet;
  int nu;              /* size of an input */
  int substeps, euler; /* of a step; whether implicit Euler is the integrator */
} Parts;

/* 0, or a negative code if something about the model cannot be: NO_BODY if `body` is not one. */
enum { NO_BODY = -1 };
int parts_view(Parts* p, const dp_model* m);
/* Contact points that are looked at: none without a terrain. */
static inline int contacts_of(const Parts* p) {
  return terrain_parts(&p->terrain) ? p->body.nc : 0;
}
#endif
