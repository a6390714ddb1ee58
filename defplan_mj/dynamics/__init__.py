"""The dynamics: the reduced step for Python and CasADi, the full FEM, the rigid surrogate's step, worlds."""
