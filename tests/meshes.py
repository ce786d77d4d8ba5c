"""Meshes for tests, written as STL, and what is true of them by plain NumPy and coal."""

import numpy as np
from scipy.spatial import ConvexHull

L_PROFILE = np.array([[0, 0], [0.3, 0], [0.3, 0.05], [0.05, 0.05], [0.05, 0.2], [0, 0.2]])


def prism(profile, fan, height):
    """A prism over a polygon (n, 2) whose triangles share the corner `fan`; vertices and faces."""
    n = len(profile)
    vertices = np.concatenate([np.column_stack([profile, np.full(n, z)]) for z in (0.0, height)])
    around = [(fan + i) % n for i in range(n)]
    faces = []
    for b, c in zip(around[1:-1], around[2:], strict=True):
        faces += [[c, b, fan], [fan + n, b + n, c + n]]
    for i in range(n):
        j = (i + 1) % n
        faces += [[i, j, j + n], [i, j + n, i + n]]
    return vertices, np.array(faces)


def l_profile():
    """An L: concave at its corner 3, which sees all of it."""
    return prism(L_PROFILE, 3, 0.06)


def star(rng):
    """A prism over a random polygon that is star-shaped about its first corner's neighbour, the origin."""
    n = int(rng.integers(5, 10))
    angle = np.sort(rng.uniform(0.1, 1.4 * np.pi, n))
    ring = rng.uniform(0.05, 0.2, n)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return prism(np.concatenate([[[0.0, 0.0]], ring]), 0, rng.uniform(0.03, 0.15))


def hull(points):
    """The convex hull of points as triangles turned outwards."""
    found = ConvexHull(points)
    used = np.unique(found.simplices)
    faces = np.searchsorted(used, found.simplices)
    vertices = points[used]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * found.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def box(size):
    """A box about the origin."""
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    return hull(0.5 * signs * np.asarray(size, dtype=float))


def ring(n=16, inner=0.06, outer=0.09, height=0.05):
    """A tube along z, with a hole all through it."""
    angle = 2 * np.pi * np.arange(n) / n
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    vertices = np.concatenate(
        [np.column_stack([r * round_, np.full(n, z)]) for r in (inner, outer) for z in (0.0, height)]
    )
    faces = []
    for i in range(n):
        j = (i + 1) % n
        for a, b in ((n, 0), (2 * n, 3 * n), (0, 2 * n), (3 * n, n)):  # inside, outside, bottom, top
            faces += [[a + i, a + j, b + j], [a + i, b + j, b + i]]
    return vertices, np.array(faces)


def spoilt(vertices, faces, done, rng):
    """A mesh after what exports, tools and people do to meshes, in turn."""
    vertices, faces = np.array(vertices, dtype=float), np.array(faces)
    size = np.ptp(vertices, axis=0).max()
    for what in done:
        k = int(rng.integers(len(faces)))
        some = rng.random(len(faces)) < 0.4
        if what == "flip":
            faces[some] = faces[some][:, ::-1]
        elif what == "double":
            faces = np.concatenate([faces, faces[some][:, :: int(rng.choice([-1, 1]))]])
        elif what == "drop" and len(faces) > 4:
            faces = np.delete(faces, k, axis=0)
        elif what == "sliver":
            a, b, _ = vertices[faces[k]]
            vertices = np.concatenate([vertices, [0.5 * (a + b) + 1e-10 * size * rng.standard_normal(3)]])
            faces = np.concatenate([faces, [[*faces[k][:2], len(vertices) - 1]]])
        elif what == "fin":
            tip = vertices[faces[k][0]] + 0.3 * size * rng.standard_normal(3)
            vertices = np.concatenate([vertices, [tip]])
            fin = [faces[k][0], faces[k][1], len(vertices) - 1]
            faces = np.concatenate([faces, [fin, fin[::-1]]])
        elif what == "unwelded":
            moved = vertices[faces].reshape(-1, 3)
            vertices = moved + rng.choice([0.0, 1e-12, 1e-7]) * size * rng.standard_normal(moved.shape)
            faces = np.arange(len(vertices)).reshape(-1, 3)
        elif what == "line":
            faces = np.concatenate([faces, [[faces[k][0], faces[k][1], faces[k][1]]]])
        elif what == "crossing":
            other = vertices + 0.3 * size * rng.standard_normal(3)
            faces = np.concatenate([faces, faces + len(vertices)])
            vertices = np.concatenate([vertices, other])
        elif what == "far":
            far = vertices + 3.0 * size * rng.standard_normal(3)
            faces = np.concatenate([faces, faces[some] + len(vertices)]) if some.any() else faces
            vertices = np.concatenate([vertices, far])
        if len(faces) > 400:
            break
    return vertices, faces


def write_stl(path, vertices, faces):
    """Binary STL."""
    corners = np.asarray(vertices)[np.asarray(faces)].astype("<f4")
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    record["corners"] = corners
    path.write_bytes(b"\0" * 80 + np.uint32(len(corners)).tobytes() + record.tobytes())
    return path


def write_obj(path, vertices, faces):
    """OBJ with all digits."""
    lines = ["v {!r} {!r} {!r}".format(*map(float, v)) for v in vertices]
    lines += ["f {} {} {}".format(*(np.asarray(face) + 1)) for face in faces]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def are_inside(vertices, faces, points):
    """Which points a mesh winds around, by the sum of solid angles (van Oosterom & Strackee, 1983)."""
    a, b, c = (vertices[faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.abs(np.arctan2(above, below).sum(axis=1)) > np.pi


def on_surface(vertices, faces, count, rng):
    """Random points on the triangles."""
    share = rng.dirichlet(np.ones(3), count)
    return np.einsum("nk,nkd->nd", share, vertices[faces[rng.integers(len(faces), size=count)]])


def as_coal(vertices, faces, coal):
    """The mesh as coal takes it."""
    model, points, triangles = coal.BVHModelOBBRSS(), coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(np.asarray(vertices, dtype=float))
    triangles.extend([coal.Triangle(*map(int, face)) for face in faces])
    model.beginModel(len(faces), len(vertices))
    model.addSubModel(points, triangles)
    model.endModel()
    return model


def distances(vertices, faces, points, coal):
    """From the solid, 0 inside."""
    model, dot, here = as_coal(vertices, faces, coal), coal.Sphere(1e-9), coal.Transform3s.Identity()
    away = np.zeros(len(points))
    for k in np.flatnonzero(~are_inside(vertices, faces, points)):
        there = coal.Transform3s(np.eye(3), points[k])
        away[k] = coal.distance(model, here, dot, there, coal.DistanceRequest(), coal.DistanceResult())
    return away
