"""SVG as a browser draws it: the walk over the tree, sheets, paths, and what is painted."""
