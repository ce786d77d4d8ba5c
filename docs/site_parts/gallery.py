"""Pictures of the gallery: those that an example writes."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst


def written_pictures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Return reStructuredText that shows the pictures which an example wrote beside itself; they are moved."""
    shown = []
    for picture in sorted(Path(block_vars["src_file"]).parent.glob("*.png")):
        target = block_vars["image_path_iterator"].next()
        shutil.move(picture, target)
        shown.append(target)
    return figure_rst(shown, gallery_conf["src_dir"])
