"""Registration with nothing known of the load: true events of a foreign solver, rivals, scores, tables."""
