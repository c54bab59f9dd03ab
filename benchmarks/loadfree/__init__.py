"""Registration with an unknown load: events simulated by another solver, rivals, scores, tables."""
