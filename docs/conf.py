"""Settings of the site: `make docs` builds it, without a network."""

import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from site_parts import command_line, gallery, mathml, scene_keys  # noqa: E402

from comove import __version__  # noqa: E402

project, author, copyright = "comove", "The comove authors", "The comove authors"
version = release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "site_parts", "gallery/*.py", "gallery/*.ipynb", "gallery/*.json"]
html_theme, html_title = "furo", "comove"
html_extra_path = ["llms.txt"]
html_show_sourcelink = False
nitpicky = False

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
suppress_warnings = [
    "config.cache",
    "ref.python",
]  # a function among settings; words of docstrings that are names

autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_member_order = "bysource"
napoleon_use_rtype = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": "_build/examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": (gallery.written_pictures,),
    "reset_modules": (),
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "remove_config_comments": True,
    "abort_on_example_error": True,
}


def setup(app):
    """Write the generated pages, and lay the examples where they may leave their pictures."""
    app.add_html_math_renderer("mathml", (mathml.visit, None), (mathml.visit, None))
    (HERE / "reference" / "command_line.md").write_text(command_line.page(), encoding="utf-8")
    (HERE / "reference" / "scene_keys.md").write_text(scene_keys.page(), encoding="utf-8")
    shutil.copytree(HERE.parent / "examples", HERE / "_build" / "examples", dirs_exist_ok=True)


html_math_renderer = "mathml"
