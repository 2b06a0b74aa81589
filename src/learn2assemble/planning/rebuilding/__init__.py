"""A standing structure turned into another one."""
