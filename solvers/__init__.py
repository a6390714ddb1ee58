"""Solvers, installed as `defplan_solvers`: gaits, feedback that plays them, and planners that choose among them.

Each is a plugin, found by its entry point in the group `defplan_mj.solvers`; the harness imports none of them.
"""
