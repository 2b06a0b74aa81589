"""An assembly as files of other programs, and as paper to build from by hand."""
