"""Models of the files of datasets and sweeps. Rules of a single key are checked here; `Study` checks whether sampled
keys exist in the scene."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from comove.data.cameras import CamerasPart
from comove.io.keys import Contract, Part, Positive, Wrong, as_tuple, at_least, safe_name, show
from comove.planning.effort import EffortName

MAX_EPISODES = 10_000_000
SOURCES = ("uniform", "normal", "choice", "library", "recordings")
"""Keys that say where the values of a draw come from."""
PAIR = "write two numbers, or two lists of equally many numbers"


def _version(number: int) -> int:
    if number != 1:
        raise Wrong(f"the version {number} is not known", "write 1")
    return number


def _pair(value: Any) -> Any:
    """Return two numbers or equally long lists, or raise `Wrong`."""
    if value is None:
        return None
    sides = value if isinstance(value, (list, tuple)) else ()
    if len(sides) != 2:
        raise Wrong(f"{show(value)} is no pair", PAIR)
    lists = [tuple(side) if isinstance(side, (list, tuple)) else (side,) for side in sides]
    numbers = [x for own in lists for x in own]
    if not all(isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in numbers):
        raise Wrong(f"{show(value)} holds what is no finite number", PAIR)
    if len(lists[0]) != len(lists[1]) or not lists[0]:
        raise Wrong(f"{show(value)} are of different lengths", PAIR)
    alone = not isinstance(sides[0], (list, tuple))
    return tuple(float(own[0]) if alone else tuple(map(float, own)) for own in lists)


def _range(value: Any) -> Any:
    """Return the bounds of a range, or raise `Wrong`."""
    pair = _pair(value)
    if pair is not None:
        lower, upper = (own if isinstance(own, tuple) else (own,) for own in pair)
        if any(low > high for low, high in zip(lower, upper, strict=True)):
            raise Wrong(f"the range {show(value)} ends before it begins", "write the smaller end first")
    return pair


def _spread(value: Any) -> Any:
    """Return a mean and a standard deviation, or raise `Wrong`."""
    pair = _pair(value)
    if pair is not None:
        deviations = pair[1] if isinstance(pair[1], tuple) else (pair[1],)
        if min(deviations) <= 0.0:
            raise Wrong(f"the deviation of {show(value)} is not positive", "write [mean, standard deviation]")
    return pair


def _keys(value: Any) -> Any:
    return (value,) if isinstance(value, str) else as_tuple(value)


def _dotted(keys: tuple[str, ...]) -> tuple[str, ...]:
    for key in keys:
        if not all(part.strip() for part in key.split(".")):
            raise Wrong(
                f"{show(key)} names no key", "write a key, with points between its parts: load.length"
            )
    return keys


def _scene(value: Any) -> Any:
    if not isinstance(value, (str, dict)) or not value:
        raise Wrong(f"{show(value)} is no scene", "write the path of a scene file, or the scene itself")
    return value


Key = Annotated[
    tuple[str, ...], BeforeValidator(_keys), at_least(1, "key of the scene"), AfterValidator(_dotted)
]


class DrawPart(Part):
    """Sampled value of one or several keys of the scene."""

    key: Key
    uniform: Annotated[Any, AfterValidator(_range)] = None
    """The least and the greatest value."""
    normal: Annotated[Any, AfterValidator(_spread)] = None
    """Mean and standard deviation."""
    within: Annotated[Any, AfterValidator(_range)] = None
    """The bounds of what is kept of a normal distribution."""
    choice: Annotated[tuple[Any, ...], BeforeValidator(as_tuple), at_least(1, "value")] | None = None
    library: str | None = None
    """Folder of primitives, beside the scene; one of them is the demonstration."""
    recordings: str | None = None
    """Recording with several episodes, or folder of recordings, beside the scene."""
    add: bool = False
    """Whether the value is added to what the scene has, instead of replacing it."""

    @model_validator(mode="after")
    def _one_source(self) -> DrawPart:
        given = [name for name in SOURCES if getattr(self, name) is not None]
        if len(given) != 1:
            found = f"{' and '.join(given[:2])} are both given" if given else "no distribution is given"
            raise Wrong(found, f"give one of: {', '.join(SOURCES)}")
        if (self.normal is None) != (self.within is None):
            missing, other = ("normal", "within") if self.normal is None else ("within", "normal")
            raise Wrong(
                f"{other} is given without {missing}",
                "write both: normal: [mean, standard deviation], within: [least, greatest]",
            )
        if self.normal is not None and _lengths(self.normal) != _lengths(self.within):
            raise Wrong("normal and within are of different lengths", PAIR)
        if (self.library or self.recordings) and self.key != ("demonstration",):
            raise Wrong(f"{given[0]} draws demonstrations", "write key: demonstration")
        if self.add and given[0] not in ("uniform", "normal"):
            raise Wrong(f"what {given[0]} draws cannot be added", "leave add out")
        return self


def _lengths(pair: tuple[Any, Any]) -> int:
    return len(pair[0]) if isinstance(pair[0], tuple) else 0


class SimulationPart(Part):
    """MuJoCo simulation of every robot episode with verified joints."""

    grasp: Literal["weld", "connect", "friction"] = "weld"
    """How the hands hold the load."""
    perturbed: bool = True
    """Whether friction, mass, gains, the load's place in the hands and a push are drawn for each episode."""


class StudyFile(Part):
    """Dataset config, as written in its file."""

    version: Annotated[int, AfterValidator(_version)] = 1
    name: Annotated[str, AfterValidator(safe_name)]
    scene: Annotated[Any, AfterValidator(_scene)]
    """Path of the scene file that is varied, or the scene itself."""
    draws: Annotated[tuple[DrawPart, ...], BeforeValidator(as_tuple)] = ()
    episodes: Annotated[int, Field(ge=1, le=MAX_EPISODES)]
    seed: Annotated[int, Field(ge=0)] = 0
    budget: Positive = 30.0
    """Time for each episode [s]."""
    effort: EffortName = "normal"
    """How hard each search tries to better a verified motion."""
    ways: Annotated[int, Field(ge=1)] | None = None
    """Paths that are made smooth at most; what `effort` says unless given."""
    gain: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Relative gain below which steps of the optimisation count as none; what `effort` says unless given."""
    simulate: SimulationPart | None = None
    """How the episodes of a robot are simulated; they are not unless given."""
    cameras: CamerasPart | None = None
    """Cameras that take pictures of what is simulated; none unless given."""
    formats: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    """Formats of the datasets that are written in the end, unless the command names others."""


class SweepFile(Part):
    """Sweep of scenes, methods, seeds and settings, as written in its file."""

    version: Annotated[int, AfterValidator(_version)] = 1
    name: Annotated[str, AfterValidator(safe_name)]
    scenes: Annotated[tuple[str, ...], BeforeValidator(as_tuple), at_least(1, "scene")]
    """Paths of scene files."""
    methods: Annotated[tuple[str, ...], BeforeValidator(as_tuple), at_least(1, "method")] = ("comove",)
    seeds: Annotated[int, Field(ge=1, le=MAX_EPISODES)] = 1
    """Runs of every scene with every method, with the seeds from 0 on."""
    settings: dict[str, Annotated[tuple[Any, ...], BeforeValidator(as_tuple), at_least(1, "value")]] = Field(
        default_factory=dict
    )
    """Values of keys of the scenes, of which all combinations are run."""
    budget: Positive = 30.0
    """Time for each run [s]."""
    simulate: SimulationPart | None = None
    """How the motions of robots are simulated; they are not unless given."""


GENERATE = Contract(root=StudyFile, families={})
SWEEP = Contract(root=SweepFile, families={})
