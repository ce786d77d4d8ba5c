"""What the site adds to the pages: generated references, formulas without scripts, and pictures of the gallery."""
