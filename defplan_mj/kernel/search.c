/* A* over gait cycles among balls that may move: a way for a rigid robot, in place and time. */
#include <math.h>
#include <string.h>

#include "kernel.h"
#include "outlook.h"

typedef struct {
  double position[MAX_D], frame[MAX_D * MAX_D], estimate;
  int parent, past, gait, depth; /* depth: in decisions */
} Node;

size_t dp_search_size(int nodes) {
  size_t table = 1;
  while (table < 2 * (size_t)nodes) table *= 2;
  return nodes * sizeof(Node) + (nodes + table) * sizeof(int);
}

static double rest(const dp_search_problem* p, const Node* at) {
  const double* axes = p->axes + (long)p->phase[at->past] * p->n_axes * p->d;
  return cycles_left(p->d, at->position, at->frame, p->target, p->goal_radius, p->advance,
                     p->per_radian, p->n_axes, axes);
}

/* Whether the straight way of a decision, `begun` decisions from now, keeps clear of all balls. */
static int is_free(const dp_search_problem* p, const double* start, const double* end, int begun) {
  const int d = p->d;
  for (int b = 0; b < p->n_balls; b++) {
    const double *ball = p->balls + b * (2 * d + 1), *drift = ball + d + 1;
    double offset[MAX_D], edge[MAX_D];
    for (int i = 0; i < d; i++) {
      offset[i] = ball[i] + begun * drift[i] - start[i];
      edge[i] = end[i] - start[i] - drift[i];
    }
    const double wide = ball[d] + p->margin, here2 = dot(offset, offset, d);
    const double length2 = dot(edge, edge, d), along = dot(offset, edge, d);
    const double reach = wide + sqrt(length2);
    if (here2 > reach * reach) continue;
    double share = length2 > 1e-12 ? along / length2 : 0;
    share = share < 0 ? 0 : share > 1 ? 1 : share;
    const double way2 = here2 + share * (share * length2 - 2 * along);
    if (way2 >= wide * wide) continue;
    /* one that is too close already may gain some room */
    const int leaves = here2 < wide * wide && length2 - 2 * along > 0;
    if (way2 < ball[d] * ball[d] || !leaves) return 0;
  }
  return 1;
}

/* Nodes of one key count as one: cell, heading, and the time if anything moves. */
static unsigned long key_of(const dp_search_problem* p, const Node* node, int moving) {
  const int d = p->d;
  unsigned long key = 1469598103934665603UL;
  for (int i = 0; i < d; i++) {
    double heading = 0;
    for (int j = 0; j < d; j++) heading += node->frame[i * d + j] * p->axes[j];
    const long parts[2] = {lround(node->position[i] / p->cell), lround(heading / p->heading)};
    for (int k = 0; k < 2; k++) key = (key ^ (unsigned long)parts[k]) * 1099511628211UL;
  }
  if (moving) key = (key ^ (unsigned long)node->depth) * 1099511628211UL;
  key ^= key >> 29;
  return key * 0x9E3779B97F4A7C15UL >> 8;
}

/* How many decisions the next choice of a way is kept for: the first ones are made one by one,
 * others until a cycle ends. */
static int hold_of(const dp_search_problem* p, const Node* node) {
  return node->depth < p->single ? 1 : p->decisions - p->phase[node->past];
}

/* Plays a gait for some decisions; returns whether it keeps clear of all balls. */
static int play(const dp_search_problem* p, Node* node, int gait, int hold) {
  const int d = p->d;
  node->gait = gait;
  for (; hold > 0; hold--, node->depth++) {
    const int at = node->past * p->n_gaits + gait;
    const double *R = p->rotations + (long)at * d * d, *t = p->translations + (long)at * d;
    double position[MAX_D], frame[MAX_D * MAX_D];
    for (int i = 0; i < d; i++) {
      position[i] = node->position[i] + dot(node->frame + i * d, t, d);
      for (int j = 0; j < d; j++) {
        double sum = 0;
        for (int l = 0; l < d; l++) sum += node->frame[i * d + l] * R[l * d + j];
        frame[i * d + j] = sum;
      }
    }
    if (!is_free(p, node->position, position, node->depth)) return 0;
    memcpy(node->position, position, d * sizeof(double));
    memcpy(node->frame, frame, d * d * sizeof(double));
    node->past = p->then[at];
  }
  return 1;
}

static void push(const Node* nodes, int* heap, int n, int entry) {
  while (n > 0 && nodes[heap[(n - 1) / 2]].estimate > nodes[entry].estimate) {
    heap[n] = heap[(n - 1) / 2];
    n = (n - 1) / 2;
  }
  heap[n] = entry;
}

static int pop(const Node* nodes, int* heap, int n) { /* n: left after it */
  const int top = heap[0], moved = heap[n];
  int i = 0;
  for (int child; (child = 2 * i + 1) < n; i = child) {
    if (child + 1 < n && nodes[heap[child + 1]].estimate < nodes[heap[child]].estimate) child++;
    if (nodes[heap[child]].estimate >= nodes[moved].estimate) break;
    heap[i] = heap[child];
  }
  heap[i] = moved;
  return top;
}

int dp_search(const dp_search_problem* p, void* memory, int* plan) {
  const int d = p->d, k = p->n_gaits;
  size_t table = 1;
  while (table < 2 * (size_t)p->nodes) table *= 2;
  Node* nodes = memory;
  int *heap = (int*)(nodes + p->nodes), *keys = heap + p->nodes;
  memset(keys, 0, table * sizeof(int));
  int moving = 0;
  for (int b = 0; b < p->n_balls; b++)
    for (int i = 0; i < d; i++) moving |= p->balls[b * (2 * d + 1) + d + 1 + i] != 0;
  memset(nodes, 0, sizeof(Node));
  for (int i = 0; i < d; i++) nodes[0].frame[i * d + i] = 1;
  nodes[0].parent = -1;
  nodes[0].past = p->before;
  /* within the first cycle there are few nodes, and none is where another one was at its phase */
  const int first = p->decisions - p->phase[p->before];
  int made = 1, open = 1, found = -1, best = 0;
  double nearest = INFINITY;
  heap[0] = 0;
  while (open > 0 && found < 0) {
    const int current = pop(nodes, heap, --open);
    const Node from = nodes[current];
    const double away2 = dot(from.position, from.position, d);
    if (current > 0 && (away2 > p->horizon * p->horizon || rest(p, &from) == 0)) {
      found = current;
      break;
    }
    if (from.depth + hold_of(p, &from) > p->cycles) continue;
    const int hold = hold_of(p, &from);
    for (int gait = 0; gait < k && made < p->nodes; gait++) {
      Node* next = nodes + made;
      *next = from;
      if (!play(p, next, gait, hold)) continue;
      next->parent = current;
      const double left = rest(p, next);
      next->estimate = next->depth / (double)p->decisions + p->weight * left;
      if (next->depth >= first) {
        const unsigned long key = key_of(p, next, moving);
        size_t slot = key % table;
        int known = 0;
        for (; keys[slot]; slot = (slot + 1) % table)
          if (key_of(p, nodes + keys[slot], moving) == key) {
            known = nodes[keys[slot]].depth <= next->depth;
            break;
          }
        if (known) continue;
        keys[slot] = made;
      }
      /* without a way: as long as it is worth to look ahead, then as near as can be */
      const double worth = left + 1000.0 * (next->depth < p->enough ? p->enough - next->depth : 0);
      if (worth < nearest) nearest = worth, best = made;
      push(nodes, heap, open++, made++);
    }
    if (made >= p->nodes) break;
  }
  const int last = found >= 0 ? found : best;
  for (int i = last; i > 0; i = nodes[i].parent)
    for (int j = nodes[nodes[i].parent].depth; j < nodes[i].depth; j++) plan[j] = nodes[i].gait;
  return found >= 0 ? nodes[last].depth : -nodes[last].depth;
}
