"""Whatever the judge says of separations, tilts, heights and poses, dense samples of the true curve agree.

The samples come from the brute force, which has the geometry of hands and blocks of its own.
"""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from comove.dmp import motion_basis
from comove.errors import ComoveWarning, OptionError, SceneError
from comove.model import CoordinatedDMP, Scene, arms_coordinates, load_coordinates, projected_coordinates
from comove.model.constraints import (
    DistanceConstraint,
    SameHeightConstraint,
    SeparationConstraint,
    UprightConstraint,
)
from comove.verification import verify
from tests import brute_force
from tests.cases import examples
from tests.verification.random_motions import (
    BAR,
    TRIANGLE,
    held_scene,
    motion_on,
    on_scene,
    scene_data,
)

seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
HAND = np.zeros((1, 3))
DENSE = np.linspace(0.0, 1.0, 40_001)
CHORD_DEVIATION = 2e-3  # m, more than any of these motions leaves its chords by


def frame(*names):
    """A frame of rods round the hands."""
    return {
        "shape": "frame",
        "edges": [list(pair) for pair in zip(names, names[1:] + names[:1], strict=True)],
    }


def between(kind, first, second, **more):
    return {"type": kind, "between": [first, second], **more}


def reasons(verdict, *words):
    """The reasons that hold all words."""
    return [reason for reason in verdict.reasons if all(word in reason for word in words)]


# --- Separation ---

GROUPS = {
    "hands": ([HAND, HAND], {}, ("a", "b")),
    "bar and hand": (
        [BAR, HAND],
        {"load": {"shape": "bar", "length": 0.2, "held_by": ["a", "b"]}},
        ("b", "c"),
    ),
    "two bars": (
        [BAR, 0.8 * BAR],
        {"constraints": [between("distance", *pair, distance=d) for pair, d in (("ab", 0.2), ("cd", 0.16))]},
        ("a", "d"),
    ),
    "frame and hand": (
        [TRIANGLE, HAND],
        {"load": {**frame("a", "b", "c"), "held_by": ["a", "b", "c"]}},
        ("c", "d"),
    ),
}


def nearly_apart(rng, n_dims, name, make=load_coordinates):
    """A random motion whose hands come as near as a separation allows, give or take some millimetres.

    Gives the motion, both hands, and the least distance that is met.
    """
    held, more, (first, second) = GROUPS[name]
    while True:
        free = held_scene(rng, n_dims, held, **more)
        motion = motion_on(free, rng, rng.choice([0.01, 0.05, 0.15]), make(free))
        i, j = (free.manipulators.index(n) for n in (first, second))
        met = brute_force.separations(brute_force.hands_at(motion, DENSE), i, j).min()
        distance = met + rng.choice([-1.0, 1.0]) * rng.choice([1e-6, 1e-5, 1e-4, 2e-3])
        ends = [brute_force.separations(hands[None], i, j)[0] for hands in (free.start, free.goal)]
        if 0.01 < distance < min(ends) - 1e-3:
            break
    data, tolerance = scene_data(free), float(rng.choice([0.0, 0.002]))
    data["constraints"] = [
        *data["constraints"],
        between("separation", first, second, distance=float(distance + tolerance), tolerance=tolerance),
    ]
    return on_scene(motion, data), met, distance


@examples(80)
@given(seeds, dims, st.sampled_from(sorted(GROUPS)))
def test_a_separation_is_certified_below_what_is_there(seed, n_dims, name):
    motion, met, least = nearly_apart(np.random.default_rng(seed), n_dims, name)
    verdict = verify(motion)
    spare = verdict.report.separation_spare_min
    assert spare <= met - least + 1e-12
    assert spare >= met - least - CHORD_DEVIATION
    told = reasons(verdict, "as near as", "asked for")
    assert len(told) == (spare < -1e-9)
    if met < least - 1e-9:
        assert told


@examples(30)
@given(seeds, dims, st.sampled_from(sorted(GROUPS)))
@example(4294967294, 2, "two bars")  # swings round between two knots
def test_a_separation_of_other_coordinates(seed, n_dims, name):
    """Projected hands and free ones are judged by the same derivatives."""
    for make in (projected_coordinates, arms_coordinates):
        rng = np.random.default_rng(seed)
        try:
            motion, met, least = nearly_apart(rng, n_dims, name, make)
        except OptionError:
            continue
        hands = motion.coordinates.motion(motion.knots)[0, :, :4]
        # Hands projected onto a bar that almost vanishes swing round within an interval, and their bound is wide.
        assume(np.linalg.norm(np.diff(hands, axis=0), axis=2).max() < 0.05)
        spare = verify(motion).report.separation_spare_min
        assert met - least - CHORD_DEVIATION <= spare <= met - least + 1e-12


def test_hands_that_meet_between_two_knots():
    """Two that rush through one point within a knot's time: no knot shows how near they come."""
    hands = [[0.0, 0.0], [3.0, 0.001]]
    data = {
        "name": "rush",
        "duration": 1.0,
        "workspace": {"lower": [-9.0, -9.0], "upper": [9.0, 9.0]},
        "manipulators": [
            {"name": "a", "start": hands[0], "goal": hands[1]},
            {"name": "b", "start": hands[1], "goal": hands[0]},
        ],
        "constraints": [between("separation", "a", "b", distance=0.002)],
    }
    motion = motion_on(Scene.from_dict(data), np.random.default_rng(0), 0.0)
    at_knots = brute_force.separations(brute_force.hands_at(motion, np.arange(801) / 800), 0, 1).min()
    met = brute_force.separations(brute_force.hands_at(motion, DENSE), 0, 1).min()
    verdict = verify(motion)
    assert met < verdict.report.separation_spare_min + 0.002 + 1e-4
    assert verdict.report.separation_spare_min + 0.002 <= met
    assert at_knots > met
    assert reasons(verdict, "'a' and 'b'", "0.002 m asked for")


def test_the_worst_of_several_separations_is_reported():
    rng = np.random.default_rng(3)
    pairs = {"ab": 0.01, "bc": 0.02}
    scene = held_scene(
        rng, 3, [HAND] * 3, constraints=[between("separation", *p, distance=d) for p, d in pairs.items()]
    )
    motion = motion_on(scene, rng, 0.01)
    hands = brute_force.hands_at(motion, DENSE)
    spare = min(brute_force.separations(hands, i, i + 1).min() - d for i, d in enumerate(pairs.values()))
    assert verify(motion).report.separation_spare_min == pytest.approx(spare, abs=1e-4)


def test_hands_of_one_load_are_apart_as_they_are():
    scene = held_scene(
        np.random.default_rng(0),
        3,
        [BAR],
        load={"shape": "bar", "length": 0.2},
        constraints=[between("separation", "a", "b", distance=0.15)],
    )
    verdict = verify(motion_on(scene, np.random.default_rng(1), 0.1))
    assert verdict.report.separation_spare_min == pytest.approx(0.05, abs=1e-12)


# --- Upright ---

TRAYS = {
    (2, "bar"): ([BAR], {"load": {"shape": "bar", "length": 0.2}}),
    (2, "frame"): ([TRIANGLE], {"load": frame("a", "b", "c")}),
    (3, "bar"): ([BAR], {"load": {"shape": "bar", "length": 0.2}}),
    (3, "frame"): ([TRIANGLE], {"load": frame("a", "b", "c")}),
}
UPRIGHT = [{"type": "upright", "tolerance_deg": 1.0}]


@examples(40)
@given(seeds, st.sampled_from(sorted(TRAYS)))
def test_an_upright_load_keeps_its_tilt_at_every_instant(seed, tray):
    rng = np.random.default_rng(seed)
    held, more = TRAYS[tray]
    scene = held_scene(rng, tray[0], held, level=True, **more, constraints=UPRIGHT)
    motion = motion_on(scene, rng, 0.2)
    verdict = verify(motion)
    assert verdict.verified, verdict.reasons
    assert verdict.report.tilt_max < 1e-11
    assert brute_force.tilts(brute_force.hands_at(motion, DENSE)).max() < 1e-11


@examples(30)
@given(seeds, st.sampled_from(sorted(TRAYS)))
def test_a_load_that_may_tilt_is_not_upright_whatever_its_coordinates_are_called(seed, tray):
    """A motion in coordinates of the same load without the demand."""
    rng = np.random.default_rng(seed)
    held, more = TRAYS[tray]
    scene = held_scene(rng, tray[0], held, level=True, **more)
    motion = motion_on(scene, rng, 0.05)
    demanding = Scene.from_dict(scene_data(scene) | {"constraints": UPRIGHT})
    verdict = verify(replace(motion, scene=demanding))
    assert verdict.verified is None
    assert verdict.report.tilt_max == np.inf
    assert reasons(verdict, "tilt")
    for kind in ("arms", "projected"):
        renamed = replace(motion, scene=demanding, coordinates=replace(motion.coordinates, kind=kind))
        assert verify(renamed).report.tilt_max == np.inf
        assert reasons(verify(renamed), "coordinates are not those of the scene")


@examples(20)
@given(seeds)
def test_free_hands_keep_a_load_level_by_one_height_for_all(seed):
    """Hands that share the column of their heights; those that have one each may tilt it."""
    rng = np.random.default_rng(seed)
    ends = [{"start": [x, 0.2, 0.4], "goal": [x, 0.7, 0.6]} for x in (0.4, 0.6)]
    data = {
        "name": "level",
        "duration": 5.0,
        "workspace": {"lower": [-2, -2, -2], "upper": [3, 3, 3]},
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [{"name": name, **one} for name, one in zip("ab", ends, strict=True)],
    }
    upright = Scene.from_dict(data | {"constraints": UPRIGHT})
    basis = motion_basis(8, "acceleration")
    for scene in (upright, Scene.from_dict(data)):
        free = arms_coordinates(scene)
        weights = rng.normal(0.0, 1e-6, (free.n_columns, 8))
        motion = CoordinatedDMP(scene, free, basis, free.boundary(), weights).rollout()
        verdict = verify(replace(motion, scene=upright))
        if scene is upright:
            assert verdict.verified and verdict.report.tilt_max == 0.0
        else:
            assert verdict.verified is None and verdict.report.tilt_max == np.inf


def test_a_block_that_leans_is_caught_at_its_ends():
    """The right kind of block with points of its own: by its ends, as it cannot tilt on the way."""
    scene = held_scene(
        np.random.default_rng(0), 3, [BAR], level=True, load=TRAYS[3, "bar"][1]["load"], constraints=UPRIGHT
    )
    motion = motion_on(scene, np.random.default_rng(1), 0.02)
    blocks = motion.coordinates.blocks
    leaning = blocks.point @ np.array([[1.0, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]).T
    forged = replace(motion, coordinates=replace(motion.coordinates, blocks=blocks._replace(point=leaning)))
    assert reasons(verify(forged), "an end is missed")


# --- Same height ---


@examples(40)
@given(seeds, dims, st.sampled_from([load_coordinates, projected_coordinates, arms_coordinates]))
def test_free_hands_at_one_height(seed, n_dims, make):
    rng = np.random.default_rng(seed)
    pairs = [between("same_height", "c", "a"), between("same_height", "d", "c")]
    scene = held_scene(rng, n_dims, [HAND] * 4, level=True, constraints=pairs)
    motion = motion_on(scene, rng, 0.2, make(scene))
    verdict = verify(motion)
    assert verdict.verified, verdict.reasons
    assert verdict.report.height_error_max == 0.0
    hands = brute_force.hands_at(motion, DENSE)
    assert max(brute_force.height_differences(hands, 0, j).max() for j in (2, 3)) == 0.0
    assert brute_force.height_differences(hands, 0, 1).max() > 0.0


@examples(60)
@given(seeds, dims, st.sampled_from(["hands", "bar", "frame", "bar and hand"]))
def test_heights_that_no_block_holds_are_bounded_by_derivatives(seed, n_dims, name):
    """Motions in coordinates that know of no height: the bound is above dense samples, by next to nothing."""
    rng = np.random.default_rng(seed)
    bodies = {"hands": [HAND, HAND], "bar": [BAR], "frame": [TRIANGLE], "bar and hand": [BAR, HAND]}[name]
    more = {}
    if name != "hands":
        more["load"] = {"shape": "bar", "length": 0.2, "held_by": ["a", "b"]}
    if name == "frame":
        more["load"] = frame("a", "b", "c")
    scene = held_scene(rng, n_dims, bodies, **more)
    motion = motion_on(scene, rng, rng.choice([0.01, 0.05]))
    first, second = (0, 2) if name == "bar and hand" else (0, 1)
    met = brute_force.height_differences(brute_force.hands_at(motion, DENSE), first, second).max()
    tolerance = float(met + rng.choice([-1e-5, 1e-5, 1e-3]))
    demand = _demanding(scene, first, second, tolerance)
    verdict = verify(replace(motion, scene=demand))
    assert met <= verdict.report.height_error_max + 1e-12
    assert verdict.report.height_error_max <= met + CHORD_DEVIATION
    assert bool(reasons(verdict, "heights of")) == (verdict.report.height_error_max > tolerance)


def _demanding(scene, first, second, tolerance):
    """The scene with a demand on two heights that its ends need not meet."""
    return replace(scene, constraints=(*scene.constraints, SameHeightConstraint(first, second, tolerance)))


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_level_bar_stays_level(n_dims):
    flat = scene_data(
        held_scene(np.random.default_rng(0), n_dims, [BAR], level=True, load=TRAYS[n_dims, "bar"][1]["load"])
    )
    along = [0.1, 0.0, 0.0][:n_dims]
    for manipulator, sign in zip(flat["manipulators"], (-1, 1), strict=True):
        for end, x in (("start", 0.2), ("goal", 0.8)):
            manipulator[end] = [x + sign * along[0], *[0.5] * (n_dims - 1)]
    scene = Scene.from_dict(flat | {"constraints": [between("same_height", "a", "b", tolerance=0.0)]})
    motion = motion_on(scene, np.random.default_rng(1), 0.2)
    verdict = verify(motion)
    assert verdict.verified
    assert verdict.report.height_error_max < 1e-15
    assert brute_force.height_differences(brute_force.hands_at(motion, DENSE), 0, 1).max() < 1e-15


# --- Relative pose ---


def test_a_relative_pose_asks_for_a_block_that_holds_the_roll():
    """The hands of a bar are as far apart as they must be, but the bar may roll between them."""
    bar = held_scene(np.random.default_rng(0), 3, [BAR], load={"shape": "bar", "length": 0.2})
    motion = motion_on(bar, np.random.default_rng(1), 0.02)
    posed = Scene.from_dict(scene_data(bar) | {"constraints": [between("relative_pose", "a", "b")]})
    verdict = verify(replace(motion, scene=posed))
    assert reasons(verdict, "relative pose of 'a' and 'b'")
    assert verdict.report.distance_error_max < 1e-12
    verdict = verify(motion_on(posed, np.random.default_rng(1), 0.02))
    assert verdict.verified, verdict.reasons


def test_in_the_plane_a_relative_pose_is_a_distance():
    """Free hands are measured as for a distance."""
    scene = held_scene(np.random.default_rng(0), 2, [BAR], constraints=[between("relative_pose", "a", "b")])
    motion = motion_on(scene, np.random.default_rng(1), 0.01, arms_coordinates(scene))
    hands = brute_force.hands_at(motion, DENSE)
    met = np.abs(brute_force.separations(hands, 0, 1) - 0.2).max()
    verdict = verify(motion)
    assert met <= verdict.report.distance_error_max <= met + 1e-3
    assert not reasons(verdict, "relative pose")


# --- All together ---


def mixed_scene(rng):
    """Hands, perhaps a load, and constraints at random whose tolerances move the ends; may be refused."""
    n_dims, n_hands = int(rng.integers(2, 4)), int(rng.integers(2, 6))
    names = "abcde"[:n_hands]
    start = rng.uniform(0.2, 0.8, (n_hands, n_dims))
    goal = start + rng.uniform(0.2, 0.8, n_dims)
    goal += 0.01 * rng.standard_normal(goal.shape)
    start[:, -1], goal[:, -1] = (rng.uniform(0.4, 0.5) + 0.01 * rng.standard_normal(n_hands) for _ in "sg")
    constraints = []
    for _ in range(rng.integers(1, 5)):
        first, second = rng.choice(list(names), 2, replace=False)
        pair = names.index(first), names.index(second)
        distance = float(np.linalg.norm(np.subtract(*start[list(pair)])))
        kind = str(rng.choice(["distance", "relative_pose", "separation", "same_height", "upright"]))
        one = between(kind, str(first), str(second), tolerance=0.1)
        if kind in ("distance", "separation"):
            one["distance"] = distance * (1.0 if kind == "distance" else rng.uniform(0.2, 0.9))
        constraints.append({"type": "upright", "tolerance_deg": 30.0} if kind == "upright" else one)
    data = {
        "name": "mixed",
        "duration": 10.0,
        "workspace": {"lower": [-9.0] * n_dims, "upper": [9.0] * n_dims},
        "manipulators": [
            {"name": name, "start": s.tolist(), "goal": g.tolist()}
            for name, s, g in zip(names, start, goal, strict=True)
        ],
        "constraints": constraints,
    }
    if rng.random() < 0.6:
        held = [str(name) for name in rng.permutation(list(names))[: rng.integers(2, 4)]]
        data["load"] = {"shape": "frame", "edges": [held[:2]], "held_by": held}
        if n_dims == 2 and rng.random() < 0.3:
            data["load"] = {"shape": "polygon", "vertices": [[0, 0], [0.2, 0], [0, 0.1]], "held_by": held}
    return Scene.from_dict(data)


@examples(150)
@given(seeds)
def test_nothing_verified_breaks_what_was_asked(seed):
    """Scenes of all constraints at once: refused in words, or every random motion in them is judged rightly."""
    rng = np.random.default_rng(seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            scene = mixed_scene(rng)
    except SceneError as error:
        assert error.way_out or " errors" in str(error)
        return
    for make in (load_coordinates, projected_coordinates, arms_coordinates):
        try:
            coordinates = make(scene)
        except OptionError:
            continue
        motion = motion_on(scene, rng, 0.05, coordinates)
        verdict, hands = verify(motion), brute_force.hands_at(motion, DENSE[::10])
        report = verdict.report
        assert report.end_error < 1e-12
        assert not reasons(verdict, "coordinates")
        for c in scene.constraints:
            if isinstance(c, DistanceConstraint):
                met = np.abs(brute_force.separations(hands, c.first, c.second) - c.distance).max()
                assert met <= report.distance_error_max + 1e-12
            elif isinstance(c, SeparationConstraint):
                met = brute_force.separations(hands, c.first, c.second).min() - c.least
                assert report.separation_spare_min <= met + 1e-12
            elif isinstance(c, SameHeightConstraint):
                met = brute_force.height_differences(hands, c.first, c.second).max()
                assert met <= report.height_error_max + 1e-12
                assert report.height_error_max <= 1e-12
            elif isinstance(c, UprightConstraint):
                assert brute_force.tilts(hands[:, list(c.members)]).max() <= report.tilt_max + 1e-7
                assert report.tilt_max <= 1e-7


# --- What scenes do not ask for ---


def test_measures_are_named_only_where_they_are_asked_for():
    rng = np.random.default_rng(0)
    free = held_scene(rng, 3, [HAND, HAND], level=True)
    names = {"separation_spare_min", "tilt_max", "height_error_max"}
    assert not names & set(verify(motion_on(free, rng, 0.01)).report.asdict())
    level = Scene.from_dict(scene_data(free) | {"constraints": [between("same_height", "a", "b")]})
    assert names & set(verify(motion_on(level, rng, 0.01)).report.asdict()) == {"height_error_max"}
