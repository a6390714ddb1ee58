"""Feedback solvers: what plays a gait on the body, open loop or by looking at its state."""
