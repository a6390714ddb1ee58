"""Makes a closed, outward surface of triangles as they come, and says what it did."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from defplan_mj.base.errors import DefplanError
from defplan_mj.body.cells import split_polygons
from defplan_mj.body.fidelity import MOST_DISTANCE, distances_of, winding
from defplan_mj.body.intersections import crossing_triangles
from defplan_mj.body.surface import Surface, merge_vertices
from defplan_mj.body.touching import contact

_WELDS = (1e-7, 1e-6, 1e-5, 1e-4)  # of the length; as far as needed
_MOST_CORNERS = 200  # of a hole that is capped like a polygon; larger ones from their middle
_MOST_CAP = 0.46  # of the whole area that caps may be: of a sheet they are a half
_CRUMB = 1e-3  # share of the volume up to which a separate piece is left out
_TOUCH = 2e-3  # of the length
_PUSH = 4e-3  # of the length: how far pieces that touch are moved into each other
_MOST_PIECES = 200  # compared with each other


@dataclass(frozen=True)
class Repaired:
    """A closed surface.

    Attributes:
        simple: no triangles cross and no edge is crowded: the lattice can fill it.
        overlaps: its pieces overlap, or it crosses itself.
        said: what was mended, a sentence each.
        own: the surface without the caps of its holes, if it has any.
    """

    surface: Surface
    simple: bool
    overlaps: bool
    said: tuple[str, ...]
    own: Surface | None = None


def repair(vertices: np.ndarray, faces: np.ndarray, path: object) -> Repaired:
    """Weld, turn, close and sort the pieces of a surface.

    Raises:
        DefplanError: it is in pieces apart, a sheet, or has too large a hole.
    """
    said: list[str] = []
    size = float(np.ptp(vertices[np.unique(faces)], axis=0).max())
    vertices, faces = _weld(vertices, faces, size, said)
    if len(faces) == 0:
        raise DefplanError(f"{path} is empty: all its triangles collapse")
    faces = _without_doubles(faces, said)
    faces = _agree(faces, said)
    given = len(faces)
    vertices, faces = _close(vertices, faces, size, path, said)
    caps = _keys(faces[given:], len(vertices))
    closed, used_before = vertices, np.unique(faces)
    label = edge_pieces(faces)
    faces, label = _outward(vertices, faces, label, path, said)
    crowded = bool(_edge_counts(faces).max(initial=0) > 2)
    pairs = crossing_triangles(vertices, faces)
    several = bool((label[pairs[:, 0]] != label[pairs[:, 1]]).any())  # before crumbs are dropped
    vertices, faces, label = _sort(vertices, faces, label, pairs, size, path, said)
    _check_lost(closed, faces, np.setdiff1d(used_before, faces), size, path, said)
    if len(pairs):
        said.append(
            "joined pieces that overlap"
            if several
            else f"made one surface of one that crosses itself ({len(pairs)} pairs of triangles)"
        )
    if crowded:
        said.append("made a simple surface of one with edges of more than two triangles")
    capped = np.isin(_keys(faces, len(vertices)), caps)
    used, faces = np.unique(faces, return_inverse=True)
    surface = Surface(vertices[used], faces.reshape(-1, 3))
    own = Surface(surface.vertices, surface.faces[~capped]) if capped.any() else None
    apart = len(np.unique(label)) > 1 and not any(text.startswith("kept") for text in said)
    simple = not len(pairs) and not crowded and not apart and not any("touch" in t for t in said)
    return Repaired(surface, simple, not simple, tuple(said), own)


def _check_lost(
    vertices: np.ndarray,
    faces: np.ndarray,
    lost: np.ndarray,
    size: float,
    path: object,
    said: list[str],
) -> None:
    """Refuse a body that has lost its extents with what was left out; say how far that reached otherwise."""
    if len(lost) == 0:
        return
    kept = vertices[np.unique(faces)]
    out = np.maximum(kept.min(0) - vertices[lost], vertices[lost] - kept.max(0)).max() / size
    if out > MOST_DISTANCE:
        raise DefplanError(
            f"{path} has parts without volume or apart from its body that stick out by {out:.1%} of the"
            " length: give them a thickness, join them to the body or delete them"
        )
    gap, inside = distances_of(vertices[lost], Surface(vertices, faces))
    far = float(np.where(inside, 0.0, gap).max()) / size
    if far > MOST_DISTANCE:
        said.append(f"what was left out reached {far:.1%} of the length out of the body")


def _keys(faces: np.ndarray, base: int) -> np.ndarray:
    """Return a number (f,) for the corners of each triangle, whatever their order."""
    low, middle, high = np.sort(faces, axis=1).T
    return (low * base + middle) * base + high


def _directed(faces: np.ndarray) -> np.ndarray:
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for the 3 f directed edges the number of their undirected one, its count, the direction."""
    ends = _directed(faces)
    low, high = ends.min(1), ends.max(1)
    _, index = np.unique(low * (int(faces.max()) + 1) + high, return_inverse=True)
    return index, np.bincount(index), np.where(ends[:, 0] < ends[:, 1], 1, -1)


def _edge_counts(faces: np.ndarray) -> np.ndarray:
    return _edges(faces)[1]


def _open(faces: np.ndarray) -> int:
    """Count the edges with an odd number of triangles."""
    return int((_edge_counts(faces) % 2).sum()) if len(faces) else 0


def _weld(
    vertices: np.ndarray, faces: np.ndarray, size: float, said: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices at one place; open edges make it look a little farther."""
    vertices, faces = merge_vertices(vertices, faces)
    best, least = (vertices, faces), _open(faces)
    for share in _WELDS:
        if least == 0:
            break
        pairs = cKDTree(vertices).query_pairs(share * size, output_type="ndarray")
        if len(pairs) > 20 * len(vertices):
            break
        graph = coo_matrix((np.ones(len(pairs)), pairs.T), (len(vertices),) * 2)
        label = connected_components(graph, False)[1]
        _, first = np.unique(label, return_index=True)
        joined = label[faces]
        a, b, c = joined.T
        joined = joined[(a != b) & (b != c) & (c != a)]
        left = _open(joined)
        if left < least and len(joined) > 0.9 * len(faces):
            number = len(vertices) - len(first)
            best, least = (vertices[first], joined), left
            note = f"welded {number} vertices that lie within {share:.0e} of the length of others"
            if share > _WELDS[0]:
                said[:] = [note]
    return best


def _without_doubles(faces: np.ndarray, said: list[str]) -> np.ndarray:
    """Drop repeated triangles; two that face each other vanish both if they are a wall inside.

    Otherwise they are the two sides of a surface that is drawn from both, and one of them stays.
    """
    corners = np.sort(faces, axis=1)
    _, first, index, count = np.unique(
        corners, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    if count.max() == 1:
        return faces
    a, b, c = faces.T
    odd = np.where(((a < b) & (b < c)) | ((b < c) & (c < a)) | ((c < a) & (a < b)), 1, -1)
    net = np.bincount(index.ravel(), odd)
    keep = np.full(len(faces), False)
    keep[first[net != 0]] = True
    # of those that agree, the first with the sign of the sum stands for all
    wrong = keep & (odd * net[index.ravel()] < 0)
    kept = faces.copy()
    kept[wrong] = kept[wrong][:, ::-1]
    walls = first[net == 0]
    if len(walls):
        one_sided = keep.copy()
        one_sided[walls] = True
        if not keep.any() or _open(kept[one_sided]) < _open(kept[keep]):
            keep = one_sided
    said.append(f"dropped {len(faces) - int(keep.sum())} double triangles")
    return kept[keep]


def _agree(faces: np.ndarray, said: list[str]) -> np.ndarray:
    """Turn triangles so that neighbours agree which side is outside, if that can be.

    The graph has each triangle twice, as it is and turned; a component that holds both of one is
    a one-sided surface and stays as it is.
    """
    index, count, direction = _edges(faces)
    n = len(faces)
    owner = np.tile(np.arange(n), 3)
    order = np.argsort(index, kind="stable")
    start = np.cumsum(count) - count
    two = start[count == 2]
    first, second = order[two], order[two + 1]
    same = direction[first] == direction[second]  # they run alike: one has to be turned
    if not same.any():
        return faces
    f, g = owner[first], owner[second]
    rows = np.concatenate([f, f + n])
    columns = np.concatenate([np.where(same, g + n, g), np.where(same, g, g + n)])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), (2 * n, 2 * n))
    label = connected_components(graph, False)[1]
    sided = label[:n] != label[n:]
    # of the two ways to agree, the one that turns fewer triangles: as it is, in most files
    pieces, piece = np.unique(np.minimum(label[:n], label[n:]), return_inverse=True)
    flipped = (label[:n] > label[n:]) & sided
    share = np.bincount(piece, flipped, len(pieces)) / np.bincount(piece, minlength=len(pieces))
    turn = flipped ^ ((share > 0.5)[piece] & sided)
    if turn.any():
        said.append(f"turned {int(turn.sum())} triangles that faced the wrong way")
    return np.where(turn[:, None], faces[:, ::-1], faces)


def _close(
    vertices: np.ndarray, faces: np.ndarray, size: float, path: object, said: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Cap the loops of edges that have more triangles on one side; caps come last."""
    index, _, direction = _edges(faces)
    balance = np.bincount(index, direction)
    ends = _directed(faces)
    _, first = np.unique(index, return_index=True)
    low, high = ends[first].min(1), ends[first].max(1)
    surplus = np.flatnonzero(balance)
    if len(surplus) == 0:
        return vertices, faces
    follow: dict[int, list[int]] = {}
    for edge in surplus:  # the cap runs against the triangles
        a, b = int(low[edge]), int(high[edge])
        if balance[edge] > 0:
            a, b = b, a
        for _ in range(abs(int(balance[edge]))):
            follow.setdefault(a, []).append(b)
    loops: list[list[int]] = []
    for start in sorted(follow):
        while follow[start]:
            loops += _walk(start, follow)
    extents = [float(np.ptp(vertices[loop], axis=0).max()) / size for loop in loops]
    edges = sum(map(len, loops))
    caps: list[np.ndarray] = []
    middles: list[np.ndarray] = []
    for loop in loops:
        if 3 <= len(loop) <= _MOST_CORNERS:
            caps.append(split_polygons(vertices, np.array([loop])))
        elif len(loop) > 3:
            centre = len(vertices) + len(middles)
            middles.append(vertices[loop].mean(0))
            ring = np.array(loop)
            caps.append(np.stack([ring, np.roll(ring, -1), np.full(len(ring), centre)], axis=1))
    if middles:
        vertices = np.vstack([vertices, middles])
    if caps:
        cap = np.concatenate(caps)
        share = Surface(vertices, cap).area
        share /= share + Surface(vertices, faces).area
        if share > _MOST_CAP:
            raise DefplanError(
                f"{path} is open like a sheet or a shell: to close it ({edges} open edges), caps"
                f" would be {share:.0%} of its surface; give it a thickness"
            )
        faces = np.concatenate([faces, cap])
    holes = f"{len(loops)} holes" if len(loops) > 1 else "1 hole"
    said.append(f"closed {holes}, {edges} edges, the largest {max(extents):.1%} of the length")
    return vertices, faces


def _walk(start: int, follow: dict[int, list[int]]) -> list[list[int]]:
    """Return the simple loops of one walk from `start` back to it; its edges are used up."""
    loops, trail, place = [], [start], {start: 0}
    while follow.get(trail[-1]):
        after = follow[trail[-1]].pop(0)
        if after in place:
            loop = trail[place[after] :]
            loops.append(loop)
            for vertex in loop[1:]:
                del place[vertex]
            trail = trail[: place[after] + 1]
        else:
            place[after] = len(trail)
            trail.append(after)
    return loops


def edge_pieces(faces: np.ndarray) -> np.ndarray:
    """Return the piece (f,) of each triangle; pieces hang together by edges."""
    index, count, _ = _edges(faces)
    n, owner = len(faces), np.tile(np.arange(len(faces)), 3)
    graph = coo_matrix((np.ones(3 * n), (owner, n + index)), (n + len(count),) * 2)
    return np.unique(connected_components(graph, False)[1][:n], return_inverse=True)[1]


def _piece_volumes(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> np.ndarray:
    corners = vertices[faces] - vertices[faces].reshape(-1, 3).mean(0)
    six = np.einsum("fi,fi->f", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2])
    return np.bincount(label, six) / 6.0


def _outward(
    vertices: np.ndarray, faces: np.ndarray, label: np.ndarray, path: object, said: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Turn pieces that are inside out, and drop those without volume."""
    volume = _piece_volumes(vertices, faces, label)
    most = np.abs(volume).max()
    size = np.ptp(vertices[np.unique(faces)], axis=0).max()
    if most < 1e-9 * size**3:
        raise DefplanError(f"{path} encloses no volume: give it a thickness")
    empty = np.abs(volume) < 1e-7 * most
    if empty.any():
        keep = ~empty[label]
        said.append(f"left out {int((~keep).sum())} triangles of pieces without volume")
        faces, label = faces[keep], label[keep]
    # cavities, which face inwards by right, are sorted later
    turned = volume < 0.0
    if turned.any():
        faces = np.where(turned[label][:, None], faces[:, ::-1], faces)
        if turned.all() or not (~turned & ~empty).any():
            said.append("turned it, which was inside out")
    return faces, np.unique(label, return_inverse=True)[1]


def _sort(
    vertices: np.ndarray,
    faces: np.ndarray,
    label: np.ndarray,
    pairs: np.ndarray,
    size: float,
    path: object,
    said: list[str],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn pieces inside others inwards (cavities); refuse pieces that lie apart."""
    n = int(label.max()) + 1
    if n == 1:
        return vertices, faces, label
    if n > _MOST_PIECES:
        raise DefplanError(f"{path} is in {n} pieces: join them into one closed surface")
    volume = _piece_volumes(vertices, faces, label)
    crossed = coo_matrix((np.ones(len(pairs)), (label[pairs[:, 0]], label[pairs[:, 1]])), (n, n))
    group = connected_components(crossed, False)[1]
    alone = np.bincount(group)[group] == 1
    within = np.zeros((n, n), bool)  # [i, j]: piece i lies in piece j
    for i in range(n):
        point = vertices[faces[label == i][0]].mean(0)
        for j in range(n):
            if group[i] != group[j]:
                within[i, j] = abs(winding(point, vertices, faces[label == j])) > 0.5
    # a group of crossing pieces is one layer
    layers = np.zeros((n, group.max() + 1), bool)
    for j in range(n):
        layers[:, group[j]] |= within[:, j]
    depth = layers.sum(1)
    cavity = alone & (depth % 2 == 1)
    if cavity.any():
        faces = np.where(cavity[label][:, None], faces[:, ::-1], faces)
        many = (
            "1 inner shell as a cavity"
            if cavity.sum() == 1
            else f"{cavity.sum()} inner shells as cavities"
        )
        said.append(f"kept {many}")
    outer = np.unique(group[depth == 0])
    swallowed = np.unique(group[(depth > 0) & ~cavity])
    if len(swallowed):
        raise_or_drop = [g for g in swallowed if (depth[group == g] % 2 == 0).all()]
        if raise_or_drop:
            raise DefplanError(
                f"{path} has pieces inside of its cavities, which touch nothing: delete them"
            )
    if len(outer) > 1:
        share = np.array([volume[group == g].sum() for g in outer])
        share = share / share.sum()
        crumbs = outer[share < _CRUMB]
        if len(crumbs):
            keep = ~np.isin(group[label], crumbs)
            said.append(
                f"left out {len(crumbs)} crumbs apart from the body,"
                f" {share[share < _CRUMB].sum():.2%} of the volume"
            )
            faces, label = faces[keep], label[keep]
            outer = outer[share >= _CRUMB]
    if len(outer) > 1:
        gap, width, vertices = contact(vertices, faces, group[label], outer, _TOUCH, _PUSH)
        if gap > _TOUCH * size:
            raise DefplanError(
                f"{path} is in {len(outer)} pieces that lie apart, by {gap / size:.1%} of the length:"
                " join them into one closed surface or delete all but one"
            )
        if gap < 1e-9 * size and width < 1e-6 * size:
            raise DefplanError(
                f"{path} is in {len(outer)} pieces that touch in a point only: let them overlap"
            )
        said.append(
            f"joined {len(outer)} pieces that touch, moved by up to {gap / size + _PUSH:.1%}"
        )
    return vertices, faces, label
