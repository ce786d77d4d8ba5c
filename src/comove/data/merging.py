"""The merging of parts of a study that were run apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from comove.data.runs import RUNS, StudyStore, differences
from comove.errors import ResultError


@dataclass(frozen=True)
class Merged:
    """The numbers of a merged study: runs that ended, all runs, and those of which parts had different motions."""

    ended: int
    total: int
    different: int


def merge(parts: Sequence[Path], out: Path) -> Merged:
    """Take the runs of all parts of one study over into a folder; a run that is there already stays.

    A merge that was interrupted is completed by the same call.

    Parameters
    ----------
    parts : folders of parts, or their stores
    out : folder of the whole study, new or with some of its runs

    Raises
    ------
    ResultError
        If a part is no store, parts belong to different studies, or the folder cannot be written.
    """
    stores = [StudyStore.open(part / RUNS if part.is_dir() else part) for part in parts]
    described = [_description(store) for store in stores]
    for store, other in zip(stores[1:], described[1:], strict=True):
        changed = differences(described[0], other)
        if changed:
            raise ResultError(
                f"it holds another study than {stores[0].path}: {changed[0]}",
                file=store.path,
                way_out="merge parts of one study",
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(
            f"it cannot be made: {error.strerror}", file=out, way_out="name a folder that you may write"
        ) from error
    whole = StudyStore.create(out / RUNS)
    with whole.writer() as writer:
        whole.describe(described[0], max(store.total() for store in stores))
        different = sum(writer.absorb(store.path) for store in stores if store.path != whole.path)
    return Merged(len(whole.keys()), whole.total(), different)


def _description(store: StudyStore) -> dict:
    found = store.description()
    if found is None:
        raise ResultError("it holds no study yet", file=store.path, way_out="run its part first")
    return found
