"""Gait solvers: single shooting, for swimming and walking, and the paper's alternating scheme."""
