"""The house is built as its plan says: the room table in docs/architecture.md rules every import."""

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import comove

SOURCE = Path(comove.__file__).parent
PLAN = Path(__file__).parents[1] / "docs" / "architecture.md"
OUTSIDE = {"__init__.py", "__main__.py", "_doors.py", "_version.py", "py.typed"}  # doors and name plate

pytestmark = pytest.mark.skipif(not PLAN.is_file(), reason="docs/architecture.md is not there")


def rooms():
    """Names of the rooms in the order of the table, without slash and suffix."""
    text = PLAN.read_text(encoding="utf-8")
    cells = re.findall(r"^\|\s*`([\w.]+/?)`\s*\|", text[text.index("| package |") :], re.MULTILINE)
    return [cell.rstrip("/").removesuffix(".py") for cell in cells]


def registries():
    """Modules that name places in rooms below their own, and these rooms, by the table of registries."""
    text = PLAN.read_text(encoding="utf-8")
    table = text[text.index("| registry |") : text.index("| package |")]
    rows = re.findall(r"^\| `([\w./]+)` \|[^|]*\|([^|]*)\|$", table, re.MULTILINE)
    return {module: set(re.findall(r"`(\w+)`", places)) for module, places in rows}


def paths():
    """Paths of all modules inside the package."""
    return [path.relative_to(SOURCE) for path in sorted(SOURCE.rglob("*.py"))]


@pytest.fixture(scope="module")
def modules():
    """Every module as (path, room, the nodes of its parsed source), by path; gone with the last test of this file."""
    return {
        inside: (
            inside,
            inside.parts[0].removesuffix(".py"),
            tuple(ast.walk(ast.parse((SOURCE / inside).read_text(encoding="utf-8")))),
        )
        for inside in paths()
    }


def imported(nodes):
    """Names of all modules that a module imports, wherever in it the import stands, as dotted paths."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield node.module
            if node.module == "comove":
                yield from (f"comove.{alias.name}" for alias in node.names)


def rooms_entered(nodes):
    """Rooms of this package that a module imports from."""
    return {
        name.split(".")[1]
        for name in imported(nodes)
        if name.startswith("comove.") and name not in ("comove._version", "comove._doors")
    }


def test_every_room_is_on_the_plan_and_every_room_of_the_plan_exists():
    built = {
        path.name.removesuffix(".py")
        for path in SOURCE.iterdir()
        if path.name not in OUTSIDE and (path.suffix == ".py" or (path / "__init__.py").is_file())
    }
    assert built == set(rooms())
    assert len(rooms()) == len(set(rooms()))


def test_the_order_is_that_of_the_design():
    """Data flows down; what a room may know lies above it."""
    order = [
        *("errors", "arrays", "brief", "methods", "compiled", "trajectory"),
        *("io", "processes", "geometry"),
        *("dmp", "model", "verification", "contacts", "optim", "planning", "results"),
        *("control", "robots", "sim", "stored", "solving", "tasks", "ros", "data", "view", "lab", "cli"),
    ]
    assert [room for room in order if room in rooms()] == rooms()


@pytest.mark.parametrize("inside", [path for path in paths() if str(path) not in OUTSIDE], ids=str)
def test_imports_go_up(inside, modules):
    _, room, nodes = modules[inside]
    order = rooms()
    for other in rooms_entered(nodes):
        assert other in order, f"{inside} imports comove.{other}, which is no room"
        assert order.index(other) <= order.index(room), (
            f"{inside} imports from {other}, which lies below {room}"
        )


def test_places_below_are_named_by_registries_alone(modules):
    """A string that is loaded goes round the rule of imports."""
    order, found = rooms(), {}
    for inside, room, nodes in modules.values():
        texts = [
            node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)
        ]
        named = {text.split(".")[1] for text in texts if re.fullmatch(r"comove(\.\w+)+(:\w+)?", text)}
        if room in order and (
            below := {one for one in named & set(order) if order.index(one) > order.index(room)}
        ):
            found[str(inside)] = below
    assert found == registries()


def test_the_judge_knows_no_maker(modules):
    for inside, room, nodes in modules.values():
        if room == "verification":
            assert not rooms_entered(nodes) & {"optim", "planning"}, inside


def test_geometry_has_no_import_circle(modules):
    """Not for type checkers either."""
    own = {
        ".".join(("comove", *path.with_suffix("").parts)): nodes
        for path, room, nodes in modules.values()
        if room == "geometry" and path.name != "__init__.py"
    }
    graph = {name: set(imported(nodes)) & set(own) for name, nodes in own.items()}
    assert list(TopologicalSorter(graph).static_order())


def test_lazy_packages_show_type_checkers_what_they_load(modules):
    """Each name is imported from the same module for type checkers and by `lazily`."""
    found = 0
    for inside, _, nodes in modules.values():
        (homes,) = [ast.literal_eval(node.args[1]) for node in nodes if _loads_lazily(node)] or [None]
        if homes is None:
            continue
        found += 1
        shown = {
            (node.module.removeprefix("comove."), alias.name, alias.asname)
            for block in nodes
            if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING"
            for node in block.body
            for alias in node.names
        }
        assert shown == {(module, name, name) for module, names in homes.items() for name in names}, inside
        submodules = {path.stem for path in (SOURCE / inside).parent.iterdir()}
        assert not submodules & {name for names in homes.values() for name in names}, "a module would hide it"
    assert found >= 5


def _loads_lazily(node):
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "lazily" and len(node.args) == 2


def test_the_judge_of_robots_knows_no_search(modules):
    for inside, _, nodes in modules.values():
        for judge, maker in (
            ("robots/verification", "robots.search"),
            ("robots/search", "robots.verification"),
        ):
            if str(inside).startswith(judge):
                assert not [name for name in imported(nodes) if f"comove.{maker}" in name], inside


def test_optimisers_know_no_robot(modules):
    for inside, room, nodes in modules.values():
        if room == "optim":
            assert rooms_entered(nodes) <= {"errors", "arrays", "brief", "compiled", "optim"}, inside


def test_only_the_judges_make_verified_motions(modules):
    """`VerifiedMotion(...)` and `VerifiedJointMotion(...)` are called nowhere else, their seals nobody's business."""
    judges = {"VerifiedMotion": "verification", "VerifiedJointMotion": "robots/verification"}
    for inside, _, nodes in modules.values():
        names = {node.id for node in nodes if isinstance(node, ast.Name)}
        names |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        calls = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
        if not str(inside).startswith(tuple(judges.values())):
            assert not {"_SEAL", "_MAKER"} & names, inside
        for made, judge in judges.items():
            if not str(inside).startswith(judge):
                assert not any(call.split(".")[-1] == made for call in calls), inside


def test_nothing_imports_a_product_but_the_products_below_it(modules):
    """The core runs without simulators, ROS, datasets, figures and laboratory, and these without each other."""
    products = {"sim", "tasks", "ros", "data", "view", "lab"}
    may = {
        "stored": {"sim"},
        "tasks": {"sim"},
        "data": {"sim"},
        "view": {"sim"},
        "lab": products,
        "cli": products,
    }
    for inside, room, nodes in modules.values():
        assert rooms_entered(nodes) & products <= may.get(room, set()) | {room}, inside


def test_pictures_are_drawn_in_views_and_in_the_lab_only(modules):
    for inside, room, nodes in modules.values():
        if room not in ("view", "lab"):
            assert not [n for n in imported(nodes) if n.split(".")[0] == "matplotlib"], inside
        if inside.parts[:2] != ("view", "workbench"):
            assert not [n for n in imported(nodes) if n.split(".")[0] == "viser"], inside


def test_the_viewer_is_bound_in_few_places(modules):
    """Geometry, edits and the planner know no viewer, so that they can be tested without one."""
    free = {"edits", "gate", "geometry", "link", "protocol", "saving", "words", "worker"}
    free |= {"bodies", "live", "playback", "shelf"}
    for inside, _, nodes in modules.values():
        if inside.parts[:2] == ("view", "workbench") and inside.stem in free:
            assert not [n for n in imported(nodes) if n.split(".")[0] in ("viser", "websockets")], inside


def test_nothing_draws_from_the_global_random_state(modules):
    for inside, _, nodes in modules.values():
        for node in nodes:
            if isinstance(node, ast.Attribute) and ast.unparse(node).startswith(
                ("np.random.", "numpy.random.")
            ):
                assert node.attr in ("default_rng", "Generator", "random"), f"{inside}: {ast.unparse(node)}"
        assert "random" not in set(imported(nodes)), inside


def fields_of(node, classes):
    """The names of a class's declared fields, and of the attributes that it sets on itself, inherited ones too."""
    declared = {ast.unparse(part.target) for part in node.body if isinstance(part, ast.AnnAssign)}
    own = {
        part.attr
        for part in ast.walk(node)
        if isinstance(part, ast.Attribute)
        and isinstance(part.ctx, ast.Store)
        and ast.unparse(part.value) == "self"
    }
    bases = [ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases]
    inherited = [fields_of(classes[base], classes) for base in bases if base in classes and base != node.name]
    return declared.union(own, *inherited)


def test_classes_have_few_fields(modules):
    """Settings apart, which are many by nature, and records whose fields are columns and keys of files.

    Attributes that methods set count as well as declared ones, and those of base classes as well as a class's own.
    """
    classes = {
        node.name: node
        for _, _, nodes in modules.values()
        for node in nodes
        if isinstance(node, ast.ClassDef)
    }
    wide = {name for name, node in classes.items() if len(fields_of(node, classes)) > 15}
    settings = {name for name in wide if name.endswith("Settings")}
    methods = {"Comove", "Guide", "Quick", "Projection"}  # which are their settings
    assert wide - settings - methods <= {"JointReport", "ExecutionReport", "StudyRun", "DemonstrationSource"}


def test_what_the_makefile_asks_of_the_package_is_answered():
    asked = re.findall(
        r"python -c '(from comove[^']*)'", (PLAN.parents[1] / "Makefile").read_text(encoding="utf-8")
    )
    assert asked
    for code in asked:
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert int(told.stdout) > 0


def test_everything_that_is_offered_exists():
    for name in comove.__all__:
        assert getattr(comove, name) is not None
    assert set(comove.__all__) <= set(dir(comove))
    with pytest.raises(AttributeError, match="no_such_thing"):
        comove.no_such_thing  # noqa: B018


@pytest.mark.parametrize(
    "room",
    [
        room
        for room in (rooms() if PLAN.is_file() else [])
        if room not in ("errors", "arrays", "brief", "trajectory")
    ],
)
def test_every_room_offers_what_exists(room):
    module = __import__(f"comove.{room}", fromlist=["*"])
    for name in getattr(module, "__all__", ()):
        assert getattr(module, name) is not None
    assert module.__doc__ or not module.__file__ or (SOURCE / room / "__init__.py").stat().st_size == 0
