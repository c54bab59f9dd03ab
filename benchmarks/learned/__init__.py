"""Registration with the trained models, honest input and spoilt."""
