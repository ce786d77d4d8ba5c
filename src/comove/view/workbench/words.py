"""Verification results and measures as Markdown, for panels and pages."""

from __future__ import annotations

from collections.abc import Sequence

from comove.model.scene import Scene

SPECIAL = {
    "\\": "\\\\",
    "`": "\\`",
    "*": "\\*",
    "_": "\\_",
    "<": "&lt;",
    ">": "&gt;",
    "[": "\\[",
    "{": "&#123;",
}


def plain_text(text: str) -> str:
    """Return text with all markup escaped."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)


def verdict_words(
    kind: str,
    reasons: Sequence[str] = (),
    seconds: float | None = None,
    verdict: str = "",
    against: Sequence[str] = (),
) -> str:
    """Return a verification result as Markdown.

    Parameters
    ----------
    kind : "stored", "kept", "found", "solved", "ran", "failed", "waiting", "running", "compiling" or "ended"
    reasons : reasons why there is no verified motion
    seconds : time from the change to the first verified motion [s]
    verdict : result of a stored or executed motion
    against : scene and robot of the verification, in words
    """
    took = "" if seconds is None else f"{seconds:.1f} s" if seconds >= 1.0 else f"{1e3 * seconds:.0f} ms"
    after = took and f" {took} after the change"
    told = f"**{verdict[:1].upper()}{verdict[1:]}**"
    listed = "".join(f"\n- {plain_text(reason)}" for reason in reasons)
    return {
        "solved": f"**Verified**{after}. The search is done; this is the best it found.",
        "found": f"**Verified**{after}. Searching for a better one ...",
        "kept": f"**Verified**{after}: the motion shown still holds.",
        "stored": f"{told}, anew from the result's files, against {plain_text('; '.join(against))}.",
        "ran": f"{told}. This is what happened.{listed}",
        "running": "**Running.** Drag an obstacle into the way of the load.",
        "waiting": "**Not verified yet** for the scene as it is now; the grey motion belongs to the one before.",
        "compiling": "**Compiling**, once after installation: one to three minutes.",
        "ended": "**The planner has ended.** Load the page again.",
        "failed": f"**No verified motion found.**{listed}",
    }[kind]


def named_in(scene: Scene, reasons: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of the obstacles that reasons name."""
    names = [scene.name_of(number) for number in range(len(scene.file.obstacles))]
    return tuple(number for number, name in enumerate(names) if any(name in reason for reason in reasons))


def measures_words(rows: Sequence[Sequence[str]], proved: bool = True) -> str:
    """Return rows of measures as a Markdown table. It says whether they are proved."""
    lines = "\n".join(f"| {name} | {said} | {asked} |" for name, said, asked in rows)
    head = "at every instant | proved" if proved else "in the simulation | measured"
    return f"| {head} | asked for |\n|---|---|---|\n{lines}"
