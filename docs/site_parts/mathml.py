"""Formulas as MathML, which browsers draw themselves: the pages need no script and no network."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def visit(writer: Any, node: Any) -> None:
    """Write a formula, within the line or on a line of its own."""
    from docutils import nodes

    inline = isinstance(node, nodes.math)
    formula = convert(node.astext(), display="inline" if inline else "block")
    writer.body.append(formula if inline else f'<div class="math">{formula}</div>')
    raise nodes.SkipNode
