/* A* over manoeuvres, sequences of gait cycles, among points that stand still. */
#include <math.h>
#include <string.h>

#include "kernel.h"
#include "outlook.h"

typedef struct {
  double position[MAX_D], frame[MAX_D * MAX_D], cycles, estimate;
  int first, last;      /* gaits: of the way's beginning, and of its last cycle */
  short key[2 * MAX_D]; /* cell and heading: poses of one key count as one */
  short near;           /* the target is reached, or the way is long enough */
} Node;

static size_t table_of(int nodes) {
  size_t table = 1;
  while (table < 2 * (size_t)nodes) table *= 2;
  return table;
}

static int room_of(const dp_astar_problem* p) {
  int most = 0;
  for (int s = 0; s < p->n_sets; s++) {
    const int count = p->steps_at[s + 1] - p->steps_at[s];
    most = count > most ? count : most;
  }
  return p->nodes + most;
}

size_t dp_astar_size(const dp_astar_problem* p) {
  int most = 0;
  for (int s = 0; s < p->n_sets; s++) {
    const int count = p->ways_at[s + 1] - p->ways_at[s];
    most = count > most ? count : most;
  }
  const size_t room = room_of(p);
  return room * (sizeof(Node) + sizeof(int)) + table_of(room) * sizeof(int) + most +
         (size_t)p->n_points * p->d * sizeof(double);
}

static double rest(const dp_astar_problem* p, const Node* at) {
  return cycles_left(p->d, at->position, at->frame, p->target, p->goal_radius, p->advance,
                     p->per_radian, p->n_axes, p->axes);
}

/* Which cycles of a set may be done at a pose, by how close they come to points; near: scratch. */
static void free_ways(const dp_astar_problem* p, const Node* at, double* near,
                      unsigned char* is_free) {
  const int d = p->d, set = at->last, from = p->ways_at[set], n = p->ways_at[set + 1] - from;
  const double wide = p->clearance, least = p->least, reach = p->reach[set] + wide;
  const double half = 0.5 * (wide + least);
  int count = 0;
  for (int b = 0; b < p->n_points; b++) {
    double offset[MAX_D];
    for (int i = 0; i < d; i++) offset[i] = p->points[b * d + i] - at->position[i];
    if (dot(offset, offset, d) >= reach * reach) continue;
    for (int j = 0; j < d; j++) {
      near[count * d + j] = 0;
      for (int i = 0; i < d; i++) near[count * d + j] += offset[i] * at->frame[i * d + j];
    }
    count++;
  }
  for (int w = 0; w < n; w++) {
    const double *start = p->starts + (from + w) * d, *end = p->ends + (from + w) * d;
    double edge[MAX_D], start2 = INFINITY, end2 = INFINITY, way2 = INFINITY;
    for (int i = 0; i < d; i++) edge[i] = end[i] - start[i];
    const double length2 = fmax(dot(edge, edge, d), 1e-12);
    for (int b = 0; b < count; b++) {
      double local[MAX_D];
      for (int i = 0; i < d; i++) local[i] = near[b * d + i] - start[i];
      const double here2 = dot(local, local, d), along = dot(local, edge, d);
      double share = along / length2;
      share = share < 0 ? 0 : share > 1 ? 1 : share;
      start2 = fmin(start2, here2);
      end2 = fmin(end2, here2 - 2 * along + length2);
      way2 = fmin(way2, here2 + share * (share * length2 - 2 * along));
    }
    /* who is too close already may gain some room, or turn in its place with half the margin */
    const int turns = p->in_place[from + w] && way2 > half * half;
    const int gains = start2 < wide * wide && (end2 > start2 || turns);
    const int before = p->parents[from + w];
    is_free[w] = way2 >= least * least && (way2 >= wide * wide || gains) &&
                 (before < 0 || is_free[before]);
  }
}

static int before(const Node* nodes, int a, int b) { /* equal estimates: the older one */
  const double x = nodes[a].estimate, y = nodes[b].estimate;
  return x < y || (x == y && a < b);
}

static void push(const Node* nodes, int* heap, int n, int entry) {
  while (n > 0 && before(nodes, entry, heap[(n - 1) / 2])) {
    heap[n] = heap[(n - 1) / 2];
    n = (n - 1) / 2;
  }
  heap[n] = entry;
}

static int pop(const Node* nodes, int* heap, int n) { /* n: left after it */
  const int top = heap[0], moved = heap[n];
  int i = 0;
  for (int child; (child = 2 * i + 1) < n; i = child) {
    if (child + 1 < n && before(nodes, heap[child + 1], heap[child])) child++;
    if (!before(nodes, heap[child], moved)) break;
    heap[i] = heap[child];
  }
  heap[i] = moved;
  return top;
}

/* Whether a pose of this node's key was gone on from; if not, it is noted. */
static int is_closed(const Node* nodes, int* table, size_t size, int node) {
  unsigned long key = 1469598103934665603UL;
  for (int i = 0; i < 2 * MAX_D; i++)
    key = (key ^ (unsigned short)nodes[node].key[i]) * 1099511628211UL;
  for (size_t slot = (key ^ key >> 29) & (size - 1);; slot = (slot + 1) & (size - 1)) {
    if (!table[slot]) {
      table[slot] = node + 1;
      return 0;
    }
    if (!memcmp(nodes[table[slot] - 1].key, nodes[node].key, sizeof(nodes->key))) return 1;
  }
}

static void follow(const dp_astar_problem* p, const Node* from, int step, Node* to) {
  const int d = p->d;
  const double *R = p->rotations + step * d * d, *t = p->translations + step * d;
  memset(to, 0, sizeof(Node));
  for (int i = 0; i < d; i++) {
    to->position[i] = from->position[i] + dot(from->frame + i * d, t, d);
    double heading = 0;
    for (int j = 0; j < d; j++) {
      double sum = 0;
      for (int l = 0; l < d; l++) sum += from->frame[i * d + l] * R[l * d + j];
      to->frame[i * d + j] = sum;
      heading += sum * p->axes[j];
    }
    to->key[i] = (short)floor(to->position[i] / p->cell);
    to->key[MAX_D + i] = (short)rint(heading / p->heading);
  }
  to->cycles = from->cycles + p->cycles[step];
  to->first = from->first < 0 ? p->firsts[step] : from->first;
  to->last = p->finals[step];
}

int dp_astar(const dp_astar_problem* p, void* memory) {
  const int d = p->d, room = room_of(p);
  const size_t size = table_of(room);
  Node* nodes = memory;
  double* near = (double*)(nodes + room);
  int *heap = (int*)(near + (size_t)p->n_points * d), *table = heap + room;
  unsigned char* is_free = (unsigned char*)(table + size);
  memset(table, 0, size * sizeof(int));
  memset(nodes, 0, sizeof(Node));
  for (int i = 0; i < d; i++) nodes[0].frame[i * d + i] = 1;
  nodes[0].first = -1;
  nodes[0].last = p->before;
  int made = 1, open = 1, fallback = -1;
  double nearest = INFINITY;
  heap[0] = 0;
  while (open > 0 && made < p->nodes) {
    const int current = pop(nodes, heap, --open);
    const Node* from = nodes + current;
    if (from->near) return from->first;
    if (is_closed(nodes, table, size, current)) continue;
    const int set = from->last;
    free_ways(p, from, near, is_free);
    for (int step = p->steps_at[set]; step < p->steps_at[set + 1]; step++) {
      if (!is_free[p->ends_with[step]]) continue;
      Node* next = nodes + made;
      follow(p, from, step, next);
      const double left = rest(p, next), away2 = dot(next->position, next->position, d);
      next->near = left == 0 || away2 > p->horizon * p->horizon;
      next->estimate = next->cycles + p->weight * left;
      if (left < nearest) nearest = left, fallback = next->first;
      push(nodes, heap, open++, made++);
    }
  }
  return fallback;
}
