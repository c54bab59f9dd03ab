"""`diagnose` on data of another solver, on rigs simulated here, on material tests."""
