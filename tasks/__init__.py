"""Tasks, installed as `defplan_tasks`: a file a domain, with its bodies and gaits among the assets.

Each task is a plugin, found by its entry point in the group `defplan_mj.tasks`, each domain of the suite by one in
`defplan_mj.domains`; the harness imports none of them.
"""
