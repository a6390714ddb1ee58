"""A run from its mesh to its report: stages, the folder their files lie in, what it says in figures."""
