"""Assemblies of blocks: kits, blocks as polyhedra, their contacts, files."""
