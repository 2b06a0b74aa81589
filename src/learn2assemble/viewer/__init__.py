"""Reports of a finished build plan: the page, the picture, the video, and a small server."""

from learn2assemble.viewer.page import write_page
from learn2assemble.viewer.picture import write_progress
from learn2assemble.viewer.serve import serve

__all__ = ["serve", "write_page", "write_progress"]
