"""The page on what each repair is worth: verdicts follow from the runs, and every variant is another method."""

from comove.lab.bench.store import Configuration, Figures, Machine, Run
from comove.lab.evolution import Paper
from comove.lab.paper.ablation import EXAMPLES, SET, VARIANTS, WHOLE, page, scenes, systems

SEEDS = 10


def run(system, scene, seed, verified):
    kind = "examples" if scene in EXAMPLES else SET
    return Run(
        Configuration(kind, scene, "0" * 64, system, seed, 15.0, "1"),
        "verified" if verified else "not verified",
        "",
        "2026-01-01T00:00:00",
        Machine("a processor", 2, "3.11"),
        Figures(first_verified=2.0 if verified else None),
    )


def runs(shares):
    """Runs of which a share is verified, by system; all of the others."""
    names = (*EXAMPLES, "easy-00", "easy-01")
    return [
        run(system, scene, seed, seed < SEEDS * shares.get(system, 1.0))
        for system in VARIANTS
        for scene in names
        for seed in range(SEEDS)
    ]


def verdicts(text):
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| `")]
    return {row[1].strip(" `"): row[-2].strip() for row in rows}


def test_a_repair_without_which_few_succeed_is_needed():
    found = verdicts(page(runs({"stale": 0.1, "no-growing": 0.9}), 15.0))
    assert found.pop(WHOLE) == ""
    assert found.pop("stale") == "worse"
    assert set(found.values()) == {"no difference seen"}
    assert len(found) == len(VARIANTS) - 2


def test_what_does_better_without_is_said_too():
    assert verdicts(page(runs({WHOLE: 0.5}), 15.0))["no-centring"] == "better"


def test_numbers_are_those_of_the_runs():
    text = page(runs({"stale": 0.3}), 15.0)
    (row,) = [line for line in text.splitlines() if line.startswith("| `stale`")]
    assert "| 3 of 10 | 3 of 10 | 3 of 10 | 6 of 20 | 30 (19 to 44) | 2.0 |" in row
    assert "--scenes 2 --seeds 10 --budget 15" in text


def test_the_factor_form_is_explained_where_the_runs_show_it():
    assert "Why the factor form" in page(runs({"stale": 0.1}), 15.0)
    assert "Why the factor form" not in page(runs({}), 15.0)
    assert "Why the factor form" not in page(runs({"stale": 0.1, "factor": 0.1}), 15.0)


def test_every_variant_is_another_method():
    methods = [system.method for system in systems().values()]
    assert methods[0] == Paper()
    assert all(a != b for i, a in enumerate(methods) for b in methods[:i])
    assert all(isinstance(method, Paper) for method in methods[:-1])


def test_the_scenes_are_there():
    chosen = scenes(4)
    assert [scene.name for scene in chosen[:3]] == list(EXAMPLES)
    assert len({scene.name for scene in chosen}) == 7
    assert {scene.load().n_dims for scene in chosen} == {2, 3}
