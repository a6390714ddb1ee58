"""What is measured about bodies and gaits beside a run's own way: solvers, robustness, finer steps, times."""
