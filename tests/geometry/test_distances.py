"""Signed distances against a plain NumPy reference, and the truths that certificates rest on.

Those are: a distance changes by no more than the way (Lipschitz), is convex, and its tangents lie below it.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from comove.geometry import distances as sd
from comove.model.scene import Scene
from tests.cases import examples

KINDS = {
    "box": (sd.BOX, 3),
    "sphere": (sd.SPHERE, 1),
    "capsule": (sd.CAPSULE, 2),
    "cylinder": (sd.CYLINDER, 2),
    "ellipsoid": (sd.ELLIPSOID, 3),
}
ROOT = np.sqrt(0.5)
ROUNDING = 1e-11
length = st.floats(0.02, 2.0)
coordinate = st.floats(-3.0, 3.0)
point = st.tuples(coordinate, coordinate, coordinate).map(np.array)
kinds = st.sampled_from(sorted(KINDS))


def row(kind, center=(0, 0, 0), rotation=None, size=()):
    """A table of one obstacle in the layout that `distances` describes."""
    table = np.zeros((1, sd.N_COLUMNS))
    table[0, sd.KIND] = kind
    table[0, sd.CENTER : sd.CENTER + 3] = center
    table[0, sd.ROTATION : sd.ROTATION + 9] = (np.eye(3) if rotation is None else rotation).ravel()
    table[0, sd.SIZE : sd.SIZE + len(size)] = size
    table[0, sd.REACH] = np.linalg.norm(size)
    return table


@st.composite
def obstacles(draw, names=kinds):
    """Name, centre, rotation and size of an obstacle anywhere, turned anyhow."""
    name = draw(names)
    turn = draw(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
    size = draw(st.lists(length, min_size=KINDS[name][1], max_size=KINDS[name][1]))
    return name, draw(point), Rotation.from_quat(turn).as_matrix(), np.array(size)


def table_of(obstacle):
    name, center, rotation, size = obstacle
    return row(KINDS[name][0], center, rotation, size)


def reference(obstacle, p):
    """Signed distance by the nearest point of the solid, or the nearest face from inside."""
    name, center, rotation, size = obstacle
    local = rotation.T @ (p - center)
    if name == "sphere":
        return np.linalg.norm(local) - size[0]
    if name == "capsule":
        return np.linalg.norm(local - [0, 0, np.clip(local[2], -size[1], size[1])]) - size[0]
    if name == "cylinder":
        radial = np.hypot(*local[:2])
        local, size = np.array([radial, local[2]]), np.array([size[0], size[1]])
    if (np.abs(local) <= size).all():
        return (np.abs(local) - size).max()
    return np.linalg.norm(local - np.clip(local, -size, size))


def on_ellipsoid(obstacle, p):
    """Signed distance by constrained minimisation over the surface, from several starts."""
    _, center, rotation, radii = obstacle
    local = rotation.T @ (p - center)
    surface = {
        "type": "eq",
        "fun": lambda x: ((x / radii) ** 2).sum() - 1,
        "jac": lambda x: 2 * x / radii**2,
    }
    starts = [local / max(np.linalg.norm(local / radii), 1e-9)] + [
        sign * r * e for sign in (-1, 1) for r, e in zip(radii, np.eye(3), strict=True)
    ]
    best = np.inf
    for start in starts:
        found = minimize(
            lambda x: ((x - local) ** 2).sum(),
            start,
            jac=lambda x: 2 * (x - local),
            constraints=surface,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 300},
        )
        if abs(surface["fun"](found.x)) < 1e-7:
            best = min(best, np.linalg.norm(found.x - local))
    return best if np.linalg.norm(local / radii) > 1 else -best


@examples(300)
@given(obstacles(kinds.filter(lambda n: n != "ellipsoid")), point)
def test_point_distance(obstacle, p):
    assert sd.point_distance(table_of(obstacle), 0, *p) == pytest.approx(reference(obstacle, p), abs=1e-12)


@examples(25)
@given(obstacles(st.just("ellipsoid")), point)
def test_point_distance_to_an_ellipsoid(obstacle, p):
    distance = sd.point_distance(table_of(obstacle), 0, *p)
    assert distance == pytest.approx(on_ellipsoid(obstacle, p), abs=1e-5)


@examples(200)
@given(obstacles(st.just("ellipsoid")), st.tuples(*[st.floats(-1, 1)] * 3), st.floats(-0.9, 3))
def test_ellipsoid_along_its_normals(obstacle, direction, away):
    """From a point of the surface along the normal; inwards short of the sharpest curvature."""
    _, center, rotation, radii = obstacle
    if np.linalg.norm(direction) < 0.1:
        direction = (1.0, 0.0, 0.0)
    surface = np.array(direction) / np.linalg.norm(np.array(direction) / radii)
    normal = surface / radii**2 / np.linalg.norm(surface / radii**2)
    if away < 0:
        away *= radii.min() ** 2 / radii.max()
    p = center + rotation @ (surface + away * normal)
    assert sd.point_distance(table_of(obstacle), 0, *p) == pytest.approx(away, abs=1e-9)


@pytest.mark.parametrize("thin", [0.5, 0.05, 0.005])
@pytest.mark.parametrize("away", [0.0, 0.01, 0.1])
def test_a_flat_ellipsoid_in_its_plane(thin, away):
    """Points exactly in a plane of symmetry, as scenes drawn by hand have them."""
    for order in ([0, 1, 2], [1, 0, 2], [1, 2, 0]):
        radii = np.array([1.0, thin, 0.6])[order]
        surface = np.array([ROOT, 0.0, 0.6 * ROOT])[order]
        normal = surface / radii**2 / np.linalg.norm(surface / radii**2)
        p = surface + away * normal
        assert sd.point_distance(row(sd.ELLIPSOID, size=radii), 0, *p) == pytest.approx(away, abs=1e-9)


@pytest.mark.parametrize("radii", [(0.1, 0.2, 0.3), (0.1, 0.2, 0.2), (0.2, 0.2, 0.2), (0.3, 0.05, 0.2)])
def test_the_middle_of_an_ellipsoid_is_its_least_radius_deep(radii):
    table = row(sd.ELLIPSOID, size=radii)
    assert sd.point_distance(table, 0, 0.0, 0.0, 0.0) == pytest.approx(-min(radii), rel=1e-9)


@examples(300)
@given(obstacles(), point, point)
def test_a_distance_changes_no_more_than_the_way(obstacle, p, q):
    table = table_of(obstacle)
    change = abs(sd.point_distance(table, 0, *p) - sd.point_distance(table, 0, *q))
    assert change <= np.linalg.norm(p - q) + ROUNDING


@examples(300)
@given(obstacles(), point, st.floats(0.0, 1.0))
def test_what_is_inflated_holds_all_that_is_as_near(obstacle, p, margin):
    """And no more than that of what has no edges."""
    table = table_of(obstacle)
    wider = sd.inflated(table, np.array([margin]))
    bare, held = (sd.point_distance(x, 0, *p) for x in (table, wider))
    assert held <= max(bare - margin, -1e-9) + ROUNDING or bare < margin
    if bare <= margin:
        assert held <= 1e-9
    if obstacle[0] in ("sphere", "capsule"):
        assert held == pytest.approx(bare - margin, abs=1e-9)
    assert wider[0, sd.REACH] >= table[0, sd.REACH] + margin - 1e-12


@examples(300)
@given(obstacles(), point, point, st.floats(0, 1))
def test_convex_along_every_segment(obstacle, p, q, share):
    table = table_of(obstacle)
    ends = [sd.point_distance(table, 0, *x) for x in (p, q)]
    between = sd.point_distance(table, 0, *(p + share * (q - p)))
    assert between <= (1 - share) * ends[0] + share * ends[1] + ROUNDING


@examples(300)
@given(obstacles(), point, st.tuples(*[st.floats(-1, 1)] * 3).map(np.array))
def test_tangents(obstacle, p, direction):
    """The value is the distance; the slope lies between the difference quotients backwards and forwards."""
    table, h = table_of(obstacle), 1e-5
    value, slope = sd.tangent(table, 0, *p, *direction)
    before, here, after = (sd.point_distance(table, 0, *(p + s * direction)) for s in (-h, 0, h))
    assert value == pytest.approx(here, abs=1e-12)
    assert (here - before) / h - 1e-5 <= slope <= (after - here) / h + 1e-5


@examples(200)
@given(obstacles(), point, point)
def test_tangents_lie_below_the_distance(obstacle, p, q):
    table = table_of(obstacle)
    value, slope = sd.tangent(table, 0, *p, *(q - p))
    assert value + slope <= sd.point_distance(table, 0, *q) + 1e-11


def least_along(table, p, q):
    """Least distance along a segment, by thirds in the best stretch of a dense sampling."""

    def distance(s):
        return sd.point_distance(table, 0, *(p + s * (q - p)))

    samples = np.linspace(0, 1, 101)
    values = [distance(s) for s in samples]
    k = int(np.argmin(values))
    low, high = samples[max(k - 1, 0)], samples[min(k + 1, 100)]
    for _ in range(50):
        third = (high - low) / 3
        if distance(low + third) < distance(high - third):
            high -= third
        else:
            low += third
    return min(*values, distance(0.5 * (low + high)))


@examples(250)
@given(obstacles(), point, point, st.sampled_from([1e-3, 1e-7, 1e-9]))
def test_segment_distance(obstacle, p, q, tolerance):
    """Never below the least distance, and above it by the tolerance at most."""
    table = table_of(obstacle)
    distance, least = sd.segment_distance(table, 0, *p, *q, np.inf, tolerance), least_along(table, p, q)
    assert least - 1e-9 <= distance <= least + tolerance + 1e-9


@examples(250)
@given(obstacles(), point, point, st.floats(-1, 3))
def test_segment_distance_below_a_cutoff(obstacle, p, q, cutoff):
    """Below the cutoff it is the distance; above it, it is above the cutoff."""
    table = table_of(obstacle)
    distance, least = sd.segment_distance(table, 0, *p, *q, cutoff, 1e-7), least_along(table, p, q)
    slack = 2e-7
    assert distance >= least - slack
    assert distance >= cutoff - slack if least > cutoff else distance <= least + slack


def test_a_segment_of_no_length_is_a_point():
    table = row(sd.BOX, size=(0.1, 0.2, 0.3))
    for p in ((1.0, 0.0, 0.0), (0.0, 0.1, 0.0)):
        assert sd.segment_distance(table, 0, *p, *p, np.inf, 1e-7) == sd.point_distance(table, 0, *p)


@examples(100)
@given(st.integers(0, 2**32 - 1))
def test_configuration_distance(seed):
    """The least over all edges, obstacles and the border, thickness off; and it says what is nearest."""
    rng = np.random.default_rng(seed)
    table = np.concatenate(
        [row(sd.SPHERE, rng.uniform(-1, 1, 3), size=[0.1]) for _ in range(3)]
        + [row(sd.BOX, rng.uniform(-1, 1, 3), Rotation.random(random_state=1).as_matrix(), [0.1, 0.2, 0.3])]
    )
    nodes, edges = rng.uniform(-1, 1, (4, 3)), np.array([[0, 1], [1, 2], [3, 3]])
    radii, lower, upper = rng.uniform(0, 0.1, 3), np.full(3, -1.1), np.array([1.1, 1.2, 1.3])
    borders = [min((nodes[e] - lower).min(), (upper - nodes[e]).min()) for e in edges]
    gaps = {-1: (borders - radii).min()}
    for j in range(len(table)):
        gaps[j] = ([least_along(table[j : j + 1], *nodes[e]) for e in edges] - radii).min()
    clearance, nearest = sd.configuration_distance(nodes, edges, radii, table, lower, upper)
    assert clearance == pytest.approx(min(gaps.values()), abs=2e-7)
    assert gaps[nearest] == pytest.approx(min(gaps.values()), abs=2e-7)


def planar(obstacle):
    """The obstacle's table in a planar scene."""
    data = {
        "name": "plane",
        "duration": 1.0,
        "workspace": {"lower": [-1, -1], "upper": [9, 9]},
        "obstacles": [obstacle],
        "manipulators": [{"name": "hand", "start": [8, 8], "goal": [8, 7]}],
    }
    return Scene.from_dict(data).obstacles


@pytest.mark.parametrize(
    ("obstacle", "p", "distance"),
    [
        ({"shape": "box", "size": [0.4, 0.2]}, (1.3, 1.0), 0.1),
        ({"shape": "box", "size": [0.4, 0.2]}, (1.5, 1.5), 0.5),
        ({"shape": "box", "size": [0.4, 0.2]}, (1.1, 1.02), -0.08),
        ({"shape": "box", "size": [0.4, 0.2], "rotation_deg": 90}, (1.3, 1.0), 0.2),
        ({"shape": "box", "size": [2, 2], "rotation_deg": 45}, (1 + 2 * np.sqrt(2), 1.0), np.sqrt(2)),
        ({"shape": "box", "size": [2, 2], "rotation_deg": 45}, (3.0, 3.0), 2 * np.sqrt(2) - 1),
        ({"shape": "box", "size": [2, 0.2], "rotation_deg": 30}, (1.0, 1.0), -0.1),
        ({"shape": "box", "size": [2, 0.2], "rotation_deg": 30}, (1 - 0.5, 1 + np.sqrt(0.75)), 0.9),
        ({"shape": "circle", "radius": 0.5}, (1.6, 1.8), 0.5),
        ({"shape": "circle", "radius": 0.5}, (1.0, 1.0), -0.5),
        ({"shape": "capsule", "radius": 0.05, "length": 0.2}, (1.3, 1.0), 0.15),
        ({"shape": "capsule", "radius": 0.05, "length": 0.2}, (1.05, 1.3), 0.25),
        ({"shape": "capsule", "radius": 0.05, "length": 0.2}, (1.13, 1.04), 0.0),
        ({"shape": "capsule", "radius": 0.05, "length": 0.2, "rotation_deg": 90}, (1.0, 1.3), 0.15),
        ({"shape": "capsule", "radius": 0.1, "length": 2, "rotation_deg": 45}, (2.0, 1.0), ROOT - 0.1),
        ({"shape": "capsule", "radius": 0.1, "length": 2, "rotation_deg": 45}, (3.0, 3.0), 2 / ROOT - 1.1),
        ({"shape": "ellipse", "radii": [0.3, 0.1]}, (1.5, 1.0), 0.2),
        ({"shape": "ellipse", "radii": [0.3, 0.1]}, (1.0, 1.5), 0.4),
        ({"shape": "ellipse", "radii": [0.3, 0.1]}, (1.0, 0.95), -0.05),
        ({"shape": "ellipse", "radii": [0.3, 0.1], "rotation_deg": 90}, (1.5, 1.0), 0.4),
        ({"shape": "ellipse", "radii": [0.3, 0.1], "rotation_deg": -45}, (1 + ROOT, 1 - ROOT), 0.7),
    ],
)
def test_planar_scenes_by_hand(obstacle, p, distance):
    table = planar({"center": [1.0, 1.0], **obstacle})
    assert sd.point_distance(table, 0, *p, 0.0) == pytest.approx(distance, abs=1e-9)


@examples(60)
@given(length, length, st.floats(-180, 180), st.floats(-1, 3), st.floats(-1, 3))
def test_a_planar_ellipse(a, b, degrees, x, y):
    """Against the nearest of many points of the curve."""
    table = planar({"shape": "ellipse", "center": [1.0, 1.0], "radii": [a, b], "rotation_deg": degrees})
    angle, turn = np.linspace(0, 2 * np.pi, 20001), np.deg2rad(degrees)
    u, v = a * np.cos(angle), b * np.sin(angle)
    curve = np.stack([u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)]) + 1.0
    least = np.hypot(curve[0] - x, curve[1] - y).min()
    u, v = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ [x - 1, y - 1]
    inside = (u / a) ** 2 + (v / b) ** 2 < 1
    assert sd.point_distance(table, 0, x, y, 0.0) == pytest.approx(-least if inside else least, abs=4e-4)
