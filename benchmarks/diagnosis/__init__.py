"""What does `diagnose` say of data made by another solver, by this package, and of material tests?"""
