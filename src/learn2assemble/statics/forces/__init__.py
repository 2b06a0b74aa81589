"""Forces in the joints of an assembly."""
