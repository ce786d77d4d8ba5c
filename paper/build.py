"""Set the paper as PDF: `make paper`."""

import tempfile
from pathlib import Path

import pypandoc
import typst

HERE = Path(__file__).parent


def main() -> None:
    """Set `paper.md`, with its references from `paper.bib`, as `paper.pdf` beside it."""
    options = ["--citeproc", "--metadata=link-citations", f"--template={HERE / 'template.typ'}"]
    options += [f"--bibliography={HERE / 'paper.bib'}"]
    text = pypandoc.convert_file(HERE / "paper.md", "typst", extra_args=options)
    with tempfile.NamedTemporaryFile("w", dir=HERE, suffix=".typ", encoding="utf-8") as draft:
        draft.write(text)
        draft.flush()
        typst.compile(draft.name, output=HERE / "paper.pdf", root=HERE.parent)
    print(HERE / "paper.pdf")


if __name__ == "__main__":
    main()
