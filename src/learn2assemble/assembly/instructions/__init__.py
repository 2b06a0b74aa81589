"""Instructions to build by hand."""
