"""Gait solvers that choose contacts along with the motion (contact-invariant optimisation)."""
